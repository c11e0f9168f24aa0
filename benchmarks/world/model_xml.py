"""The hand and a free object as MuJoCo's XML.

The object is a rigid box, cylinder or ball with all six degrees of freedom. Each of six pads stands
on springs of its own: one along the normal (the finger), two along the skin. A pad is one sphere,
or a grid of small spheres, each on its part of the pad's springs. A fingertip is round, so the
outer points of a grid touch later and bear less; they slide first, so partial slip needs no law of
its own.

Friction is MuJoCo's: an elliptic cone with one coefficient, and the no-slip pass, without which
what is held creeps (docs/scenes.md has the figures).
"""

from __future__ import annotations

import numpy as np

from benchmarks.world.draws import HAND, SIDE, WorldTrial, half_size_m, moments_kg_m2
from holdfast.core.contract import FloatArray

LOSS_S = 2e-3
"""Damping of a finger over its stiffness, as in our scenes."""
SOLREF = "0.002 1"
"""Contacts as stiff as the steps allow, so that what yields is the finger."""
SOLIMP = "0.995 0.999 0.0005"
"""Nearly rigid: with MuJoCo's default a light pad's contact yields as much as a stiff finger."""
NOSLIP = 'noslip_iterations="30"'
REACH = 0.8
"""The fingers' row takes at most this share of the object's length."""
TIP_RADIUS_M = 0.015
"""Radius of a fingertip: by so much the outer points of a grid stand back."""
BALL_REACH = 0.35
"""On a ball the outermost pad is this share of its radius from the middle."""


class Pad:
    """How a pad is built: points of radius_m and kg each, offsets_m [P, 2] along y and z."""

    def __init__(self, radius_m: float, kg: float, offsets_m: FloatArray) -> None:
        self.radius_m = radius_m
        self.kg = kg
        self.offsets_m = offsets_m


def _grid(points: int, apart_m: float) -> FloatArray:
    """[points^2, 2] a square grid about the middle."""
    along = apart_m * (np.arange(points) - (points - 1) / 2)
    y, z = np.meshgrid(along, along, indexing="ij")
    return np.stack([y.ravel(), z.ravel()], axis=1)


PADS = {
    "point": Pad(5e-3, 5e-3, np.zeros((1, 2))),
    "grid": Pad(3e-3, 1e-3, _grid(3, 4e-3)),
}


def places_m(trial: WorldTrial) -> FloatArray:
    """[S] where the pads are along z: our hand's places, closer together on a short object."""
    along = HAND.along_m
    size = half_size_m(trial.shape, trial.numbers)
    reach = BALL_REACH if trial.shape == "ball" else REACH
    most = float(np.abs(along).max())
    scaled: FloatArray = along * min(1.0, reach * float(size[2]) / most)
    return scaled


def surface_m(trial: WorldTrial, y_m: float, z_m: float, radius_m: float) -> float:
    """Distance from the object's middle plane at which a sphere just touches, m."""
    half = half_size_m(trial.shape, trial.numbers)
    reach = float(half[0]) + radius_m
    if trial.shape == "box":
        return reach
    off = y_m**2 if trial.shape == "cylinder" else y_m**2 + z_m**2
    return float(np.sqrt(reach**2 - off))


def recess_m(trial: WorldTrial, pad: Pad, place_m: float) -> FloatArray:
    """[P] how far a pad must press before each of its points touches; 0 for the first."""
    y = pad.offsets_m[:, 0]
    z = pad.offsets_m[:, 1]
    tip = (y * y + z * z) / (2.0 * TIP_RADIUS_M)
    middle = surface_m(trial, 0.0, place_m, pad.radius_m)
    surface = [
        surface_m(trial, a, place_m + b, pad.radius_m)
        for a, b in zip(y.tolist(), z.tolist(), strict=True)
    ]
    behind = tip + middle - np.array(surface)
    recess: FloatArray = behind - behind.min()
    return recess


def mjcf(trial: WorldTrial, pad: Pad, step_s: float) -> str:
    """The trial's world as XML; a point touches the object where its joint is at its recess."""
    gravity = " ".join(f"{g:.9g}" for g in trial.gravity_m_s2)
    row = places_m(trial)
    pads = []
    for k, place_m in enumerate(row.tolist()):
        for p, behind_m in enumerate(recess_m(trial, pad, place_m).tolist()):
            pads.append(_point(trial, pad, k, p, place_m, behind_m))
    friction = trial.numbers["friction"]
    return f"""<mujoco model="second physics">
  <option timestep="{step_s:.9g}" gravity="{gravity}" integrator="implicitfast"
    cone="elliptic" solver="Newton" jacobian="dense" {NOSLIP}/>
  <default>
    <geom condim="3" friction="{friction:.9g} 0 0" solref="{SOLREF}" solimp="{SOLIMP}"/>
  </default>
  <worldbody>
    <body name="object">
      <freejoint name="free"/>
      {_inertial(trial)}
      {_shape(trial)}
    </body>
{chr(10).join(pads)}
  </worldbody>
</mujoco>
"""


def _inertial(trial: WorldTrial) -> str:
    """Mass and inertia of the full shape, about a centre that may be off its middle."""
    mass = trial.numbers["mass_kg"]
    inertia = moments_kg_m2(trial.shape, trial.numbers)
    moments = " ".join(f"{one:.9g}" for one in inertia)
    centre = " ".join(f"{one:.9g}" for one in trial.centre_m)
    return f'<inertial pos="{centre}" mass="{mass:.9g}" diaginertia="{moments}"/>'


def _shape(trial: WorldTrial) -> str:
    """The object's surface."""
    x, y, z = half_size_m(trial.shape, trial.numbers).tolist()
    kinds = {
        "box": f'type="box" size="{x:.9g} {y:.9g} {z:.9g}"',
        "cylinder": f'type="cylinder" size="{x:.9g} {z:.9g}"',
        "ball": f'type="sphere" size="{x:.9g}"',
    }
    return f'<geom {kinds[trial.shape]} contype="1" conaffinity="2"/>'


def _point(
    trial: WorldTrial, pad: Pad, k: int, p: int, place_m: float, behind_m: float
) -> str:
    """Point p of pad k, on its part of the pad's springs, behind_m from the object's surface."""
    side = float(SIDE[k])
    y_m = float(pad.offsets_m[p, 0])
    z_m = place_m + float(pad.offsets_m[p, 1])
    x_m = -side * (surface_m(trial, y_m, z_m, pad.radius_m) + behind_m)
    normal = float(trial.stiffness[k]) / len(pad.offsets_m)
    along = trial.numbers["shear_ratio"] * normal
    name = f"pad{k}_{p}"
    normal_spring = f'stiffness="{normal:.9g}" damping="{LOSS_S * normal:.9g}"'
    shear_spring = f'stiffness="{along:.9g}" damping="{LOSS_S * along:.9g}"'
    return f"""    <body name="{name}" pos="{x_m:.9g} {y_m:.9g} {z_m:.9g}" gravcomp="1">
      <joint name="{name}x" type="slide" axis="{side:g} 0 0" {normal_spring}/>
      <joint name="{name}y" type="slide" axis="0 1 0" {shear_spring}/>
      <joint name="{name}z" type="slide" axis="0 0 1" {shear_spring}/>
      <geom type="sphere" size="{pad.radius_m:g}" mass="{pad.kg:g}" contype="2" conaffinity="1"/>
    </body>"""
