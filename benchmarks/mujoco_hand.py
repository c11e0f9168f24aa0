"""The closed loop's hand and object in MuJoCo, stepped in place of our core (mujoco_loop.py).

Springs, friction, people, drive and their times are those of our trial; MuJoCo solves the contacts
and moves the object. What differs:

- our fingers have no mass, these weigh 5 g each;
- friction is a soft constraint; the no-slip pass makes it hold;
- a pad is a sphere of 5 mm on a cylinder, whose radii together are the radius of our cylinder;
- people act on the place and speed of the step before (explicit), ours on the new ones (implicit).

The object moves and does not turn, as in our core. Friction is the static one, so an object of this
comparison has kinetic_share = 1.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.simulation.body import Body, Inputs, Pull
from holdfast.simulation.loop_physics import HandsAndObjects
from holdfast.simulation.run import TrialMotion

PAD_M = 5e-3
PAD_KG = 5e-3
SOLREF = "0.002 1"
"""As stiff as our steps allow: two of them."""
NOSLIP = 'noslip_iterations="20"'


class State:
    """What a loop reads of a world: agents_n [3, B]."""

    def __init__(self, lanes: int) -> None:
        self.agents_n = np.zeros((3, lanes))


class MujocoWorld:
    """One trial in all lanes, with the interface of HandsAndObjects; ours: the world it replaces.

    forces_n [B, S, 3], position_m [B, 3]: at the last sample.
    """

    def __init__(self, ours: HandsAndObjects) -> None:
        self._ours = ours
        self._spans = ours.spans
        self._pieces = ours.pieces
        self._rate_hz = ours.settings.rate_hz
        self._dt_s = 1.0 / (self._rate_hz * self._pieces)
        self._body = ours.body
        lanes = len(ours.position_m)
        self._model = mujoco.MjModel.from_xml_string(mjcf(ours.body, self._dt_s))
        self._data = mujoco.MjData(self._model)
        self._pads = _joints(self._model, len(ours.forces_n[0]))
        start_s = np.full((1, lanes), self._spans.begins / self._rate_hz)
        closure_m = ours.script.chunk(start_s)[0].closure_m[:, 0]
        self._data.qpos[self._pads[:, 0]] = closure_m
        self.state = State(lanes)
        self._travel_m = np.zeros(len(self._pads))
        self.forces_n = ours.forces_n.copy()
        self.position_m = ours.position_m.copy()
        self._steps: list[tuple[float, FloatArray, bool, float]] = []

    def advance(self, period: int, target_n: FloatArray) -> None:
        """One sample period; target_n [B]: of the drives."""
        at = int(self._spans.begins[0]) + period
        if not self._spans.moves[0] <= at < self._spans.ends[0]:
            return
        drive = self._ours.actuator
        script = self._ours.script
        ends_s = (at + np.arange(1, self._pieces + 1) / self._pieces) / self._rate_hz
        script.own_n = script.own_place_n(ends_s[:, None] + 0.0 * target_n)
        places_n = [drive.step(target_n, self._dt_s, own_n) for own_n in script.own_n]
        script.place_n = np.stack(places_n)
        for now, t_s in zip(
            script.chunk(ends_s[:, None] + 0.0 * target_n), ends_s, strict=True
        ):
            self._step(now, float(t_s))
        self.forces_n[:] = self._fingertips_n()
        self.position_m[:] = self._data.qpos[:3]

    def _step(self, now: Inputs, t_s: float) -> None:
        model = self._model
        data = self._data
        pads = self._pads
        model.qpos_spring[pads[:, 0]] = now.closure_m[:, 0]
        load_n = sum((self._person_n(one) for one in now.people), start=np.zeros(3))
        data.qfrc_applied[:3] = load_n
        mujoco.mj_step(model, data)
        touching = self._touching()
        apart = data.qvel[1:3] - data.qvel[pads[:, 1:]]
        self._travel_m += np.sqrt((apart * apart).sum(axis=1)) * self._dt_s
        slip_m = float(self._travel_m[touching].mean()) if touching.any() else 0.0
        self.state.agents_n[:] = load_n[:, None]
        self._steps.append((t_s, load_n, bool(touching.any()), slip_m))

    def _person_n(self, person: Pull) -> FloatArray:
        """[3] force of a person: a capped, damped spring to a target, and a share of the weight."""
        place_m = self._data.qpos[:3]
        speed_m_s = self._data.qvel[:3]
        to_go_m = person.target_m[:, 0] - place_m
        reach_n = person.stiffness_n_per_m[0] * np.linalg.norm(
            to_go_m - speed_m_s * self._dt_s
        )
        share = min(1.0, person.cap_n[0] / max(float(reach_n), 1e-12))
        damper_n = person.damping_n_s_per_m[0] * (person.target_m_s[:, 0] - speed_m_s)
        pull_n = share * (person.stiffness_n_per_m[0] * to_go_m + damper_n)
        weight_n = self._body.mass_kg[0] * self._body.gravity_m_s2[:, 0]
        force_n: FloatArray = pull_n - person.weight_share[0] * weight_n
        return force_n

    def _touching(self) -> BoolArray:
        """[S] whether each pad has contact."""
        touching = np.zeros(len(self._pads), dtype=np.bool_)
        for k in range(self._data.ncon):
            touching[int(max(self._data.contact[k].geom)) - 1] = True
        return touching

    def _fingertips_n(self) -> FloatArray:
        """[S, 3] as run.forces_of has them: shear x, y, normal, by the fingers' springs.

        A fingertip feels how far it yields, not the contact's own force: that one rings, and is
        zero for a step now and then while the pad slides. The spring across the object also bears
        what the normal force of a cylinder leans aside.
        """
        body = self._body
        pads = self._pads
        data = self._data
        shear_n = data.qpos[pads[:, 1:]] * body.brush_n_per_m.sum(axis=0)[:, :1]
        yields_m = self._model.qpos_spring[pads[:, 0]] - data.qpos[pads[:, 0]]
        normals_n = np.maximum(body.stiffness_n_per_m[:, 0] * yields_m, 0.0)
        aside_m = data.qpos[1] - data.qpos[pads[:, 1]] - body.at_m[0, :, 0]
        shear_n[:, 0] += normals_n * aside_m * body.curvature_per_m[0, 0]
        return np.stack(
            [shear_n[:, 0], shear_n[:, 1] * -body.side[:, 0], normals_n], axis=1
        )

    def motion(
        self, lane: int, forces_n: FloatArray, position_m: FloatArray
    ) -> TrialMotion:
        """What became of the trial, as our core gives it; every step counts as without slip."""
        at_s, agents_n, gripped, slip_m = (
            np.array(part) for part in zip(*self._steps, strict=True)
        )
        never = np.zeros(len(at_s), dtype=np.bool_)
        t_s = np.arange(len(forces_n)) / self._rate_hz
        return TrialMotion(
            t_s, forces_n, position_m, at_s, agents_n, gripped, never, never, slip_m
        )


def _joints(model: Any, pads: int) -> Any:
    """[S, 3] index of each pad's joints: normal, y, z."""
    names = [[f"pad{k}{axis}" for axis in "xyz"] for k in range(pads)]
    return np.array([[model.joint(name).id for name in one] for one in names])


def mjcf(body: Body, step_s: float) -> str:
    """The first lane of a body as MuJoCo's XML."""
    radius_m = 1.0 / body.curvature_per_m[0, 0] - PAD_M
    gravity = " ".join(f"{g:.9g}" for g in body.gravity_m_s2[:, 0])
    pads = "\n".join(_pad(body, k, radius_m + PAD_M) for k in range(len(body.side)))
    return f"""<mujoco model="closed loop">
  <option timestep="{step_s:.9g}" gravity="{gravity}" integrator="implicitfast"
    cone="elliptic" solver="Newton" jacobian="dense" {NOSLIP}/>
  <default>
    <geom condim="3" friction="{body.static[0]:.9g} 0 0" solref="{SOLREF}"/>
  </default>
  <worldbody>
    <body name="object">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="cylinder" size="{radius_m:.9g} {body.straight_m[0]:.9g}"
        mass="{body.mass_kg[0]:.9g}" contype="1" conaffinity="2"/>
    </body>
{pads}
  </worldbody>
</mujoco>
"""


def _pad(body: Body, k: int, reach_m: float) -> str:
    side = float(body.side[k, 0])
    normal = float(body.stiffness_n_per_m[k, 0])
    along = float(body.brush_n_per_m[:, k, 0].sum())
    loss_s = body.loss_s
    damping = float(body.damping_n_s_per_m[k, 0])
    y_m, z_m = body.at_m[:, k, 0]
    return f"""    <body name="pad{k}" pos="{-side * reach_m:.9g} {y_m:.9g} {z_m:.9g}" gravcomp="1">
      <joint name="pad{k}x" type="slide" axis="{side:g} 0 0" stiffness="{normal:.9g}"
        damping="{damping:.9g}"/>
      <joint name="pad{k}y" type="slide" axis="0 1 0" stiffness="{along:.9g}"
        damping="{loss_s * along:.9g}"/>
      <joint name="pad{k}z" type="slide" axis="0 0 1" stiffness="{along:.9g}"
        damping="{loss_s * along:.9g}"/>
      <geom type="sphere" size="{PAD_M}" mass="{PAD_KG}" contype="2" conaffinity="1"/>
    </body>"""
