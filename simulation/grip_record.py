"""What a controller commanded in a trial, and what its drive did: one row a sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.edge_runtime.contract import FloatArray
from holdfast.edge_runtime.reading import Json
from holdfast.simulation.table import Column

COLUMNS = ("target_n", "needed_n", "mu_hat", "mode", "grip_n")
"""Of trial_<n>.grip.csv, after the time."""
DECIMALS = (3, 3, 4, 0, 3)


@dataclass(frozen=True)
class GripRecord:
    """rows [T, 5], as COLUMNS; about: controller, model and drive, for the truth of the trial.

    target_n: commanded, N a side, nan where the wearer's own grip is left alone. needed_n, mu_hat:
    of the friction margin, nan while no slip has shown the friction. mode: number of
    edge_runtime.grip_command.MODES. grip_n: N a side that the place of the drive gives.
    overrode_s: the wearer overrides, inf where that never happens.
    """

    rows: FloatArray
    about: Json
    overrode_s: float

    def columns(self) -> list[Column]:
        """For a CSV file."""
        return list(zip(self.rows.T, DECIMALS, strict=True))

    def to_json(self) -> Json:
        """The controller in the truth of the trial."""
        at_s = round(self.overrode_s, 6) if np.isfinite(self.overrode_s) else None
        return self.about | {"overrode_s": at_s}
