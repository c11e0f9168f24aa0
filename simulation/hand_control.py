"""The `[controller]` of a card: who moves the grip while the scene goes on, and with which drive.

[controller]
name = "holdfast"                      # of edge_runtime/grip.py: none, pd-shear, ..
model = "models/holdfast-150hz.onnx"   # the file that answers, from the working directory
setting = 22                           # of the controller; its own default without this line
lag_ms = 50                            # of the drive, as are ceiling_n, closing_s, ..
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from holdfast.simulation.closed_loop.actuator import Drive
from holdfast.simulation.values import Parameter

MODEL = "models/holdfast-150hz.onnx"
NAMES = ("name", "model")
NUMBERS = {
    "setting": Parameter(0.0, "", 1e-3, 1e4, "the controller's own setting"),
    "lag_ms": Parameter(50.0, "ms", 0.0, 1000.0, "lag of the drive"),
    "ceiling_n": Parameter(70.0, "N", 0.1, 1e3, "largest grip of either side"),
    "closing_s": Parameter(0.37, "s", 0.01, 100.0, "time of the whole stroke"),
    "stroke_mm": Parameter(120.0, "mm", 1.0, 1e3, "how far the fingers can open"),
    "backlash_mm": Parameter(0.3, "mm", 0.0, 10.0, "of the fingers, at a change of direction"),
}
"""What a card may set besides the names. setting: the default is the controller's."""


@dataclass(frozen=True)
class HandControl:
    """A controller by name, the path of its model, its setting (None: its default), the drive."""

    name: str
    model: str
    setting: float | None
    drive: Drive

    @staticmethod
    def of(name: str, model: str, numbers: dict[str, float], *, has_setting: bool) -> HandControl:
        """From a section's values, numbers as in NUMBERS."""
        drive = Drive(**{one.name: numbers[one.name] for one in fields(Drive)})
        return HandControl(name, model, numbers["setting"] if has_setting else None, drive)
