"""The table of effects, in the order they run: the loop's, then the sensor's, then the camera's."""

from __future__ import annotations

from simulation.effect import Effect
from simulation.loop import LOOP_EFFECTS
from simulation.sensor import SENSOR_EFFECTS
from simulation.values import Parameter

AVERAGING = Effect(
    "averaging",
    "physics",
    make=lambda: None,
    parameters={
        "averages": Parameter(32.0, "", 1, 32, "conversions of each axis a reading is the mean of")
    },
)
"""The chip reports the mean over its conversion time, 25 us * 3 axes * averages (TMAG5273 data
sheet, table 7-4).

Without it a reading is the force at its instant, and whatever vibrates faster than half the rate is
folded down.
"""
CAMERA = Effect("camera_frames", "camera", make=lambda: None)
"""Frames of a camera that sees a tag on the object and one on the hand; needs [camera] on the card
(camera/)."""

EFFECTS: dict[str, Effect] = {
    **LOOP_EFFECTS,
    "averaging": AVERAGING,
    **SENSOR_EFFECTS,
    "camera_frames": CAMERA,
}


def conversion_s(averages: float) -> float:
    """Time of one reading of three axes, s."""
    return 25e-6 * (3.0 * averages + 1.0)
