"""The bias of an unloaded hand, with a check of how good it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    BoolArray,
    FloatArray,
    Unit,
    channel_names,
)
from holdfast.core.errors import ChannelError, EmptyRecording, NotANumber, UnitError
from holdfast.core.trial_layout import NORMAL_FLOOR

MIN_BIAS_ROWS = 30
LOST_SHARE = 0.05
"""Of the rows of a channel, more lost than this is a finger's wires; less is a moment's bus."""
QUIET: Mapping[Unit, float] = {"N": 0.12, "uT": 40.0}
"""The noise of an untouched channel stays below this.

The TMAG5273's noise is 22 uT in x and y, and 11 uT in z.
"""


@dataclass(frozen=True)
class Bias:
    """What an unloaded hand reads: values [C] median, spread [C] standard deviation, over n rows.

    reversed [S]: whose magnet is upside down. The values are as read: a reversed magnet is
    reported, not corrected.
    """

    values: FloatArray
    spread: FloatArray
    n: int
    unit: Unit
    reversed: BoolArray


def bias_of(
    values: FloatArray,
    unit: Unit,
    *,
    normal_floor: float | None = None,
    quiet: float | None = None,
) -> tuple[Bias, tuple[str, ...]]:
    """The bias of unloaded rows [T, C], and warnings that name the channels.

    Warnings are about lost rows (more than LOST_SHARE), noise, drift and reversed magnets.
    normal_floor: a resting normal below minus this value means a reversed magnet. quiet: the
    largest noise of an untouched channel, and its largest drift between the first and the last
    third. Both are in `unit`. Raises EmptyRecording, NotANumber (a channel without MIN_BIAS_ROWS
    finite rows), ChannelError, UnitError.
    """
    floor, quiet = (
        _or_default(normal_floor, NORMAL_FLOOR, unit),
        _or_default(quiet, QUIET, unit),
    )
    _check_bias_rows(values)
    masked = np.where(np.isfinite(values), values, np.nan)
    middle, spread = np.nanmedian(masked, axis=0), np.nanstd(masked, axis=0)
    reversed_ = middle[NORMAL_AXIS::3] < -floor
    bias = Bias(middle, spread, len(values), unit, reversed_)
    return bias, _bias_warnings(masked, bias, quiet)


def _or_default(
    given: float | None, defaults: Mapping[Unit, float], unit: Unit
) -> float:
    if given is None and unit not in defaults:
        raise UnitError(
            f"no default noise limits for the unit {unit}",
            next_step="give normal_floor and quiet in this unit",
        )
    return defaults[unit] if given is None else given


def _check_bias_rows(values: FloatArray) -> None:
    if values.ndim != 2 or values.shape[1] == 0 or values.shape[1] % 3:
        raise ChannelError(
            f"rows of shape {list(values.shape)}",
            next_step="give [T, C] with three channels a sensor",
        )
    if len(values) < MIN_BIAS_ROWS:
        raise EmptyRecording(
            f"{len(values)} rows for a bias",
            cause="the stream stopped early",
            next_step=f"leave the hand untouched for at least {MIN_BIAS_ROWS} rows",
        )
    few = np.isfinite(values).sum(axis=0) < MIN_BIAS_ROWS
    if few.any():
        raise NotANumber(
            f"fewer than {MIN_BIAS_ROWS} finite rows in {_named(few)}",
            cause="a finger that does not answer",
            next_step="holdfast doctor shows which fingers answer; or take more rows",
        )


def _bias_warnings(masked: FloatArray, bias: Bias, quiet: float) -> tuple[str, ...]:
    third = len(masked) // 3
    lost = np.isnan(masked).sum(axis=0)
    drift = np.abs(_middle(masked[-third:]) - _middle(masked[:third]))
    upside_down = np.repeat(bias.reversed, 3) & (
        np.arange(masked.shape[1]) % 3 == NORMAL_AXIS
    )
    limit = f"{quiet:g} {bias.unit}"
    found = (
        (
            lost > LOST_SHARE * len(masked),
            f"up to {lost.max()} of {len(masked)} rows are lost in {{}}; "
            "next: check that finger's wires",
        ),
        (
            bias.spread > quiet,
            f"noise above {limit}: {{}}; likely cause: the hand was touched; "
            "next: take the bias again",
        ),
        (
            drift > quiet,
            f"drifts by more than {limit}: {{}}; likely cause: it warms up, or a load creeps; "
            "next: wait a minute and take the bias again",
        ),
        (
            upside_down,
            "the magnet is reversed (normal field below zero at rest) in {}; "
            "next: turn the magnet or its sign",
        ),
    )
    return tuple(text.format(_named(which)) for which, text in found if which.any())


def _middle(rows: FloatArray) -> FloatArray:
    """[C] median of the finite rows; nan without any (np.nanmedian would warn)."""
    return np.array(
        [
            np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan
            for c in rows.T
        ]
    )


def _named(which: BoolArray) -> str:
    names = channel_names(len(which) // 3)
    return ", ".join(names[index] for index in np.flatnonzero(which))
