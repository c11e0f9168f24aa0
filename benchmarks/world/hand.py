"""One hand and one object in MuJoCo, stepped from sample to sample.

Needs MuJoCo, which only the environment of `make world` has.
"""

from __future__ import annotations

import copy

import numpy as np

from benchmarks.world.draws import HAND, SIDE, WorldTrial
from benchmarks.world.model_xml import PADS, mjcf, places_m, recess_m
from benchmarks.world.people import Motion, Script
from holdfast.core.contract import BoolArray, FloatArray
from holdfast.simulation.loop.drive import Actuator, Drive, Opening

try:
    import mujoco
except ModuleNotFoundError:
    mujoco = None

RATE_HZ = 150.0
ACTS = 4
"""So often in a sample period the drive moves, and people and arm change their forces."""
STEPS = 2
"""Steps of the physics between two of these."""
ACT_S = 1.0 / (RATE_HZ * ACTS)
DRIVE = Drive()
MOST_N = 1e3
"""No pad presses harder, or is further away than this would bend its finger."""


class WorldDrive(Actuator):
    """Our drive on this trial's fingers: one hand, which begins open at place_n."""

    def __init__(
        self, trial: WorldTrial, place_n: float, opening: Opening = "wearer"
    ) -> None:
        self.opening = opening
        thumb = float(trial.stiffness[: HAND.thumb].sum())
        fingers = float(trial.stiffness[HAND.thumb :].sum())
        per_m = np.array([thumb * fingers / (thumb + fingers)])
        self.drive = DRIVE
        self.own_n = np.array([place_n])
        self.fastest_n_s = 1e-3 * DRIVE.stroke_mm / DRIVE.closing_s * per_m
        self.backlash_n = 1e-3 * DRIVE.backlash_mm * per_m
        self.motor_n = self.own_n.copy()
        self.place_n = self.own_n.copy()
        self.speed_n_s = np.zeros(1)


def _press(recess_m: FloatArray, n_per_m: float) -> tuple[FloatArray, FloatArray]:
    """(forces in N, how far a pad of these points must close for them in m), rising together.

    A force below 0 stands for a finger that is so far away as that force would bend it. recess_m
    [P] rises: between two of them one more point bears its part of the stiffness.
    """
    part = n_per_m / len(recess_m)
    forces = [part * float((at - recess_m).clip(0.0).sum()) for at in recess_m]
    beyond_m = float(recess_m[-1]) + MOST_N / n_per_m
    forces.append(part * float((beyond_m - recess_m).sum()))
    away = (-MOST_N, *forces)
    return np.array(away), np.concatenate([[-MOST_N / n_per_m], recess_m, [beyond_m]])


class World:
    """A trial at one moment. t_s: now. outside_n [3]: force of people and box in the last step."""

    def __init__(
        self, trial: WorldTrial, pads: str, opening: Opening = "wearer"
    ) -> None:
        self.trial = trial
        self.script = Script(trial)
        self.drive = WorldDrive(trial, self.script.place_n(0.0), opening)
        self.t_s = 0.0
        self.samples = 0
        self.outside_n = np.zeros(3)
        self._pad = PADS[pads]
        self._step_s = ACT_S / STEPS
        self._model = mujoco.MjModel.from_xml_string(
            mjcf(trial, self._pad, self._step_s)
        )
        self._data = mujoco.MjData(self._model)
        self._index(len(self._pad.offsets_m))
        self._set_springs()
        self._data.qpos[self._normals] = self._model.qpos_spring[self._normals]

    def _index(self, points: int) -> None:
        """Where the joints of each point are, and which pad a geom belongs to."""
        pads = HAND.n_contacts
        free = 7
        first = free + 3 * np.arange(pads * points).reshape(pads, points)
        self._normals = first
        self._along = np.stack([first + 1, first + 2], axis=2)
        part = self.trial.stiffness[:, None] / points
        self._normal_n_per_m = np.broadcast_to(part, first.shape)
        self._along_n_per_m = self.trial.numbers["shear_ratio"] * part[..., None]
        self._pad_of_geom = np.concatenate([[-1], np.repeat(np.arange(pads), points)])
        rows = places_m(self.trial).tolist()
        recesses = [np.sort(recess_m(self.trial, self._pad, row)) for row in rows]
        self._presses = [
            _press(recess, float(n_per_m))
            for recess, n_per_m in zip(recesses, self.trial.stiffness, strict=True)
        ]

    def copy(self) -> World:
        """The same moment again, to go on otherwise."""
        other = copy.copy(self)
        other._model = copy.copy(self._model)
        other._data = copy.copy(self._data)
        other.script = copy.copy(self.script)
        other.drive = copy.copy(self.drive)
        other.outside_n = self.outside_n.copy()
        return other

    def advance(self, target_n: float) -> None:
        """One sample period; target_n: beyond the wearer's grip, N a side.

        The hand grips for the larger one of both, until its wearer opens it; 0 for no target.
        """
        for _ in range(ACTS):
            self._act(target_n)
            mujoco.mj_step(self._model, self._data, nstep=STEPS)
        self.samples += 1
        self.t_s = self.samples / RATE_HZ
        # MuJoCo begins anew, at time 0, where it becomes unstable.
        if self._data.time < self.t_s - self._step_s:
            raise FloatingPointError(f"MuJoCo is unstable in {self.trial.kind}")

    def _act(self, target_n: float) -> None:
        """What the drive, the people and the arm do until the next time that they are asked."""
        data = self._data
        t_s = float(data.time)
        place_n = self.script.place_n(t_s + ACT_S)
        opens = np.array([t_s >= self.trial.open_s])
        counts_n = self.drive.obeyed_n(np.array([target_n]), opens)
        self.drive.step(counts_n, ACT_S, np.array([place_n]))
        self._set_springs()

        self._model.opt.gravity[:] = self.script.gravity_m_s2(t_s)
        push = self.script.push(t_s, self.motion())
        data.xfrc_applied[1, :3] = push.force_n
        data.xfrc_applied[1, 3:] = push.moment_n_m
        self.outside_n = push.force_n

    def _set_springs(self) -> None:
        """The drive's place moves the other ends of the fingers' springs."""
        shares_n = (self.trial.share * self.drive.place_n[0]).tolist()
        closed_m = []
        for share_n, press in zip(shares_n, self._presses, strict=True):
            closed_m.append(float(np.interp(share_n, *press)))
        self._model.qpos_spring[self._normals] = np.array(closed_m)[:, None]

    def motion(self) -> Motion:
        """Where the object is."""
        data = self._data
        turn = data.xmat[1].reshape(3, 3) if data.time > 0.0 else np.eye(3)
        turning = turn @ data.qvel[3:6]
        return Motion(data.qpos[:3].copy(), turn, data.qvel[:3].copy(), turning)

    def touching(self) -> BoolArray:
        """[S] whether each pad touches."""
        touching = np.zeros(HAND.n_contacts, dtype=np.bool_)
        if self._data.ncon:
            geoms = self._data.contact.geom.max(axis=1)
            touching[self._pad_of_geom[geoms]] = True
        return touching

    @property
    def gripped(self) -> bool:
        """Thumb and fingers both touch."""
        touching = self.touching()
        return bool(touching[: HAND.thumb].any() and touching[HAND.thumb :].any())

    def forces_n(self) -> FloatArray:
        """[S, 3] on the fingertips, as our scenes have them: shear x, shear y, normal.

        By how far each spring yields: MuJoCo's contact force itself rings.
        """
        data = self._data
        away_m = self._model.qpos_spring[self._normals] - data.qpos[self._normals]
        normal_n = (self._normal_n_per_m * away_m).sum(axis=1)
        shear_n = (self._along_n_per_m * data.qpos[self._along]).sum(axis=1)
        # The sensors of thumb and fingers face each other.
        forces: FloatArray = np.stack(
            [shear_n[:, 0], -SIDE * shear_n[:, 1], np.maximum(normal_n, 0.0)], axis=1
        )
        return forces

    def contact_places_m(self) -> FloatArray:
        """[S, 3] the pads' middles in the object's frame: they move where a pad slides."""
        data = self._data
        turn = data.xmat[1].reshape(3, 3)
        points = data.xpos[2:].reshape(HAND.n_contacts, -1, 3).mean(axis=1)
        places: FloatArray = (points - data.xpos[1]) @ turn
        return places

    def energy_j(self) -> float:
        """Of the motion, the springs and the height of the object."""
        data = self._data
        model = self._model
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        return float(data.energy.sum())
