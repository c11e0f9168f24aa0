"""Every distortion of the study, in the order of its table.

One that a law of readings cannot make changes the scene of the trials instead: `edits` replace
text of cards/trials.toml (its rate, an effect, a value of its rows), and the draws stay those of
the same trials.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal

from holdfast.core.writing import write_whole
from studies.distortions.chain import (
    CrossTalk,
    Drift,
    GainsApart,
    Hysteresis,
    Noise,
    OffsetStep,
    Quantisation,
    Reversal,
    Scaling,
    Smoothing,
)
from studies.distortions.fingers import DeadFingers, FewerFingers
from studies.distortions.geometry import (
    AxesRotation,
    HandRotation,
    Mirror,
    SensorsRotation,
    Tilt,
)
from studies.distortions.law import Law

TRIALS = Path(__file__).parent / "cards" / "trials.toml"
UNCHANGED = "unchanged"
RATE = "rate_hz = 150"
BITS = "[effects.quantisation]"


@dataclass(frozen=True)
class Distortion:
    """One row of the table.

    name   of its files and its random stream
    words  for the table
    group  of similar ones
    law    on readings, or on the forces before the sensors; None: nothing
    where  what the law acts on
    edits  (old, new) texts of the scene
    """

    name: str
    words: str
    group: str
    law: Law | None = None
    where: Literal["readings", "forces"] = "readings"
    edits: tuple[tuple[str, str], ...] = field(default=())

    def card(self, folder: Path) -> str:
        """The scene of its trials; one that is edited is written into a folder first."""
        if not self.edits:
            return str(TRIALS)
        text = TRIALS.read_text("utf-8")
        for old, new in self.edits:
            # A text that is not there would leave the scene as it is, and the row would lie.
            assert text.count(old) == 1, f"{self.name}: {old!r} is in no or many places"
            text = text.replace(old, new)
        return str(write_whole(folder / f"{self.name}.toml", text))


HELD = "hand held another way"
GAIN = "gain"
NOISE = "noise and offsets"
CHAIN = "sensors' chain"
FINGERS = "fingers"
DISTORTIONS = (
    Distortion(UNCHANGED, "unchanged", UNCHANGED),
    Distortion("turned-30", "hand turned by 30 degrees", HELD, HandRotation(30.0)),
    Distortion("turned-90", "hand turned by 90 degrees", HELD, HandRotation(90.0)),
    Distortion("turned-180", "hand turned by 180 degrees", HELD, HandRotation(180.0)),
    Distortion("turned-any", "hand turned by any angle", HELD, HandRotation()),
    Distortion(
        "axes-30", "x, y of all sensors turned by 30 degrees", HELD, AxesRotation(30.0)
    ),
    Distortion(
        "axes-90", "x, y of all sensors turned by 90 degrees", HELD, AxesRotation(90.0)
    ),
    Distortion("mirrored", "left hand (mirrored)", HELD, Mirror()),
    Distortion(
        "own-turn", "x, y of each sensor turned by itself", HELD, SensorsRotation()
    ),
    Distortion("roll-15", "fingertips rolled by 15 degrees", HELD, Tilt(15.0, "x")),
    Distortion("pitch-15", "fingertips pitched by 15 degrees", HELD, Tilt(15.0, "y")),
    Distortion("gain-0.4", "gain 0.4", GAIN, Scaling(gain=0.4)),
    Distortion("gain-2.5", "gain 2.5", GAIN, Scaling(gain=2.5)),
    Distortion("own-gain", "each sensor's gain 0.4 to 2.5", GAIN, GainsApart()),
    Distortion("shear-0.5", "shear gain 0.5", GAIN, Scaling(shear=0.5)),
    Distortion("shear-1.5", "shear gain 1.5", GAIN, Scaling(shear=1.5)),
    Distortion("noise-10", "10 mN of noise", NOISE, Noise(0.010)),
    Distortion("noise-30", "30 mN of noise", NOISE, Noise(0.030)),
    Distortion("noise-50", "50 mN of noise", NOISE, Noise(0.050)),
    Distortion("step-100", "offset step of 100 mN", NOISE, OffsetStep(0.1)),
    Distortion("step-300", "offset step of 300 mN", NOISE, OffsetStep(0.3)),
    Distortion("drift-20", "drift of 20 mN/s", NOISE, Drift(0.020)),
    Distortion("cross-talk-5", "5 % of cross-talk", CHAIN, CrossTalk(0.05)),
    Distortion("cross-talk-20", "20 % of cross-talk", CHAIN, CrossTalk(0.2)),
    Distortion("play-100", "hysteresis of 100 mN", CHAIN, Hysteresis(0.1)),
    Distortion("play-300", "hysteresis of 300 mN", CHAIN, Hysteresis(0.3)),
    Distortion("smooth-10", "smoothed, 10 ms", CHAIN, Smoothing(10.0)),
    Distortion("smooth-30", "smoothed, 30 ms", CHAIN, Smoothing(30.0)),
    Distortion("rate-7", "rate -7 %", CHAIN, edits=((RATE, "rate_hz = 139.5"),)),
    Distortion("rate+7", "rate +7 %", CHAIN, edits=((RATE, "rate_hz = 160.5"),)),
    Distortion("bits-12", "12 bit on every axis", CHAIN, Quantisation(12)),
    Distortion(
        "bits-16", "16 bit in the chip", CHAIN, edits=((BITS, f"{BITS}\nbits = 16"),)
    ),
    Distortion("reversed", "magnets reversed", CHAIN, Reversal()),
    Distortion(
        "reversed-tared", "magnets reversed, already tared", CHAIN, Reversal(tared=True)
    ),
    Distortion(
        "dead-1-invalid", "1 dead, marked invalid", FINGERS, DeadFingers(1, "invalid")
    ),
    Distortion(
        "dead-1-last", "1 dead, last value", FINGERS, DeadFingers(1, "last value")
    ),
    Distortion("dead-1-noise", "1 dead, noise", FINGERS, DeadFingers(1, "noise")),
    Distortion(
        "dead-2-invalid", "2 dead, marked invalid", FINGERS, DeadFingers(2, "invalid")
    ),
    Distortion(
        "dead-2-last", "2 dead, last value", FINGERS, DeadFingers(2, "last value")
    ),
    Distortion("dead-2-noise", "2 dead, noise", FINGERS, DeadFingers(2, "noise")),
    Distortion(
        "touch-4",
        "4 of 6 sensors touch",
        FINGERS,
        FewerFingers((0, 1, 2, 3)),
        "forces",
    ),
    Distortion(
        "touch-3", "3 of 6 sensors touch", FINGERS, FewerFingers((0, 2, 3)), "forces"
    ),
    Distortion(
        "touch-2", "2 of 6 sensors touch", FINGERS, FewerFingers((0, 2)), "forces"
    ),
)


@cache
def by_name() -> dict[str, Distortion]:
    """Every distortion by its name."""
    return {one.name: one for one in DISTORTIONS}
