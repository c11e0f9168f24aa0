"""The table of effects in the order they run: the loop's, then the sensor's, then the camera's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from holdfast.simulation.camera_frames import Camera
from holdfast.simulation.effect import Effect
from holdfast.simulation.loop import LOOP_EFFECTS
from holdfast.simulation.sensor import SENSOR_EFFECTS
from holdfast.simulation.values import Parameter


def conversion_s(averages: float) -> float:
    """Time of one reading of three axes, s."""
    return 25e-6 * (3.0 * averages + 1.0)


AVERAGING = Effect(
    "averaging",
    "physics",
    make=conversion_s,
    parameters={
        "averages": Parameter(
            32.0, "", 1, 32, "conversions of each axis a reading is the mean of"
        )
    },
    constant="averages",
    sets="average_s",
)
"""The chip reports the mean over its conversion time, 25 us * (3 axes * averages + 1).

Source: TMAG5273 data sheet, table 7-4. Without this effect a reading is the force at its instant,
and vibrations faster than half the rate are aliased.
"""
CAMERA = Effect("camera_frames", "camera", make=Camera)
"""Frames of a camera that sees one tag on the object and one on the hand; needs [camera]."""

EFFECTS: dict[str, Effect] = {
    **LOOP_EFFECTS,
    "averaging": AVERAGING,
    **SENSOR_EFFECTS,
    "camera_frames": CAMERA,
}


def step_settings(named: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Fields of run.StepSettings that a card's effects set; named: effect -> the card's values."""
    return {
        effect.sets: effect.setting(values)
        for name, values in named.items()
        if (effect := EFFECTS[name]).sets
    }
