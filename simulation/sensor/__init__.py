"""Effects of the sensor in the order they act: magnet in silicone, chip, then bus and clock."""

from __future__ import annotations

from simulation.effect import Effect
from simulation.sensor.chip import CHIP
from simulation.sensor.magnet import MAGNET
from simulation.sensor.timing import TIMING

SENSOR_EFFECTS: dict[str, Effect] = {effect.name: effect for effect in (*MAGNET, *CHIP, *TIMING)}
