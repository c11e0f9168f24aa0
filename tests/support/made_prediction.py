"""Predictions made by hand."""

from __future__ import annotations

from typing import Any

from holdfast.core.contract import Prediction


def prediction(sequence: int = 7, **changes: Any) -> Prediction:
    """A grasp that nothing disturbs; changes: other fields."""
    p_risky = changes.pop("p_risky", 0.0)
    shares = {
        "nothing": 0.0,
        "grasp": 1.0 - p_risky,
        "safe_slip": 0.0,
        "risky_slip": p_risky,
    }
    grasp: dict[str, Any] = {
        "sequence": sequence,
        "t_acquired_ns": 10**9,
        "t_decided_ns": 10**9,
        "latency_us": 0.0,
        "state": "grasp",
        "why": "",
        "p_situation": shares,
        "p_risky": p_risky,
        "p_class": None,
        "weight": None,
        "extra": {},
        "detectors": {"band_pass": False},
        "arm": False,
        "act": False,
        "act_ended": None,
        "opening": False,
        "overridden": False,
        "commands": "none",
        "late": False,
        "started_loaded": None,
        "degraded": False,
        "settled": True,
        "model_id": "m",
    }
    return Prediction(**(grasp | changes))
