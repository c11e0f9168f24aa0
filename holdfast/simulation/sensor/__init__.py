"""Effects of the sensor in the order they act: magnet in silicone, chip, then bus and clock."""

from __future__ import annotations

from holdfast.simulation.effect import Effect
from holdfast.simulation.sensor.chip import CHIP, TIMING
from holdfast.simulation.sensor.magnet import MAGNET

SENSOR_EFFECTS: dict[str, Effect] = {
    effect.name: effect for effect in (*MAGNET, *CHIP, *TIMING)
}
