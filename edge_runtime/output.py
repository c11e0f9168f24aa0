"""Predictions as JSON lines: one object a sample, the output contract to the letter."""

from __future__ import annotations

import json
from dataclasses import asdict

from holdfast.edge_runtime.contract import Prediction


def to_json_line(prediction: Prediction) -> str:
    """One line without the line break; floats keep all their digits, unknown values are null."""
    return json.dumps(asdict(prediction), separators=(",", ":"), allow_nan=False)
