"""A small generated set in the thesis' layout, and the example files of docs/your-data.md.

With them training and export run without any recording.

This is NOT a physical simulation: smooth ramps, fading tones and noise, shaped so that the classes
resemble the thesis' in kind and are not trivial to tell apart. Numbers from this set say that the
pipeline runs and nothing about hands; simulated scenes live in `simulation`. The same arguments
write the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from holdfast.core.contract import (
    AXES,
    GRASP,
    NORMAL_AXIS,
    NOTHING,
    RISKY_SLIP,
    SITUATIONS,
    FloatArray,
    channel_names,
)
from holdfast.core.errors import OutputError
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.core.trial_layout import MASSES_G, META, is_heavy, truth_path
from holdfast.core.writing import require_writable
from holdfast.training.timeline import situation_of

KIND = "generated fixture"
FIXTURE_OBJECTS = (
    "soft-ball",
    "empty-bottle",
    "basket-ball",
    "hard-ball",
    "full-bottle",
)
N_SENSORS = 6
"""3-axis sensors, hence 18 channels, as the thesis' hand has."""
UPSIDE_DOWN = (1, 4)
"""Sensors, counted from 0, whose magnet is reversed: their three axes have the other sign."""
NOISE_N = 0.02
"""Standard deviation of a channel's noise, N."""
EMPTY_HAND_S = 20.0
"""Length of the recording of the hand alone."""
TAIL_S = 2.5
"""What a trial lasts after its action."""
NEWTON_PER_GRAM = 9.81e-3
"""Weight of a gram, N."""


class _Scene:
    """Forces drawn over time, and what happens when.

    t_s [T]; grip_n [T] and load_n [T]: mean normal force and shear of a sensor; slip_n [T, 6]:
    vibration; marks: (since when, situation), in order.
    """

    def __init__(
        self, rng: np.random.Generator, lasts_s: float, rate_hz: float
    ) -> None:
        self.rng = rng
        self.t_s = np.arange(round(lasts_s * rate_hz)) / rate_hz
        self.grip_n = np.zeros_like(self.t_s)
        self.load_n = np.zeros_like(self.t_s)
        self.slip_n = np.zeros((len(self.t_s), N_SENSORS))
        self.marks = [(0.0, NOTHING)]

    def some(self, low: float, high: float) -> float:
        """A uniform draw."""
        return float(self.rng.uniform(low, high))

    def ramp(self, start_s: float, lasts_s: float) -> FloatArray:
        """[T] from 0 to 1, smooth at both ends."""
        # Smoothstep: its slope is zero at both ends, so that a ramp adds no edge of its own.
        u = np.clip((self.t_s - start_s) / lasts_s, 0.0, 1.0)
        return u * u * (3.0 - 2.0 * u)

    def shake(self, start_s: float, lasts_s: float, force_n: float) -> None:
        """Stick and slip: another tone on every sensor, then fading in a tenth of a second."""
        t_s = self.t_s - start_s
        after_s = np.clip(t_s - lasts_s, 0.0, None)

        # The fading has a time constant of 0.05 s and begins when the shaking ends.
        fading = np.exp(-after_s / 0.05)
        envelope_n = force_n * self.ramp(start_s, 0.02) * fading

        # Each pad sticks and slips by itself, hence a tone and a phase of its own.
        tone_hz = self.rng.uniform(9.0, 22.0, N_SENSORS)
        phase = self.rng.uniform(0.0, 2 * np.pi, N_SENSORS)
        angle = 2 * np.pi * tone_hz * t_s[:, None] + phase
        self.slip_n += envelope_n[:, None] * np.sin(angle)

    def empty(self, start_s: float, lasts_s: float) -> None:
        """All forces fade: the object leaves the hand."""
        left = 1.0 - self.ramp(start_s, lasts_s)
        self.grip_n *= left
        self.load_n *= left
        self.slip_n *= left[:, None]
        self.marks.append((start_s + lasts_s, NOTHING))


class _Hand:
    """Six mounted sensors: offset, magnet up or down, share of the grip, axis of shear."""

    def __init__(self, rng: np.random.Generator) -> None:
        # The fingers face the two sensors of the thumb, so their shear axes point the other way.
        opposed = np.pi * (np.arange(N_SENSORS) > 1)
        angle = opposed + rng.uniform(-0.5, 0.5, N_SENSORS)
        self.along = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        self.share = rng.uniform(0.6, 1.4, N_SENSORS)

        # At rest a magnet is nearest along its normal, so that offset is the largest.
        self.offset_n = rng.uniform(-0.5, 0.5, (N_SENSORS, 3))
        self.offset_n[:, NORMAL_AXIS] = rng.uniform(0.2, 0.8, N_SENSORS)
        self.sign = np.ones((N_SENSORS, 3))
        self.sign[list(UPSIDE_DOWN)] = -1.0

    def feel(self, scene: _Scene) -> FloatArray:
        """[T, 18] what the sensors read."""
        # No two grasps load the fingers alike.
        share = self.share * scene.rng.uniform(0.7, 1.3, N_SENSORS)

        shape = (len(scene.t_s), N_SENSORS, 3)
        forces = scene.rng.normal(0.0, NOISE_N, shape) + self.offset_n
        grip_n = scene.grip_n[:, None]
        load_n = scene.load_n[:, None]

        shear = load_n * share + scene.slip_n
        forces[..., :NORMAL_AXIS] += shear[..., None] * self.along
        # A grip is never quite normal to the pads.
        forces[..., 0] += 0.08 * grip_n * share

        # Stick and slip shakes the normal force too.
        normal = grip_n * share + 0.3 * np.abs(scene.slip_n)
        forces[..., NORMAL_AXIS] += normal
        return (forces * self.sign).reshape(len(forces), -1)


def write_fixture(
    folder: Path,
    *,
    trials_per_cell: int = 4,
    rate_hz: float = 50.0,
    seed: int = 0,
    objects: Sequence[str] = FIXTURE_OBJECTS,
) -> None:
    """Write objects x three actions x `trials_per_cell` trials, the empty hand and truth.

    A light object is pulled away, a heavy one falls. Two magnets are upside down, and every channel
    has an offset. Files that are there already are written over.
    """
    rng = np.random.default_rng(seed)

    # One hand for all trials, as one person's recordings have: its offsets and magnets stay the
    # same.
    hand = _Hand(rng)
    # Every trial draws from a child of the generator: a change inside one changes no other.
    for name in objects:
        risky = "fall" if is_heavy(MASSES_G[name]) else "pull"
        for action in ("pass", risky, "put-down"):
            for number in range(1, trials_per_cell + 1):
                (child,) = rng.spawn(1)
                scene = _trial(name, action, child, rate_hz)
                _write(folder / name / action / f"trial_{number}.csv", scene, hand)

    empty = _Scene(rng, EMPTY_HAND_S, rate_hz)
    _write(folder / "nothing" / "trial_1.csv", empty, hand)

    meta = {
        "kind": KIND,
        "unit": "N",
        "recordings by": "nobody",
        "redistributable": True,
        "seed": seed,
    }
    _write_json(folder / META, meta)


def _trial(name: str, action: str, rng: np.random.Generator, rate_hz: float) -> _Scene:
    """Nothing, grasp, hold, act at about 7 s, after a put-down release at about 10 s, nothing."""
    # The script hands the full bottle over in two steps too.
    is_put_down = action == "put-down"
    in_steps = is_put_down or (name, action) == ("full-bottle", "pass")
    acts_until_s = 10.5 if in_steps else 7.5
    scene = _Scene(rng, acts_until_s + TAIL_S, rate_hz)

    # The load is shared by all sensors.
    weight_n = MASSES_G[name] * NEWTON_PER_GRAM / N_SENSORS
    act_s = scene.some(6.8, 7.5)
    # What is to fall rests on something until it is let go.
    falls = action == "fall"
    _grasp(scene, weight_n, held_by_other=falls)

    if in_steps:
        _set_down(scene, act_s, quickly=is_put_down)
        release_s = scene.some(10.0, 10.4)
        _hand_over(scene, release_s, pull_n=0.1)
    elif situation_of(action) == RISKY_SLIP:
        force_n = weight_n if falls else scene.some(0.5, 1.5)
        _lose(scene, act_s, force_n)
    else:
        _hand_over(scene, act_s, pull_n=scene.some(0.2, 0.8))
    return scene


def _grasp(scene: _Scene, weight_n: float, *, held_by_other: bool) -> None:
    """The hand closes, then bears the weight. held_by_other: something else bears most of it."""
    start_s = scene.some(2.6, 3.4)
    closing_s = scene.some(0.2, 0.6)
    scene.marks.append((start_s, GRASP))

    # Heavier objects are held more firmly.
    grip_n = scene.some(1.0, 2.5) + 1.5 * weight_n
    scene.grip_n += grip_n * scene.ramp(start_s, closing_s)
    load_n = weight_n * (0.1 if held_by_other else 1.0)
    scene.load_n += load_n * scene.ramp(start_s + closing_s, 0.5)
    # The object settles between the fingers as they close.
    scene.shake(start_s + 0.05, 0.1, scene.some(0.1, 0.3))


def _hand_over(scene: _Scene, start_s: float, pull_n: float) -> None:
    """Slow: the other hand takes over, then this one opens."""
    taking_s = scene.some(0.2, 0.9)
    scene.marks.append((start_s, situation_of("pass")))
    scene.load_n += pull_n * scene.ramp(start_s, taking_s)
    scene.shake(start_s + 0.5 * taking_s, 0.2, scene.some(0.05, 0.2))
    scene.empty(start_s + taking_s, scene.some(0.2, 0.6))


def _set_down(scene: _Scene, start_s: float, *, quickly: bool) -> None:
    """Something else carries the object from now on; the hand holds it a little longer."""
    lasts_s = scene.some(0.1, 0.3) if quickly else scene.some(0.5, 1.0)
    scene.marks.append((start_s, situation_of("put-down")))
    scene.marks.append((start_s + lasts_s + 0.3, GRASP))

    scene.load_n *= 1.0 - 0.9 * scene.ramp(start_s, lasts_s)
    force_n = scene.some(0.15, 0.5) if quickly else scene.some(0.05, 0.2)
    scene.shake(start_s, 0.1, force_n)


def _lose(scene: _Scene, start_s: float, force_n: float) -> None:
    """Sudden: the object is torn away or falls, sliding through the closed hand."""
    sliding_s = scene.some(0.15, 0.5)
    scene.marks.append((start_s, RISKY_SLIP))
    scene.load_n += force_n * scene.ramp(start_s, scene.some(0.05, 0.25))
    scene.shake(start_s, sliding_s, scene.some(0.2, 0.8))
    scene.empty(start_s + sliding_s, scene.some(0.06, 0.15))


def _write(path: Path, scene: _Scene, hand: _Hand) -> None:
    """A trial and its truth."""
    table = np.column_stack([scene.t_s, hand.feel(scene)])
    _write_table(path, table)

    # Each phase lasts to the next; the last one to well after the last sample.
    stops_s = [start_s for start_s, _ in scene.marks[1:]]
    stops_s.append(float(scene.t_s[-1]) + 1.0)
    phases = []
    for (start_s, situation), stop_s in zip(scene.marks, stops_s, strict=True):
        phase = {
            "t0_s": round(start_s, 6),
            "t1_s": round(stop_s, 6),
            "label": SITUATIONS[situation],
            "provenance": KIND,
        }
        phases.append(phase)
    _write_json(truth_path(path), {"phases": phases})


def _write_table(
    path: Path,
    table: FloatArray,
    names: Sequence[str] = (TIME_COLUMN, *channel_names(N_SENSORS)),
    formats: str = "%.6f" + ",%.4f" * (3 * N_SENSORS),
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    header = ",".join(names)
    np.savetxt(path, table, formats, header=header, comments="", encoding="utf-8")


def _write_json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8", newline="\n")


TRIALS = "trials"
LOGGER = "logger"
PEOPLE = ("p01", "p02", "p03")
EXAMPLE_OBJECTS = {"soft-ball": "soft-ball", "hard-ball": "mug"}
"""Objects of the fixture, and their names in the example: the mass of a mug is in no table."""
EARLY_S = 2.0
"""All actions of the example start so much before the script's time."""
SHORT_HOLD = "p03/mug/fall/trial_1.csv"
HELD_S = (2.5, 4.0)
"""One trial does not follow the script: these seconds of its hold are left out."""
LOGGED = "p03/soft-ball/put-down/trial_1.csv"
FINGERS = ("thumb", "index", "middle", "ring", "little", "palm")
LOG_STARTS_MS = 120_000


def write_example(folder: Path) -> None:
    """Write the files of docs/your-data.md: trials with gaps to fill, and a log to convert.

    They are `trials/<person>/<object>/<action>/trial_1.csv` and one log. Same bytes every time.
    Raises OutputError for a folder that holds something.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(
            "exists and is not empty", where=folder, next_step="name a new folder"
        )
    require_writable(folder)
    with TemporaryDirectory() as made:
        for seed, person in enumerate(PEOPLE, 1):
            source = Path(made) / person
            write_fixture(
                source, trials_per_cell=1, seed=seed, objects=[*EXAMPLE_OBJECTS]
            )
            for path in sorted(source.rglob("trial_1.csv")):
                name = f"{person}/{path.relative_to(source).as_posix()}"
                _write_example_trial(folder, name, path)


def _write_example_trial(folder: Path, name: str, source: Path) -> None:
    for known, renamed in EXAMPLE_OBJECTS.items():
        name = name.replace(known, renamed)
    table = np.loadtxt(source, delimiter=",", skiprows=1)
    # The empty hand follows no script.
    if "nothing" not in name:
        table = _without(table, 0.0, EARLY_S)
    if name == SHORT_HOLD:
        table = _without(table, *HELD_S)
    if name != LOGGED:
        _write_table(folder / TRIALS / name, table)
        return

    # As a logger that knows nothing of the layout writes it: ms, names of fingers, mN.
    names = ["millis"]
    for finger in FINGERS:
        names += [f"{finger}_{axis}" for axis in AXES]
    table *= 1000.0
    table[:, 0] += LOG_STARTS_MS
    formats = "%.0f" + ",%.1f" * (3 * N_SENSORS)
    _write_table(folder / LOGGER / "p03_soft-ball_put-down.csv", table, names, formats)


def _without(table: FloatArray, start_s: float, stop_s: float) -> FloatArray:
    """The rows outside [start_s, stop_s), the later ones moved up."""
    t_s = table[:, 0]
    is_later = t_s >= stop_s
    kept = (t_s < start_s) | is_later
    cut = table[kept]
    cut[is_later[kept], 0] -= stop_s - start_s
    return cut
