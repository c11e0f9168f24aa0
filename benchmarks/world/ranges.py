"""What is drawn for a trial of the second physics, from which range, and where the range is from.

One table, and nothing else decides how hard a kind of trial is. The ranges are those that scenes
must cover too (../../docs/results.md); none was chosen by looking at what a model does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Range:
    """One number that is drawn: evenly between low and high, or evenly in its logarithm."""

    name: str
    low: float
    high: float
    unit: str
    about: str
    source: str
    log: bool = False

    def draw(self, rng: np.random.Generator) -> float:
        """One draw."""
        if not self.log:
            return float(rng.uniform(self.low, self.high))
        exponent = rng.uniform(np.log(self.low), np.log(self.high))
        return float(np.exp(exponent))


ASSUMED = "assumed"
OURS = "as in our scenes (assumed there)"

TABLE = (
    # the object
    Range("mass_kg", 0.01, 0.8, "kg", "mass", "things of a household", log=True),
    Range("friction", 0.2, 1.2, "", "friction coefficient on silicone", ASSUMED),
    Range("half_width_m", 0.012, 0.04, "m", "half width between the fingers", ASSUMED),
    Range("half_depth_m", 0.012, 0.04, "m", "half depth of a box", ASSUMED),
    Range("half_length_m", 0.03, 0.1, "m", "half length of a box or cylinder", ASSUMED),
    Range("off_centre_share", 0.0, 1.0, "", "below 0.3: off-centre mass", ASSUMED),
    Range("off_centre", 0.1, 0.4, "of half the size", "how far off centre", ASSUMED),
    # the hand
    Range("friction_used", 0.1, 0.8, "", "of the hold at its peak load", ASSUMED),
    Range(
        "finger_n_per_m", 200.0, 6000.0, "N/m", "a finger's stiffness", ASSUMED, True
    ),
    Range("shear_ratio", 1.0, 1.6, "", "stiffness along the skin over it", OURS),
    Range("share_spread", 0.0, 0.3, "", "spread of the fingers' shares", ASSUMED),
    Range("tremor_m_s2", 0.0, 0.2, "m/s2", "tremor, amplitude", ASSUMED),
    Range("tremor_hz", 4.0, 12.0, "Hz", "its frequency", "essential tremor"),
    Range("fluctuation", 0.0, 0.03, "", "rms of the grip over its mean", ASSUMED),
    # the beginning of every trial
    Range("rest_s", 0.65, 0.9, "s", "empty hand before it closes", "model's filters"),
    Range("closing_s", 0.3, 0.5, "s", "closing, and again loading", OURS),
    Range("give_after_s", 0.15, 0.4, "s", "until the giver lets go", OURS),
    Range("give_s", 0.1, 0.5, "s", "how long letting go takes", ASSUMED),
    Range("hold_s", 0.6, 1.5, "s", "quiet hold before the event", ASSUMED),
    # a person who pulls, tugs or takes
    Range("force_n", 1.0, 50.0, "N", "largest pull of a person", ASSUMED, log=True),
    Range("arm_n_per_m", 300.0, 3000.0, "N/m", "stiffness of an arm", ASSUMED, True),
    Range("grab_m", 0.0, 0.015, "m", "where the pull grips, off the centre", ASSUMED),
    Range("pull_m", 0.15, 0.3, "m", "how far a puller moves", OURS),
    Range("fast_s", 0.1, 0.5, "s", "a fast pull's move", ASSUMED),
    Range("slow_s", 0.5, 2.0, "s", "a slow pull's move", ASSUMED),
    Range("tug_s", 0.03, 0.4, "s", "a tug's move", ASSUMED, log=True),
    Range("tug_m", 0.05, 0.2, "m", "how far a tug moves", ASSUMED),
    Range("receiver_n", 4.0, 12.0, "N", "largest pull of a receiver", OURS),
    Range("receiver_arm_n_per_m", 150.0, 600.0, "N/m", "a receiver's arm", OURS, True),
    Range("take_s", 0.2, 0.6, "s", "a receiver takes the weight over", OURS),
    Range("move_s", 1.0, 2.2, "s", "a receiver's move", OURS),
    Range("distance_m", 0.08, 0.25, "m", "how far a receiver moves", OURS),
    # the wearer
    Range("open_after_s", 0.25, 0.8, "s", "from taking to opening", OURS),
    Range("late_s", 1.0, 2.0, "s", "the same of a wearer who opens late", ASSUMED),
    Range("opening_s", 0.3, 0.5, "s", "how long opening takes", OURS),
    Range("signal_s", 0.08, 0.15, "s", "muscle signal before opening", OURS),
    # falls
    Range("weak_grip", 0.2, 0.85, "", "grip of a supported object over need", ASSUMED),
    Range("vanish_s", 0.02, 0.3, "s", "support vanishes", ASSUMED, log=True),
    Range("added_n", 0.5, 20.0, "N", "weight added", ASSUMED, log=True),
    Range("adding_s", 0.1, 2.0, "s", "how long adding takes", ASSUMED, log=True),
    Range("relaxed_to", 0.2, 0.9, "", "relaxed grip over need", ASSUMED),
    Range("relaxing_s", 0.2, 3.0, "s", "how long relaxing takes", ASSUMED, log=True),
    # put-down and pick-up
    Range("box_m_s", 0.02, 0.06, "m/s", "how fast the box comes", OURS),
    Range("press", 1.0, 1.3, "", "force of the box over the weight", OURS),
    Range("rest_on_s", 0.5, 1.5, "s", "from the box to opening", OURS),
    Range("lift_m", 0.05, 0.3, "m", "how far an object is lifted", ASSUMED),
    Range("lift_s", 0.5, 1.2, "s", "how long lifting takes", ASSUMED),
    # holds
    Range("trembling_m_s2", 0.0, 3.0, "m/s2", "tremor of a trembling hold", ASSUMED),
)
RANGES = {one.name: one for one in TABLE}
REFUSED_GRIP_N = (0.5, 70.0)
"""A hold whose grip is outside is drawn again: no sensor sees less, and no drive gives more."""
EVENT_N = (1.1, 4.0)
"""Load of an event that friction does not hold, over the load that it holds."""
HELD_N = (0.2, 0.85)
"""The same of a tug that friction holds."""
