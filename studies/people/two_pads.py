"""A shipped scene as the two transducers of grip_lift_ati would feel it.

Lifts alone would teach a learner that "two pads, one axis silent" means "never a slip". Scenes with
the same sensing must stand beside them, so that the sensing does not tell the class:

    python -m studies.people.two_pads --rate 150 --out build/people/scenes

The scene keeps its objects, actions and people. Its hand becomes the card `two-transducers`; what
belongs to magnets, Hall chips and silicone goes, and the transducers' own noise comes in its place.
Their load is the shear along the object's axis. In a scene that holds the hand any way, a load
across that axis is not seen at all, as on the real transducers.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from pathlib import Path

from holdfast.core.schema import find_card, text_of
from holdfast.core.writing import write_whole
from holdfast.simulation import SCENES

SHIPPED = ("thesis", "wide", "everyday")
"""The scenes whose two-pad form stands beside the lifts."""
CARD = "two-transducers"
NOT_OF_TRANSDUCERS = (
    # magnets and their faults
    "dipole",
    "cross_talk",
    "gain_tilt",
    "magnet_reversed",
    "thermal_drift",
    # the Hall chip and its clock
    "hall_noise",
    "quantisation",
    "timing_jitter",
    # silicone: how it is mounted, yields, creeps and drifts
    "shear_gain",
    "hysteresis",
    "mounting",
    "drift",
    # in place of it: the transducers' own
    "white_noise",
)
"""Effects that are left out. `averaging` stays: it is the mean of the readings in a sample."""
NOISE_HZ = 150.0
NOISE_N = {
    "yellow load": (0.0022, 0.0062),
    "yellow grip": (0.0064, 0.29),
    "orange load": (0.0042, 0.0102),
    "orange grip": (0.0136, 0.0365),
}
"""Rms of a resting channel at NOISE_HZ, 5 and 95 % of 431 stretches of 0.25 s without their trend.

They lie between lifts with both transducers good. Above 150 Hz the noise is not white, below it is:
at 50 Hz it is 0.58 to 0.62 of this. The yellow normal force differs most, from person to person (8
to 230 mN). No step of a converter is seen: the 600 Hz files have steps of 0.1 mN, which a simulated
file has too. Rests stay within 25 mN over a file, so there is no drift.
"""
ORDER = ["yellow load", "yellow load", "yellow grip"]
ORDER += ["orange load", "orange load", "orange grip"]
"""By channel: x, y, z of the yellow transducer, then of the orange one; x is not measured."""


def two_pad_name(scene: str) -> str:
    """Name of the two-pad form of a scene."""
    return f"{scene}-two-pads"


def two_pad_scene(scene: str, rate_hz: float = NOISE_HZ) -> str:
    """Text (TOML) of the two-pad form of a scene, by name or path, at a rate. Raises CardError."""
    text = text_of(find_card(scene, SCENES, "scene"))
    kept = []
    for block in _blocks(text):
        header = re.match(r"\[effects\.(\w+)\]", _header(block))
        if header and header[1] in NOT_OF_TRANSDUCERS:
            continue
        if _header(block).startswith("[hand]"):
            continue
        kept.append(block)

    text = "".join(kept)
    # two contacts, one a side, always touch both
    text = re.sub(r"(?m)^touching\s*=.*\n", "", text)
    text = re.sub(r"(?m)^rate_hz\s*=\s*[\d.]+", f"rate_hz = {rate_hz:g}", text)
    text = re.sub(r'(?m)^title = "(.*)"$', r'title = "\1, on two transducers"', text)
    return text.rstrip() + "\n\n" + _sensing(rate_hz)


def write_two_pad_scene(scene: str, rate_hz: float, folder: Path) -> Path:
    """Write the two-pad form of a scene into a folder; returns its path. Raises OutputError."""
    path = folder / f"{two_pad_name(scene)}-{rate_hz:g}hz.toml"
    write_whole(path, two_pad_scene(scene, rate_hz))
    return path


def _sensing(rate_hz: float) -> str:
    """The tables of the hand and of the transducers' noise. rate_hz: of the samples."""
    # White noise, of which each sample is a mean.
    by_rate = math.sqrt(rate_hz / NOISE_HZ)
    low = [round(NOISE_N[name][0] * by_rate, 6) for name in ORDER]
    high = [round(NOISE_N[name][1] * by_rate, 6) for name in ORDER]
    return (
        f'[hand]\ncard = "{CARD}"\n\n'
        "# measured at rest in grip_lift_ati, channel by channel\n"
        f"[effects.white_noise]\nrms_n = 0\nlow_n = {low}\nhigh_n = {high}\n"
    )


def _blocks(text: str) -> list[str]:
    """A scene's text in parts, one a table, each with the comments right above its header."""
    blocks: list[list[str]] = [[]]
    for line in text.splitlines(keepends=True):
        if line.startswith("["):
            above = _comments_at_end(blocks[-1])
            cut = len(blocks[-1]) - above
            blocks.append(blocks[-1][cut:])
            del blocks[-2][cut:]
        blocks[-1].append(line)
    return ["".join(block) for block in blocks]


def _comments_at_end(lines: list[str]) -> int:
    """How many lines at the end are comments."""
    count = 0
    while count < len(lines) and lines[-1 - count].startswith("#"):
        count += 1
    return count


def _header(block: str) -> str:
    """The header of a block, "" where it has none."""
    found = re.search(r"(?m)^\[.*\]", block)
    return found[0] if found else ""


def main() -> int:
    """Write the two-pad form of the shipped scenes."""
    parser = argparse.ArgumentParser(prog="python -m studies.people.two_pads")
    parser.add_argument("--rate", type=float, default=NOISE_HZ, metavar="HZ")
    parser.add_argument("--out", type=Path, default=Path("build/people/scenes"))
    args = parser.parse_args()
    for scene in SHIPPED:
        path = write_two_pad_scene(scene, args.rate, args.out)
        sys.stdout.write(f"{path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
