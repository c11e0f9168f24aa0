"""Whether a source fits a model: channels, unit and rate, each with an error of its own."""

from __future__ import annotations

from pathlib import Path

from holdfast.edge_runtime.contract import RATE_TOLERANCE
from holdfast.edge_runtime.errors import ChannelError, RateError, UnitError
from holdfast.edge_runtime.model_file import ModelCard


def require_fit(
    card: ModelCard, *, n_channels: int, unit: str, rate_hz: float, where: str | Path
) -> None:
    """Raise ChannelError, UnitError or RateError where a source does not fit the model."""
    if n_channels != card.n_channels:
        raise ChannelError(
            f"the source has {n_channels} channels, the model needs {card.n_channels}",
            where=where,
            cause="a model made for other sensors",
            next_step="use a model made for this source, or train one",
        )
    if unit != card.unit:
        raise UnitError(
            f"the source is in {unit}, the model needs {card.unit}",
            where=where,
            cause="a hand without its calibration, or no unit in meta.json",
            next_step="use --calibration FILE (holdfast calibrate), or a model for this unit",
        )
    if not abs(rate_hz / card.rate_hz - 1.0) <= RATE_TOLERANCE:
        raise RateError(
            f"{rate_hz:.4g} Hz, the model needs {card.rate_hz:.4g} Hz within {RATE_TOLERANCE:.0%}",
            where=where,
            cause="a model made for another rate",
            next_step="use a model made for this rate, or train one",
        )
