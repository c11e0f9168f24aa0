"""The options that every verb that reads a hand shares, and the meaning of their values."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.edge_runtime.command import path_argument
from holdfast.edge_runtime.errors import UnitError

if TYPE_CHECKING:
    from holdfast.edge_runtime.contract import FloatArray
    from holdfast.edge_runtime.live import Source


def add_live_options(parser: argparse.ArgumentParser) -> None:
    """--source and --calibration."""
    urls = "usb://ft232h, i2c://1, virtual://ft232h?scene=.., sim://CARD, lsl://NAME"
    parser.add_argument("--source", required=True, metavar="URL", help=urls)
    made = "map from field to force, made by holdfast calibrate"
    parser.add_argument("--calibration", type=path_argument, metavar="FILE", help=made)


def add_web_option(parser: argparse.ArgumentParser) -> None:
    """--web."""
    web = "show it on a page in the browser (default host: 127.0.0.1; docs/live-page.md)"
    parser.add_argument("--web", metavar="[HOST:]PORT", help=web)


def force_of(path: Path | None) -> Callable[[FloatArray], FloatArray] | None:
    """The map from field to force in a calibration file, or None. Raises a DataError."""
    if path is None:
        return None
    from holdfast.drivers.calibration_file import read_calibration

    return read_calibration(path).apply


def resting_of(path: Path | None, source: Source) -> FloatArray | None:
    """A bias file [C] that fits the source, or None. Raises a DataError."""
    if path is None:
        return None
    from holdfast.drivers.calibration_file import read_bias

    bias = read_bias(path)
    if bias.unit != source.unit or len(bias.values) != source.n_channels:
        raise UnitError(
            f"{len(bias.values)} channels in {bias.unit}, "
            f"the source has {source.n_channels} in {source.unit}",
            where=path,
            cause="measured with another calibration or hand",
            next_step="run holdfast bias again",
        )
    return bias.values
