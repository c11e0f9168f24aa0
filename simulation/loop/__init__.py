"""Effects that take part in every step of the core."""

from __future__ import annotations

from simulation.effect import Effect
from simulation.loop.brush import BRUSH, pressure
from simulation.loop.lag import LAG
from simulation.loop.rotation import ROTATION
from simulation.loop.shakes import ARM, KNOCK, TREMOR
from simulation.loop.texture import TEXTURE

__all__ = ["LOOP_EFFECTS", "pressure"]
LOOP_EFFECTS: dict[str, Effect] = {
    e.name: e for e in (BRUSH, TEXTURE, LAG, ROTATION, ARM, TREMOR, KNOCK)
}
