"""Hold and pull as MuJoCo's XML: the scene, and the variants of MuJoCo's options that are compared.

An upright cylinder with the mass of the 60 mm ball, two thumb pads against four finger pads, every
pad on springs of its own (normal and along the surface). A person pulls it down: a damped spring to
a moving target that never pulls harder than a cap. Like our core's, the object moves and does not
turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

GRAVITY_M_S2 = 9.81


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
        """The load along the surface at which Coulomb contacts slide."""
        return 2.0 * self.friction * self.grip_n

    @property
    def arm_n_s_per_m(self) -> float:
        """Damping of the person's arm."""
        return (
            2.0
            * self.arm_damping_ratio
            * float(np.sqrt(self.arm_n_per_m * self.mass_kg))
        )


THUMB_Z_M = (0.012, -0.012)
FINGER_Z_M = (0.033, 0.011, -0.011, -0.033)


@dataclass(frozen=True)
class Variant:
    """What a user of MuJoCo chooses: the contact's solref, and attributes of <option>."""

    solref: str = "0.004 1"
    options: Mapping[str, str] = field(default_factory=dict)


VARIANTS = {
    "default": Variant(solref="0.02 1"),
    "stiff": Variant(),
    "impratio 10": Variant(options={"impratio": "10"}),
    "impratio 100": Variant(options={"impratio": "100"}),
    "noslip": Variant(options={"noslip_iterations": "10"}),
    "noslip exact": Variant(
        options={"noslip_iterations": "100", "noslip_tolerance": "0"}
    ),
}
"""All: elliptic cone, implicitfast, Newton. In order: MuJoCo's default contact; one as stiff as a
step of 2 ms allows (solref is two steps); that with the documentation's advice for grasping; with
the value of published robot models; with the no-slip pass; and with that pass run to its end, which
its tolerance otherwise cuts short."""


def mjcf(scene: Scene, step_s: float, variant: Variant, drawn: float = 1.0) -> str:
    """The scene as MuJoCo's XML.

    drawn: how far the fingers' springs are drawn, over what rigid contacts would need.
    Dense Jacobian: right for 21 degrees of freedom, and out of reach of a fault in 4.0.0's sparse
    factorisation.
    """
    extra = "".join(f' {name}="{value}"' for name, value in variant.options.items())
    pads = [
        _pad(scene, f"thumb{k}", -1.0, z, drawn * scene.grip_n / 2)
        for k, z in enumerate(THUMB_Z_M)
    ]
    pads += [
        _pad(scene, f"finger{k}", 1.0, z, drawn * scene.grip_n / 4)
        for k, z in enumerate(FINGER_Z_M)
    ]
    arm = scene.arm_n_per_m
    damping = scene.arm_n_s_per_m
    return f"""<mujoco model="hold and pull">
  <option timestep="{step_s:g}" gravity="0 0 -{GRAVITY_M_S2:g}" integrator="implicitfast"
    cone="elliptic" solver="Newton" jacobian="dense"{extra}/>
  <default>
    <geom condim="3" friction="{scene.friction:g} 0 0" solref="{variant.solref}"/>
  </default>
  <worldbody>
    <body name="object">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="cylinder" size="{scene.radius_m:g} {scene.half_length_m:g}"
        mass="{scene.mass_kg:g}" contype="1" conaffinity="2"/>
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
    """A fingertip that just touches; its drawn spring presses with press_n."""
    at_m = side * (scene.radius_m + scene.pad_radius_m)
    drawn_m = press_n / scene.normal_n_per_m
    along = scene.along_n_per_m
    loss = scene.finger_loss_s
    return f"""    <body name="{name}" pos="{at_m:g} 0 {z_m:g}" gravcomp="1">
      <joint name="{name}x" type="slide" axis="{-side:g} 0 0" stiffness="{scene.normal_n_per_m:g}"
        springref="{drawn_m:.9g}" damping="{loss * scene.normal_n_per_m:g}"/>
      <joint name="{name}y" type="slide" axis="0 1 0" stiffness="{along:g}"
        damping="{loss * along:g}"/>
      <joint name="{name}z" type="slide" axis="0 0 1" stiffness="{along:g}"
        damping="{loss * along:g}"/>
      <geom type="sphere" size="{scene.pad_radius_m:g}" mass="{scene.pad_kg:g}" contype="2"
        conaffinity="1"/>
    </body>"""
