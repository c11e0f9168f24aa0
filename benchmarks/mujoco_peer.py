"""`make peers`: the same hold and pull in MuJoCo, to compare price and creep with our scenes.

The cylinder is held for 60 s, then pulled down (mujoco_scene.py). What MuJoCo does otherwise, and
what follows for a comparison:

- its friction is a soft constraint: below the limit a contact still slides, at a speed in
  proportion to the load (MuJoCo documentation, "Modeling: preventing slip"; issue 3328 of its
  repository). impratio makes it slower, the no-slip pass all but stops it;
- it has one friction coefficient, not a static and a kinetic one: the static one is used;
- its fingertips need a mass (ours have none), and how fast an object creeps depends on it;
- its contacts yield too, more than the fingers with the default solref. So the fingers' springs are
  drawn further until the grip is right, and all variants but the first have contacts as stiff as
  the longer step allows.

CPU time is of `mj_step` alone: no compiling of the model, no Python between the steps of the hold.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.mujoco_scene import (
    FINGER_Z_M,
    GRAVITY_M_S2,
    THUMB_Z_M,
    VARIANTS,
    Scene,
    Variant,
    mjcf,
)
from benchmarks.mujoco_version import require_mujoco
from holdfast.cli.command import path_argument, run_script
from holdfast.core.reading import Json
from holdfast.core.writing import require_writable, write_whole

try:
    import mujoco
except ModuleNotFoundError:
    mujoco = None

STEPS_S = (1e-3, 2e-3)
REPEATS = 3
CHUNK_S = 0.1
"""Time between two looks at a hold."""
SLIP_TRAVEL_M = 2e-3
"""Gross slip, as in our scenes: travel along the surface, mean of the pads, without their stretch.

The fingers press with half a thumb pad's force and slide first: 2 mm can pass before the thumb
slides.
"""


class Hold:
    """A compiled scene and its readings."""

    def __init__(
        self, scene: Scene, step_s: float, variant: Variant, drawn: float = 1.0
    ) -> None:
        self.scene = scene
        self.step_s = step_s
        self.model = mujoco.MjModel.from_xml_string(mjcf(scene, step_s, variant, drawn))
        self.data = mujoco.MjData(self.model)
        self.pads = [f"thumb{k}" for k in range(len(THUMB_Z_M))] + [
            f"finger{k}" for k in range(len(FINGER_Z_M))
        ]
        self.person(False)

    def run(self, seconds: float) -> float:
        """Step on without Python in between; CPU seconds it took."""
        started = time.process_time()
        mujoco.mj_step(self.model, self.data, nstep=round(seconds / self.step_s))
        return time.process_time() - started

    def person(self, there: bool, cap_n: float = 1.0) -> None:
        """Let the person pull, with at most cap_n, or not."""
        self.model.opt.disableactuator = 0 if there else 1 << 1
        self.model.actuator_forcerange[0] = -cap_n, cap_n

    @property
    def z_m(self) -> float:
        """Height of the object."""
        return float(self.data.joint("z").qpos[0])

    @property
    def travel_m(self) -> float:
        """How far the object is below the mean of the pads: slip, without what the pads stretch."""
        return (
            float(np.mean([self.data.joint(f"{pad}z").qpos[0] for pad in self.pads]))
            - self.z_m
        )

    @property
    def held(self) -> bool:
        """All pads touch."""
        return int(self.data.ncon) == len(self.pads)

    @property
    def grip_n(self) -> float:
        """Normal force of either side: half the sum of all contacts'."""
        force = np.zeros(6)
        sum_n = 0.0
        for k in range(self.data.ncon):
            mujoco.mj_contactForce(self.model, self.data, k, force)
            sum_n += float(force[0])
        return sum_n / 2


def drawn_for(scene: Scene, step_s: float, variant: Variant, rounds: int = 8) -> float:
    """How far to draw the springs for the scene's grip, found without gravity: nothing slides."""
    drawn = 1.0
    for _ in range(rounds):
        held = Hold(scene, step_s, variant, drawn)
        held.model.opt.gravity[:] = 0.0
        held.run(scene.settled_s)
        drawn *= scene.grip_n / held.grip_n
    return drawn


@dataclass(frozen=True)
class HeldObject:
    """A hold. cpu_s_per_s: CPU s per simulated s.

    creep_m: how far the object sank from settled_s on, None where it did not stay. creep_m_s: in a
    second, while it was held. slip_m: the part of creep_m that is slip along the pads.
    """

    cpu_s_per_s: float
    grip_n: float
    held_s: float
    creep_m: float | None
    slip_m: float | None
    creep_m_s: float | None


@dataclass(frozen=True)
class PulledObject:
    """A pull with at most cap_n. coulomb_slips: weight and pull are above the friction limit.

    slip_s: when the object has slid 2 mm along the pads, from the pull's begin, or None.
    peak_load_n: the most that weight and person loaded the contacts with until then. travel_m: how
    far it slid by the end, None where it left.
    """

    cap_n: float
    coulomb_slips: bool
    slip_s: float | None
    peak_load_n: float
    travel_m: float | None


@dataclass(frozen=True)
class PeerRun:
    """One variant at one step. drawn: how far its springs are drawn. cpu_s_per_s_min_max: of all
    holds; the hold has their median."""

    variant: str
    step_s: float
    drawn: float
    held: HeldObject
    cpu_s_per_s_min_max: list[float]
    pulls: list[PulledObject]

    def to_json(self) -> Json:
        """As it stands in mujoco.json."""
        return {
            "variant": self.variant,
            **asdict(VARIANTS[self.variant]),
            "step_s": self.step_s,
            "drawn": self.drawn,
            **asdict(self.held),
            "cpu_s_per_s_min_max": self.cpu_s_per_s_min_max,
            "pulls": [asdict(one) for one in self.pulls],
        }


def hold(scene: Scene, step_s: float, variant: Variant, drawn: float) -> HeldObject:
    """Hold for scene.hold_s, or until a pad has lost the object."""
    one = Hold(scene, step_s, variant, drawn)
    cpu_s = one.run(scene.settled_s)
    grip_n = one.grip_n
    from_m = one.z_m
    slipped_m = one.travel_m
    held_s = scene.settled_s
    creep_m = 0.0
    slip_m = 0.0
    while one.held and held_s < scene.hold_s - step_s / 2:
        more_s = min(CHUNK_S, scene.hold_s - held_s)
        cpu_s += one.run(more_s)
        if one.held:
            held_s = held_s + more_s
            creep_m = from_m - one.z_m
            slip_m = one.travel_m - slipped_m
    crept_s = held_s - scene.settled_s
    return HeldObject(
        cpu_s_per_s=cpu_s / float(one.data.time),
        grip_n=grip_n,
        held_s=held_s,
        creep_m=creep_m if one.held else None,
        slip_m=slip_m if one.held else None,
        creep_m_s=creep_m / crept_s if crept_s else None,
    )


def pull(
    scene: Scene, step_s: float, variant: Variant, drawn: float, cap_n: float
) -> PulledObject:
    """Hold until settled, then pull down with at most cap_n for scene.pull_s."""
    one = Hold(scene, step_s, variant, drawn)
    one.run(scene.settled_s)
    one.person(True, cap_n)
    z_m = one.z_m
    before_m = one.travel_m
    slip_s = None
    peak_n = 0.0
    weight_n = scene.mass_kg * GRAVITY_M_S2
    lead_m = scene.pull_m_s * scene.arm_n_s_per_m / scene.arm_n_per_m
    for k in range(round(scene.pull_s / step_s)):
        one.data.ctrl[0] = z_m - scene.pull_m_s * (k + 1) * step_s - lead_m
        one.run(step_s)
        if slip_s is None:
            peak_n = max(peak_n, weight_n - float(one.data.actuator_force[0]))
            if one.travel_m - before_m > SLIP_TRAVEL_M:
                slip_s = (k + 1) * step_s
    travel_m = one.travel_m - before_m if one.held else None
    return PulledObject(
        cap_n, weight_n + cap_n > scene.limit_n, slip_s, peak_n, travel_m
    )


def measure(
    scene: Scene, steps_s: Sequence[float] = STEPS_S, repeats: int = REPEATS
) -> list[PeerRun]:
    """All variants at all steps; CPU time is the median of `repeats` interleaved holds."""
    cases = [(name, step_s) for name in VARIANTS for step_s in steps_s]
    drawn = {case: drawn_for(scene, case[1], VARIANTS[case[0]]) for case in cases}
    holds = [
        {case: hold(scene, case[1], VARIANTS[case[0]], drawn[case]) for case in cases}
        for _ in range(repeats)
    ]
    return [
        _run(scene, case, drawn[case], [turn[case] for turn in holds]) for case in cases
    ]


def _run(
    scene: Scene, case: tuple[str, float], drawn: float, holds: Sequence[HeldObject]
) -> PeerRun:
    (name, step_s) = case
    cpu = [one.cpu_s_per_s for one in holds]
    pulls = [
        pull(scene, step_s, VARIANTS[name], drawn, cap_n) for cap_n in scene.caps_n
    ]
    held = replace(holds[0], cpu_s_per_s=statistics.median(cpu))
    return PeerRun(name, step_s, drawn, held, [min(cpu), max(cpu)], pulls)


def document(scene: Scene, runs: Sequence[PeerRun], repeats: int = REPEATS) -> Json:
    """What mujoco.json holds."""
    about = {
        "mujoco": require_mujoco("peers"),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
    return {
        "simulated": True,
        "versions": about,
        "host": {"machine": platform.machine(), "cpus": os.cpu_count()},
        "scene": asdict(scene)
        | {"limit_n": scene.limit_n, "weight_n": scene.mass_kg * GRAVITY_M_S2},
        "repeats": repeats,
        "runs": [run.to_json() for run in runs],
    }


def _row(run: PeerRun) -> str:
    held = run.held
    creep = (
        f"{held.held_s:.0f} s, then dropped"
        if held.creep_m is None
        else f"crept {1e3 * held.creep_m:.4f} mm"
    )
    slips = ", ".join(
        f"{one.cap_n:g} N "
        + ("holds" if one.slip_s is None else f"slips after {1e3 * one.slip_s:.0f} ms")
        for one in run.pulls
    )
    speed = "" if held.creep_m_s is None else f"{1e6 * held.creep_m_s:9.2f} um/s"
    return (
        f"{run.variant:<13}{1e3 * run.step_s:2.0f} ms"
        f"{1e3 * held.cpu_s_per_s:7.2f} CPU ms/s   held {creep:<22} {speed:>14}   pull {slips}"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this program."""
    parser.add_argument(
        "--out",
        type=path_argument,
        default=Path("build/bench/mujoco.json"),
        metavar="FILE",
    )


def run(args: argparse.Namespace) -> int:
    """Measure, write the JSON, print the table."""
    require_mujoco("peers")
    require_writable(args.out.parent)
    scene = Scene()
    runs = measure(scene)
    write_whole(args.out, json.dumps(document(scene, runs), indent=2) + "\n")
    for one in runs:
        print(_row(one))
    return 0


if __name__ == "__main__":
    about = "hold and pull in MuJoCo: CPU time, creep, slip"
    sys.exit(run_script("python -m benchmarks.mujoco_peer", about, add_arguments, run))
