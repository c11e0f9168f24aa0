"""`make peers`: a pull and a fast hand-over with holdfast in the loop, in our core and in MuJoCo.

Both worlds get the same trials, drive, people, sensors, model file, controller and supervisor; only
what happens between two samples differs (mujoco_hand.py). Compared are the outcome, and the contact
forces from load onset until the object is gone from one of the hands, or the puller has given up:
for each finger the mean over time and the peak of the normal force, and the same of the force along
the skin, all fingers' sum. Medians are in the JSON too.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.loop_figures import ThreeRuns
from benchmarks.mujoco_version import require_mujoco
from holdfast.cli.command import path_argument, run_script
from holdfast.core.contract import FloatArray
from holdfast.core.writing import require_writable, write_whole
from holdfast.edge_runtime.grip import AnswerRules
from holdfast.edge_runtime.model import Model
from holdfast.simulation.closed_loop import ClosedLoop, managed
from holdfast.simulation.loop_people import LoopOutcome, LoopRecord
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file

MODEL = Path("models/holdfast-150hz.onnx")
SEED = 0
HELD = """\
close_at_s = 1
hold_s = 1.5
grip_n = 4
weak_share = 0
tilt_deg = 0
roll_deg = 0
offset_mm = 0
friction_factor = 1
"""
CARD = f"""
[record]
rate_hz = 150
[objects.can]
mass_g = 200
radius_mm = 60
half_length_mm = 100
friction = 0.6
kinetic_share = 1
[[trials]]
objects = ["can"]
action = "pull"
count = 3
{HELD}cap_n = 3
arm_n_per_m = 600
move_s = 0.5
[[trials]]
objects = ["can"]
action = "pass"
count = 3
{HELD}cap_n = 12
arm_n_per_m = 600
distance_m = 0.25
move_s = 0.5
take_s = 0.2
open_after_s = 0.25
[effects.dipole]
[effects.hall_noise]
"""
WATCHED_S = 1.2
ALONG = "along the skin"


@dataclass(frozen=True)
class LoopRun:
    """One trial in one world: its outcome, and forces_n [T, S, 3] at t_s [T]."""

    outcome: LoopOutcome
    t_s: FloatArray
    forces_n: FloatArray


@dataclass(frozen=True)
class Fates:
    """What became of a trial in one world; times in s after the action began, None for never."""

    kept: bool
    lost_s: float | None
    onset_s: float | None
    slip_mm: float
    peak_grip_n: float
    blocked: bool


@dataclass(frozen=True)
class Figures:
    """Of one force over time, N."""

    mean_n: float
    median_n: float
    peak_n: float


@dataclass(frozen=True)
class Force:
    """One force in both worlds."""

    name: str
    ours: Figures
    mujoco: Figures

    @property
    def difference(self) -> float:
        """The larger of the differences of mean and peak, over ours."""
        mean = abs(self.mujoco.mean_n / self.ours.mean_n - 1.0)
        return max(mean, abs(self.mujoco.peak_n / self.ours.peak_n - 1.0))


def compare(model: Model) -> list[dict[str, Any]]:
    """Both trials in both worlds, in a hand that does nothing and in one that answers."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "peer.toml"
        path.write_text(CARD, encoding="utf-8")
        scene = Scene(read_scene_file(str(path)), SEED)
    return [_compared(scene, trial, model) for trial in scene.trials()]


def _compared(scene: Scene, trial: PlannedTrial, model: Model) -> dict[str, Any]:
    runs = {
        name: [_run(scene, trial, model, name, peer=peer) for peer in (False, True)]
        for name in ("none", "holdfast")
    }
    ours, peer = runs["holdfast"]
    compared = forces(ours, peer)
    return {
        "action": trial.action,
        **{
            world: {
                name: asdict(_fates(runs["none"][k], both[k]))
                for name, both in runs.items()
            }
            for k, world in enumerate(("ours", "mujoco"))
        },
        "same_outcome": _same(
            _fates(runs["none"][0], ours), _fates(runs["none"][1], peer)
        ),
        "forces": [asdict(one) | {"difference": one.difference} for one in compared],
        "largest_difference": max(one.difference for one in compared),
    }


def _run(
    scene: Scene, trial: PlannedTrial, model: Model, name: str, *, peer: bool
) -> LoopRun:
    rules = AnswerRules.of(model.card.decision)
    make = managed(scene, name, rules=rules)
    loop = ClosedLoop(scene, [trial, trial], model, make)
    if peer:
        from benchmarks.mujoco_hand import MujocoWorld

        loop.world = MujocoWorld(loop.world)  # type: ignore[assignment]
    forces_n = []
    record = LoopRecord.empty(loop.spans.periods, 2)
    for period in range(loop.spans.periods):
        target_n = loop.decide(period)
        loop.note(record, period, target_n)
        loop.world.advance(period, target_n)
        forces_n.append(loop.world.forces_n[0].copy())
    outcome = loop.outcome(0, record)
    t_s = (loop.spans.begins[0] + 1 + np.arange(len(forces_n))) / loop.rate_hz
    return LoopRun(outcome, t_s, np.array(forces_n))


def forces(ours: LoopRun, peer: LoopRun) -> list[Force]:
    """Normal force of each finger and the force along the skin, while both hands have contact."""
    act_s = ours.outcome.act_s
    until_s = min(ours.outcome.lost_s, peer.outcome.lost_s, act_s + WATCHED_S)
    both = [
        run.forces_n[(run.t_s >= run.outcome.onset_s) & (run.t_s < until_s)]
        for run in (ours, peer)
    ]
    names = [f"normal {k + 1}" for k in range(both[0].shape[1])]
    normals = [
        Force(n, *(_figures(one[:, k, 2]) for one in both)) for k, n in enumerate(names)
    ]
    along = [np.sqrt((one[..., :2] ** 2).sum(axis=2)).sum(axis=1) for one in both]
    return [*normals, Force(ALONG, *(_figures(one) for one in along))]


def _figures(force_n: FloatArray) -> Figures:
    return Figures(
        float(force_n.mean()), float(np.median(force_n)), float(force_n.max())
    )


def _fates(bare: LoopRun, held: LoopRun) -> Fates:
    one = held.outcome
    act_s = held.outcome.act_s
    lost_s, onset_s = (
        t - act_s if np.isfinite(t) else None for t in (one.lost_s, one.onset_s)
    )
    blocked = (
        one.trial.action == "pass"
        and ThreeRuns(bare.outcome, bare.outcome, one).blocked
    )
    return Fates(
        not one.dropped, lost_s, onset_s, one.slip_mm, one.peak_grip_n, blocked
    )


def _same(ours: Fates, peer: Fates) -> bool:
    """Kept or lost in both, blocked or let go in both."""
    return (ours.kept, ours.blocked) == (peer.kept, peer.blocked)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this program."""
    default = Path("build/bench/mujoco-loop.json")
    parser.add_argument("--out", type=path_argument, default=default, metavar="FILE")
    parser.add_argument("--model", type=path_argument, default=MODEL, metavar="FILE")


def run(args: argparse.Namespace) -> int:
    """Run both, write the JSON, print a line a trial."""
    version = require_mujoco("peers")
    require_writable(args.out.parent)
    model = Model(args.model)
    trials = compare(model)
    figures = {
        "simulated": True,
        "mujoco": version,
        "model": model.card.model_id,
        "trials": trials,
    }
    write_whole(args.out, json.dumps(figures, indent=2) + "\n")
    for one in trials:
        outcome = "same" if one["same_outcome"] else "another"
        forces_in_words = f"forces differ by {one['largest_difference']:.0%} at most"
        sys.stdout.write(f"{one['action']}: {outcome} outcome; {forces_in_words}\n")
    return 0


if __name__ == "__main__":
    about = "holdfast in the loop, in MuJoCo and in ours"
    sys.exit(run_script("python -m benchmarks.mujoco_loop", about, add_arguments, run))
