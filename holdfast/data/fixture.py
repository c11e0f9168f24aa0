"""A small generated set in the thesis' layout, and the example files of docs/your-data.md.

With them training and export run without any recording. This is NOT a physical simulation: ramps,
tones and noise, shaped so that the classes resemble the thesis' in kind and are not trivial to tell
apart. Numbers from this set say that the pipeline runs and nothing about hands; simulated scenes
live in `simulation`. The same arguments write the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from holdfast.core.contract import AXES, FloatArray, channel_names
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.core.trial_layout import MASSES_G, META, is_heavy, truth_path
from holdfast.core.writing import require_new

KIND = "generated fixture"
FIXTURE_OBJECTS = tuple(MASSES_G)[:5]
N_SENSORS = 6
UPSIDE_DOWN = (1, 4)
"""Sensors, counted from 0, whose magnet is reversed: their three axes have the other sign."""
NEWTON_PER_GRAM = 9.81e-3
REST_S, HOLD_S = 3.0, 3.2
"""How long the hand is empty first, and then holds still: all actions begin at about 7 s."""
Step = tuple[str, float, float, float, float, float]
"""Situation ("" for the last one), and in how many s it reaches which grip, load (of 1), pull and
shaking (N a sensor)."""
GIVEN: list[Step] = [
    ("safe_slip", 0.3, 1.0, 1.0, 0.4, 0.1),
    ("", 0.2, 1.0, 1.0, 0.4, 0.0),
    ("", 0.4, 0.0, 0.0, 0.0, 0.0),
]
"""Another hand takes over, then this one opens."""
LOST: list[Step] = [
    ("risky_slip", 0.1, 1.0, 1.5, 0.8, 0.5),
    ("", 0.3, 1.0, 1.5, 0.8, 0.5),
    ("", 0.1, 0.0, 0.0, 0.0, 0.0),
]
"""Sudden: the object is torn away or falls, sliding through the closed hand."""
SET_DOWN: list[Step] = [
    ("safe_slip", 0.1, 1.0, 0.6, 0.0, 0.3),
    ("", 0.4, 1.0, 0.1, 0.0, 0.0),
    ("grasp", 2.6, 1.0, 0.1, 0.0, 0.0),
    ("safe_slip", 0.2, 1.0, 0.1, 0.1, 0.1),
    ("", 0.3, 0.0, 0.0, 0.0, 0.0),
]
"""Something else carries the object, then the hand lets go: the full bottle is passed so too."""
ACTIONS = {"pass": GIVEN, "pull": LOST, "fall": LOST, "put-down": SET_DOWN}


class _Hand:
    """Six mounted sensors: offset, magnet up or down, direction of shear."""

    def __init__(self, seed: int, rate_hz: float) -> None:
        self.rng = np.random.default_rng(seed)
        self.rate_hz = rate_hz
        # The fingers face the two sensors of the thumb, so their shear axes point the other way.
        opposed = np.pi * (np.arange(N_SENSORS) > 1)
        angle = opposed + self.rng.uniform(-0.5, 0.5, N_SENSORS)
        self.along = np.stack([np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)
        # At rest a magnet is nearest along its normal, so that offset is the largest.
        low, high = [-0.5, -0.5, 0.4], [0.5, 0.5, 0.8]
        self.offset_n = self.rng.uniform(low, high, (N_SENSORS, 3))

    def trial(
        self, name: str, action: str, rest_s: float = REST_S, hold_s: float = HOLD_S
    ) -> tuple[FloatArray, list[dict[str, float | str]]]:
        """Table [T, 19] and phases of a trial with an object of the table."""
        # A child of the generator: a change inside one trial changes no other.
        (rng,) = self.rng.spawn(1)
        in_two = (name, action) == ("full-bottle", "pass")
        steps: list[Step] = [
            ("nothing", rest_s, 0.0, 0.0, 0.0, 0.0),
            ("grasp", 0.4, 1.0, 0.0, 0.0, 0.2),
            ("", 0.4, 1.0, 1.0, 0.0, 0.0),
            ("", hold_s, 1.0, 1.0, 0.0, 0.0),
            *(SET_DOWN if in_two else ACTIONS[action]),
            ("nothing", 2.5, 0.0, 0.0, 0.0, 0.0),
        ]
        ends_s = [0.0]
        phases: list[dict[str, float | str]] = []
        for situation, seconds, *_ in steps:
            start_s = ends_s[-1]
            ends_s.append(round(start_s + seconds * rng.uniform(0.98, 1.06), 6))
            if situation:
                phases.append({"t0_s": start_s, "label": situation, "provenance": KIND})
            phases[-1]["t1_s"] = ends_s[-1]

        weight_n = MASSES_G[name] * NEWTON_PER_GRAM / N_SENSORS
        # Heavier objects are held more firmly.
        grip_n = 1.5 * weight_n + rng.uniform(1.0, 2.5)
        scale = [grip_n, weight_n, rng.uniform(0.5, 1.5), rng.uniform(0.5, 1.5)]
        levels = np.array([(0.0,) * 4, *(step[2:] for step in steps)])
        return self.readings(ends_s, levels * scale, rng), phases

    def readings(
        self, ends_s: list[float], levels_n: FloatArray, rng: np.random.Generator
    ) -> FloatArray:
        """[T, 19] of grip, load, pull and shaking [n, 4] at these times [n], linear in between."""
        t_s = np.arange(round(ends_s[-1] * self.rate_hz)) / self.rate_hz
        grip_n, load_n, pull_n, shake_n = (
            np.interp(t_s, ends_s, level_n)[:, None] for level_n in levels_n.T
        )
        # No two grasps load the fingers alike, and each pad sticks and slips by itself.
        share = rng.uniform(0.5, 1.5, N_SENSORS)
        tone_hz = rng.uniform(9.0, 22.0, N_SENSORS)
        slip_n = shake_n * np.sin(2 * np.pi * tone_hz * t_s[:, None] + tone_hz)
        shear_n = (load_n + pull_n) * share + slip_n
        # A grip is never quite normal to the pads; stick and slip shakes the normal force too.
        normal_n = grip_n * share + 0.3 * np.abs(slip_n)
        forces = shear_n[..., None] * self.along + normal_n[..., None] * [0.08, 0, 1]
        forces += self.offset_n + rng.normal(0.0, 0.02, forces.shape)
        forces[:, UPSIDE_DOWN] *= -1.0
        return np.column_stack([t_s, forces.reshape(len(t_s), -1)])


def write_fixture(
    folder: Path,
    *,
    trials_per_cell: int = 4,
    rate_hz: float = 50.0,
    seed: int = 0,
    objects: Sequence[str] = FIXTURE_OBJECTS,
    rest_s: float = REST_S,
) -> None:
    """Write objects x three actions x `trials_per_cell` trials, the empty hand and truth.

    A light object is pulled away, a heavy one falls. Two magnets are upside down, and every channel
    has an offset. Files that are there already are written over.
    """
    hand = _Hand(seed, rate_hz)
    for name in objects:
        risky = "fall" if is_heavy(MASSES_G[name]) else "pull"
        for action in ("pass", risky, "put-down"):
            for number in range(1, trials_per_cell + 1):
                path = folder / name / action / f"trial_{number}.csv"
                table, phases = hand.trial(name, action, rest_s)
                _write_table(path, table)
                truth_path(path).write_text(json.dumps({"phases": phases}))

    empty = hand.readings([0.0, 20.0], np.zeros((2, 4)), hand.rng)
    _write_table(folder / "nothing/trial_1.csv", empty)
    about = {"kind": KIND, "unit": "N", "redistributable": True}
    (folder / META).write_text(json.dumps(about))


def _write_table(
    path: Path,
    table: FloatArray,
    names: Sequence[str] = (TIME_COLUMN, *channel_names(N_SENSORS)),
    formats: str = "%.6f" + ",%.4f" * (3 * N_SENSORS),
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, table, formats, header=",".join(names), comments="")


TRIALS, LOGGER = "trials", "logger"
EARLY_REST_S = 1.0
"""All actions of the example begin two seconds before the script's time."""
TWO = ("soft-ball", "hard-ball")
FINGERS = ("thumb", "index", "middle", "ring", "little", "palm")


def write_example(folder: Path) -> None:
    """Write the files of docs/your-data.md: trials with gaps to fill, and a log to convert.

    They are `trials/<person>/<object>/<action>/trial_1.csv` and one log. Same bytes every time.
    Raises OutputError for a folder that holds something.
    """
    require_new(folder)
    trials = folder / TRIALS
    for seed, person in enumerate(("p01", "p02", "p03"), 1):
        own = trials / person
        write_fixture(
            own, trials_per_cell=1, seed=seed, objects=TWO, rest_s=EARLY_REST_S
        )
        # The mass of a mug is in no table.
        (own / TWO[1]).rename(own / "mug")

    for path in trials.rglob("*.json"):
        path.unlink()

    # One trial does not follow the script: its hold is half as long.
    short, _ = _Hand(seed, 50.0).trial("hard-ball", "fall", EARLY_REST_S, HOLD_S / 2)
    _write_table(trials / "p03/mug/fall/trial_1.csv", short)
    # And one is as a logger that knows nothing of the layout writes it: ms, names of fingers, mN.
    logged = trials / "p03/soft-ball/put-down/trial_1.csv"
    table = 1000.0 * np.loadtxt(logged, delimiter=",", skiprows=1)
    table[:, 0] += 120_000
    logged.unlink()
    names = ["millis", *(f"{finger}_{axis}" for finger in FINGERS for axis in AXES)]
    log = folder / LOGGER / "p03_soft-ball_put-down.csv"
    _write_table(log, table, names, "%.0f" + ",%.1f" * (3 * N_SENSORS))
