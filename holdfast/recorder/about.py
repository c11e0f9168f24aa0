"""What the meta.json of every trial of a run says, besides its state and quality."""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from holdfast.drivers.calibration_file import read_calibration
from holdfast.drivers.live_hand import LiveHand
from holdfast.edge_runtime.live import Source
from holdfast.edge_runtime.reading import Json
from holdfast.hand_bias import MeasuredBias
from holdfast.recorder.plan import Plan


def about(
    args: argparse.Namespace,
    source: Source,
    measured: MeasuredBias,
    plan: Plan,
    rate_hz: float,
    *,
    real_time: bool,
) -> Json:
    """A JSON object; of paths only the last part, because folders can name people."""
    configuration = {
        name: _plain(value)
        for name, value in vars(args).items()
        if name not in ("person", "object", "action")
    }
    return {
        "unit": source.unit,
        "rate_hz": rate_hz,
        "hand": source.about() if isinstance(source, LiveHand) else None,
        "calibration": _calibration(args.calibration),
        "bias": _bias(measured),
        "protocol": _protocol(plan, args.seed),
        "versions": {
            **{name: version(name) for name in ("holdfast", "numpy")},
            "python": platform.python_version(),
            "machine": platform.machine(),
        },
        "real_time_priority": real_time,
        "configuration": configuration,
    }


def _bias(measured: MeasuredBias) -> Json:
    bias = measured.bias
    return {
        "values": bias.values.tolist(),
        "spread": bias.spread.tolist(),
        "n": bias.n,
        "unit": bias.unit,
        "reversed": bias.reversed.tolist(),
        "warnings": list(measured.warnings),
        "good": measured.good,
    }


def _protocol(plan: Plan, seed: int) -> Json | None:
    card = plan.protocol
    if card is None:
        return None
    return {"card": card.name, "sha256": card.sha256, "seed": seed, "done_before": plan.done}


def _calibration(path: Path | None) -> Json | None:
    if path is None:
        return None
    meta = read_calibration(path).meta
    return {
        "file": path.name,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "source": meta.source,
        "date": meta.date,
        "n": meta.n,
        "content": json.loads(path.read_text("utf-8")),
    }


def _plain(value: Any) -> Any:
    """A path, or a URL with paths, without the folders."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, str) and "/" in value:
        scheme, mark, name = value.rpartition("://")
        return f"{scheme}{mark}{'&'.join(_last(part) for part in name.split('&'))}"
    return value


def _last(part: str) -> str:
    key, mark, path = part.rpartition("=")
    head, question, key = key.rpartition("?")
    return f"{head.rpartition('/')[2]}{question}{key}{mark}{path.rpartition('/')[2]}"
