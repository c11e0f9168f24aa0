"""What the page's world is set up with: an object of the thesis in a hand, as a scene's trial."""

from __future__ import annotations

import numpy as np

from holdfast.simulation.loop.drive import Actuator, Drive
from holdfast.simulation.physics.body import Body
from holdfast.simulation.physics.contacts import pressure
from holdfast.simulation.physics.objects import OBJECTS, hand_of_counts
from holdfast.simulation.scenes.protocol import PlannedTrial, TrialsRow, draw_trial
from holdfast.simulation.scenes.script import body_of

ELEMENTS = 5
"""Of a contact's brush, as in the thesis' scene."""
SEED = 4
NOMINAL = {
    "tilt_deg": 0.0,
    "roll_deg": 0.0,
    "friction_factor": 1.0,
    "finger_n_per_m": 650.0,
    "shear_ratio": 1.3,
}
"""The middle of what scenes draw. Shares of the grip and places of the contacts are drawn."""


def trial_of(name: str) -> PlannedTrial:
    """The page's trial with an object of the thesis."""
    held = OBJECTS[name]
    row = TrialsRow((name,), "pull", "page", 1, NOMINAL)
    return draw_trial(0, held, row, SEED, hand_of_counts())


def body_numbers(body: Body, trial: int = 0) -> list[float]:
    """A trial's constants in the order of `scene_body` in scene.h."""
    parts = (
        body.mass_kg,
        body.gravity_m_s2,
        body.curvature_per_m,
        body.straight_m,
        body.at_m,
        body.stiffness_n_per_m,
        body.damping_n_s_per_m,
        # Every element of a contact has the same spring.
        body.brush_n_per_m[0],
    )
    numbers = [np.ravel(part[..., trial]) for part in parts]
    friction = [body.static[trial], body.kinetic[trial]]
    rest = [body.pressure.ravel(), friction, [body.stribeck_m_s, body.loss_s]]
    return [float(x) for x in np.concatenate([*numbers, *rest])]


def setup_numbers(name: str) -> list[float]:
    """An object's setup in the order of `try_setup` in try.c, but for its last, the grip."""
    trial = trial_of(name)
    # numpy sums a single trial in another order than many.
    drive = Actuator(Drive(), [trial, trial])
    body = body_of([trial, trial], pressure(ELEMENTS))
    figures = [1e-3 * drive.drive.lag_ms, drive.fastest_n_s[0], drive.drive.ceiling_n]
    numbers = [*trial.share, *figures, drive.backlash_n[0]]
    return body_numbers(body) + [float(x) for x in numbers]
