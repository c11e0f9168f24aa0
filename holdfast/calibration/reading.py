"""Where the loads are: a CSV file, or a folder of probings."""

from __future__ import annotations

from pathlib import Path

from holdfast.calibration.loads_csv import csv_study
from holdfast.calibration.probing_folder import probed_study
from holdfast.calibration.study import Study
from holdfast.edge_runtime.contract import NORMAL_AXIS
from holdfast.edge_runtime.errors import DataNotFound

KINDS = {"normal_force": NORMAL_AXIS, "shear_force": 0}
"""Folder -> axis of its load. The direction of shear is unknown; it is called x here."""


def read_studies(path: Path) -> list[Study]:
    """One study of a CSV file, or a normal and a shear one of a folder. Raises a DataError."""
    if not path.is_dir():
        return [csv_study(path)]
    kinds = [kind for kind in KINDS if (path / kind).is_dir()]
    if not kinds:
        raise DataNotFound(
            f"no {' or '.join(KINDS)} in this folder",
            where=path,
            next_step="give a folder like eflesh_calibration, or a CSV file",
        )
    return [probed_study(path / kind, KINDS[kind]) for kind in kinds]
