"""The last 30 s as a file: a zipped folder in the form of a recorded trial.

    holdfast-20261123-031512/tactile.csv     Time, X1 .. Zn, sequence, valid1 .. validn
                             meta.json       unit; the bias is taken off already
                             events.jsonl    marks

`holdfast replay MODEL FOLDER` reads it as it is.
"""

from __future__ import annotations

import io
import json
import zipfile
from typing import Any

from holdfast.edge_runtime.trial_layout import EVENTS, META, TACTILE

Message = dict[str, Any]


def zipped(samples: list[Message], marks: list[Message], about: Message, name: str) -> bytes:
    """A zip archive with one folder. samples: at least one."""
    first_ns = samples[0]["t_ns"]
    meta = {"unit": about["unit"], "bias_removed": True, "model": about.get("model")}
    events = [
        {"t_s": round(1e-9 * (mark["t_ns"] - first_ns), 6), "mark": f"mark {mark['number']}"}
        for mark in marks
    ]
    content = {
        TACTILE: _table(samples),
        META: json.dumps({**meta, "seconds": 1e-9 * (samples[-1]["t_ns"] - first_ns)}) + "\n",
        EVENTS: "".join(json.dumps({**one, "provenance": "page"}) + "\n" for one in events),
    }
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for part, text in content.items():
            file.writestr(f"{name}/{part}", text)
    return archive.getvalue()


def _table(samples: list[Message]) -> str:
    first = samples[0]
    sensors = range(1, len(first["v"]) + 1)
    axes = [f"{axis}{k}" for k in sensors for axis in "XYZ"]
    lines = [",".join(["Time", *axes, "sequence", *(f"valid{k}" for k in sensors)])]
    for sample in samples:
        t_ns = sample["t_ns"] - first["t_ns"]
        time = f"{t_ns // 10**9}.{t_ns % 10**9:09d}"
        cells = [time, *map(repr, sample["x"]), str(sample["n"]), *map(str, sample["v"])]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"
