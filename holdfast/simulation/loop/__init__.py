"""Effects that take part in every step of the core."""

from __future__ import annotations

from holdfast.simulation.effect import Effect
from holdfast.simulation.loop.contacts import BRUSH, LAG, TEXTURE, pressure
from holdfast.simulation.loop.rotation import ROTATION
from holdfast.simulation.loop.shakes import ARM, KNOCK, TREMOR

__all__ = ["LOOP_EFFECTS", "pressure"]
LOOP_EFFECTS: dict[str, Effect] = {
    e.name: e for e in (BRUSH, TEXTURE, LAG, ROTATION, ARM, TREMOR, KNOCK)
}
