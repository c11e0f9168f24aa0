"""`make peers`: the same hold and pull in MuJoCo, to put our own scenes' price and creep beside.

The scene: an upright cylinder with the mass of the 60 mm ball, two thumb pads against four finger
pads, every pad on springs of its own (normal and along the surface); held for 60 s, then pulled
down by a person, a damped spring to a moving target that never pulls harder than a cap. Like our
core's, the object moves and does not turn.

What MuJoCo does otherwise, and what follows for a comparison:

- its friction is a soft constraint: below the limit a contact still slides, at a speed in
  proportion to the load (MuJoCo documentation, "Modeling: preventing slip"; issue 3328 of its
  repository). impratio makes it slower, the no-slip pass all but stops it;
- one friction coefficient, not a static and a kinetic one: the static one is used;
- the fingertips need a mass (ours have none), and how fast an object creeps depends on it;
- contacts give way too, more than the fingers with the default solref, so the fingers' springs are
  drawn further until the grip is the asked one, and all variants but the first have contacts as
  stiff as the longer step allows.

CPU time is of `mj_step` alone: no compiling of the model, no Python between the steps of the hold.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from edge_runtime.command import Parser, finish, path_argument
from edge_runtime.errors import UsageError
from edge_runtime.writing import require_writable, write_whole

try:
    import mujoco
except ModuleNotFoundError:
    mujoco = None

GRAVITY_M_S2 = 9.81
STEPS_S = (1e-3, 2e-3)
REPEATS = 3
CHUNK_S = 0.1
"""A hold is looked at so often."""
SLIP_TRAVEL_M = 2e-3
"""Gross slip, as in our scenes: so far along the surface (mean of the pads, their own stretch not
counted).

The fingers, which press with half a thumb pad's force, let go first: 2 mm can pass before the thumb
has let go.
"""


@dataclass(frozen=True)
class Scene:
    """Hold and pull: SI units; grip_n is the sum of the normal forces of either side."""

    mass_kg: float = 0.1979
    radius_m: float = 0.03
    half_length_m: float = 0.1
    grip_n: float = 12.0
    friction: float = 0.6
    normal_n_per_m: float = 600.0
    along_n_per_m: float = 500.0
    finger_loss_s: float = 2e-3
    pad_kg: float = 0.03
    pad_radius_m: float = 0.008
    hold_s: float = 60.0
    settled_s: float = 1.0
    arm_n_per_m: float = 1500.0
    arm_damping_ratio: float = 0.7
    pull_m_s: float = 0.1
    pull_s: float = 2.0
    caps_n: tuple[float, ...] = (8.0, 16.0)

    @property
    def limit_n(self) -> float:
        """The load along the surface at which Coulomb's contacts let go."""
        return 2.0 * self.friction * self.grip_n

    @property
    def arm_n_s_per_m(self) -> float:
        """Damping of the person's arm."""
        return 2.0 * self.arm_damping_ratio * float(np.sqrt(self.arm_n_per_m * self.mass_kg))


THUMB_Z_M = (0.012, -0.012)
FINGER_Z_M = (0.033, 0.011, -0.011, -0.033)


@dataclass(frozen=True)
class Variant:
    """What MuJoCo's user may choose: the contact's solref, and attributes of <option> beside those
    all share."""

    solref: str = "0.004 1"
    options: Mapping[str, str] = field(default_factory=dict)


VARIANTS = {
    "default": Variant(solref="0.02 1"),
    "stiff": Variant(),
    "impratio 10": Variant(options={"impratio": "10"}),
    "impratio 100": Variant(options={"impratio": "100"}),
    "noslip": Variant(options={"noslip_iterations": "10"}),
    "noslip exact": Variant(options={"noslip_iterations": "100", "noslip_tolerance": "0"}),
}
"""All: elliptic cone, implicitfast, Newton. MuJoCo's own contact; one as stiff as a step of 2 ms
allows (solref is two steps); that with the documentation's advice for grasping; with what published
robot models have; with the no-slip pass; and with that pass taken to its end, which its tolerance
otherwise cuts short."""


def mjcf(scene: Scene, step_s: float, variant: Variant, drawn: float = 1.0) -> str:
    """The scene as MuJoCo's XML; drawn: the fingers' springs over what they were without the
    contacts giving way.

    Dense Jacobian: right for 21 degrees of freedom, and out of reach of a fault in 4.0.0's sparse
    factorisation.
    """
    extra = "".join(f' {name}="{value}"' for name, value in variant.options.items())
    pads = [
        _pad(scene, f"thumb{k}", -1.0, z, drawn * scene.grip_n / 2) for k, z in enumerate(THUMB_Z_M)
    ]
    pads += [
        _pad(scene, f"finger{k}", 1.0, z, drawn * scene.grip_n / 4)
        for k, z in enumerate(FINGER_Z_M)
    ]
    arm, damping = scene.arm_n_per_m, scene.arm_n_s_per_m
    return f"""<mujoco model="hold and pull">
  <option timestep="{step_s:g}" gravity="0 0 -{GRAVITY_M_S2:g}" integrator="implicitfast" cone="elliptic"
    solver="Newton" jacobian="dense"{extra}/>
  <default>
    <geom condim="3" friction="{scene.friction:g} 0 0" solref="{variant.solref}"/>
  </default>
  <worldbody>
    <body name="object">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="cylinder" size="{scene.radius_m:g} {scene.half_length_m:g}" mass="{scene.mass_kg:g}"
        contype="1" conaffinity="2"/>
    </body>
{chr(10).join(pads)}
  </worldbody>
  <actuator>
    <general name="person" joint="z" group="1" gaintype="fixed" gainprm="{arm:g}"
      biastype="affine" biasprm="0 -{arm:g} -{damping:.6g}" forcelimited="true" forcerange="-1 1"/>
  </actuator>
</mujoco>
"""


def _pad(scene: Scene, name: str, side: float, z_m: float, press_n: float) -> str:
    """A fingertip that just touches; its spring is drawn so far that it presses with press_n."""
    at_m, drawn_m = side * (scene.radius_m + scene.pad_radius_m), press_n / scene.normal_n_per_m
    along, loss = scene.along_n_per_m, scene.finger_loss_s
    return f"""    <body name="{name}" pos="{at_m:g} 0 {z_m:g}" gravcomp="1">
      <joint name="{name}x" type="slide" axis="{-side:g} 0 0" stiffness="{scene.normal_n_per_m:g}"
        springref="{drawn_m:.9g}" damping="{loss * scene.normal_n_per_m:g}"/>
      <joint name="{name}y" type="slide" axis="0 1 0" stiffness="{along:g}" damping="{loss * along:g}"/>
      <joint name="{name}z" type="slide" axis="0 0 1" stiffness="{along:g}" damping="{loss * along:g}"/>
      <geom type="sphere" size="{scene.pad_radius_m:g}" mass="{scene.pad_kg:g}" contype="2" conaffinity="1"/>
    </body>"""


class Hold:
    """A compiled scene, and the readings of it that are asked for."""

    def __init__(self, scene: Scene, step_s: float, variant: Variant, drawn: float = 1.0) -> None:
        self.scene, self.step_s = scene, step_s
        self.model = _mujoco().MjModel.from_xml_string(mjcf(scene, step_s, variant, drawn))
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
        return float(np.mean([self.data.joint(f"{pad}z").qpos[0] for pad in self.pads])) - self.z_m

    @property
    def held(self) -> bool:
        """All pads touch."""
        return int(self.data.ncon) == len(self.pads)

    @property
    def grip_n(self) -> float:
        """Normal force of either side: half the sum of all contacts'."""
        force, sum_n = np.zeros(6), 0.0
        for k in range(self.data.ncon):
            mujoco.mj_contactForce(self.model, self.data, k, force)
            sum_n += float(force[0])
        return sum_n / 2


def drawn_for(scene: Scene, step_s: float, variant: Variant, rounds: int = 8) -> float:
    """How much further the springs are to be drawn for the asked grip; without gravity, so that
    nothing slides."""
    drawn = 1.0
    for _ in range(rounds):
        held = Hold(scene, step_s, variant, drawn)
        held.model.opt.gravity[:] = 0.0
        held.run(scene.settled_s)
        drawn *= scene.grip_n / held.grip_n
    return drawn


def hold(scene: Scene, step_s: float, variant: Variant, drawn: float) -> dict[str, Any]:
    """Hold for scene.hold_s, or until a pad has lost the object.

    creep_m: how far it sank from settled_s on, None where it did not stay; creep_m_s: in a second,
    while it was held; slip_m: the part of it that is slip along the pads; held_s; cpu_s_per_s: CPU
    s per simulated s.
    """
    one = Hold(scene, step_s, variant, drawn)
    cpu_s = one.run(scene.settled_s)
    grip_n, from_m, slipped_m = one.grip_n, one.z_m, one.travel_m
    held_s, creep_m, slip_m = scene.settled_s, 0.0, 0.0
    while one.held and held_s < scene.hold_s - step_s / 2:
        more_s = min(CHUNK_S, scene.hold_s - held_s)
        cpu_s += one.run(more_s)
        if one.held:
            held_s, creep_m, slip_m = held_s + more_s, from_m - one.z_m, one.travel_m - slipped_m
    crept_s = held_s - scene.settled_s
    return {
        "cpu_s_per_s": cpu_s / float(one.data.time),
        "grip_n": grip_n,
        "held_s": held_s,
        "creep_m": creep_m if one.held else None,
        "slip_m": slip_m if one.held else None,
        "creep_m_s": creep_m / crept_s if crept_s else None,
    }


def pull(
    scene: Scene, step_s: float, variant: Variant, drawn: float, cap_n: float
) -> dict[str, Any]:
    """Hold until settled, then pull down with at most cap_n for scene.pull_s.

    slip_s: when the object has slid 2 mm along the pads, from the pull's begin, or None;
    peak_load_n: the most that weight and person loaded the contacts with until then; travel_m: how
    far it slid by the end, None where it left.
    """
    one = Hold(scene, step_s, variant, drawn)
    one.run(scene.settled_s)
    one.person(True, cap_n)
    z_m, before_m = one.z_m, one.travel_m
    slip_s, peak_n, weight_n = None, 0.0, scene.mass_kg * GRAVITY_M_S2
    lead_m = scene.pull_m_s * scene.arm_n_s_per_m / scene.arm_n_per_m
    for k in range(round(scene.pull_s / step_s)):
        one.data.ctrl[0] = z_m - scene.pull_m_s * (k + 1) * step_s - lead_m
        one.run(step_s)
        if slip_s is None:
            peak_n = max(peak_n, weight_n - float(one.data.actuator_force[0]))
            if one.travel_m - before_m > SLIP_TRAVEL_M:
                slip_s = (k + 1) * step_s
    return {
        "cap_n": cap_n,
        "coulomb_slips": weight_n + cap_n > scene.limit_n,
        "slip_s": slip_s,
        "peak_load_n": peak_n,
        "travel_m": one.travel_m - before_m if one.held else None,
    }


def measure(
    scene: Scene | None = None, steps_s: Sequence[float] = STEPS_S, repeats: int = REPEATS
) -> dict[str, Any]:
    """All variants at all steps; CPU time is the median of `repeats` holds, in turns. UsageError
    without MuJoCo."""
    about = {
        "mujoco": _mujoco().__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
    scene = scene or Scene()
    cases = [(name, step_s) for name in VARIANTS for step_s in steps_s]
    drawn = {case: drawn_for(scene, case[1], VARIANTS[case[0]]) for case in cases}
    holds = [
        {case: hold(scene, case[1], VARIANTS[case[0]], drawn[case]) for case in cases}
        for _ in range(repeats)
    ]
    return {
        "simulated": True,
        "versions": about,
        "host": {"machine": platform.machine(), "cpus": os.cpu_count()},
        "scene": asdict(scene)
        | {"limit_n": scene.limit_n, "weight_n": scene.mass_kg * GRAVITY_M_S2},
        "repeats": repeats,
        "runs": [_run(scene, case, drawn[case], [turn[case] for turn in holds]) for case in cases],
    }


def _run(
    scene: Scene, case: tuple[str, float], drawn: float, holds: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    (name, step_s), cpu = case, [one["cpu_s_per_s"] for one in holds]
    return {
        "variant": name,
        **asdict(VARIANTS[name]),
        "step_s": step_s,
        "drawn": drawn,
        **holds[0],
        "cpu_s_per_s": statistics.median(cpu),
        "cpu_s_per_s_min_max": [min(cpu), max(cpu)],
        "pulls": [pull(scene, step_s, VARIANTS[name], drawn, cap_n) for cap_n in scene.caps_n],
    }


def _mujoco() -> Any:
    if mujoco is None:
        raise UsageError(
            "this needs MuJoCo, which is not installed here",
            cause="peers have an environment of their own, outside .venv",
            next_step="make peers",
        )
    return mujoco


def _row(run: dict[str, Any]) -> str:
    creep = (
        f"{run['held_s']:.0f} s, then dropped"
        if run["creep_m"] is None
        else f"crept {1e3 * run['creep_m']:.4f} mm"
    )
    slips = ", ".join(
        f"{p['cap_n']:g} N "
        + ("holds" if p["slip_s"] is None else f"slips after {1e3 * p['slip_s']:.0f} ms")
        for p in run["pulls"]
    )
    return (
        f"{run['variant']:<13}{1e3 * run['step_s']:2.0f} ms{1e3 * run['cpu_s_per_s']:7.2f} CPU ms/s   "
        f"held {creep:<22} {1e6 * run['creep_m_s']:9.2f} um/s   pull {slips}"
    )


def main(argv: Sequence[str]) -> int:
    """Parse, measure, write the JSON, print the table."""
    parser = Parser(
        prog="mujoco_peer", description="hold and pull in MuJoCo: CPU time, creep, slip"
    )
    parser.add_argument(
        "--out", type=path_argument, default=Path("build/bench/mujoco.json"), metavar="FILE"
    )
    args = parser.parse_args(argv)
    _mujoco()
    require_writable(args.out.parent)
    result = measure()
    write_whole(args.out, json.dumps(result, indent=2) + "\n")
    for run in result["runs"]:
        print(_row(run))
    return 0


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
