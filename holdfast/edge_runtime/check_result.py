"""What a self-check reports, and the input that the checks share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.edge_runtime.golden import (
    golden_input,
)
from holdfast.edge_runtime.monitor import Model


@dataclass(frozen=True)
class CheckResult:
    """One self-check: what it checks, whether it held, and its figure."""

    what: str
    ok: bool
    figure: str


def clean_input(model: Model) -> tuple[FloatArray, BoolArray]:
    """The golden input [T, C] and [T, S] without its corrupted and lost samples."""
    values, valid = golden_input(
        model.card.n_channels, model.card.unit, model.card.settle_samples
    )
    good = np.isfinite(values) & (np.abs(values) < 1e6)
    return np.where(good, values, 0.0), np.ones_like(valid)
