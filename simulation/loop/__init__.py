"""Effects that take part in every step of the core."""

from __future__ import annotations

from holdfast.simulation.effect import Effect
from holdfast.simulation.loop.brush import BRUSH, pressure
from holdfast.simulation.loop.lag import LAG
from holdfast.simulation.loop.rotation import ROTATION
from holdfast.simulation.loop.shakes import ARM, KNOCK, TREMOR
from holdfast.simulation.loop.texture import TEXTURE

__all__ = ["LOOP_EFFECTS", "pressure"]
LOOP_EFFECTS: dict[str, Effect] = {
    e.name: e for e in (BRUSH, TEXTURE, LAG, ROTATION, ARM, TREMOR, KNOCK)
}
