"""A recorded set of two people with everything that a conversion may lose: a gap, lost values."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import channel_names

ROWS, RATE_HZ, SENSORS = 120, 100.0, 6
NEVER_CAME = (30, 31, 32)
"""Samples that were never written: the sequence skips them."""
INVALID = (50, 60)
"""Rows in which finger 2 is not valid."""
NAN_ROW = 70
"""Row in which finger 3 has a value that is not a number."""
PULL, PASS = "p01/soft-ball/pull/trial_1", "p02/soft-ball/pass/trial_1"
STARTED_UTC, START_S = "2026-01-02T03:04:05Z", 1_767_323_045
PHASES = [
    {"t0_s": 0.0, "t1_s": 0.4, "label": "nothing", "provenance": "key"},
    {"t0_s": 0.4, "t1_s": 0.8, "label": "grasp", "provenance": "key"},
    {"t0_s": 0.8, "t1_s": 1.0, "label": "risky_slip", "provenance": "key"},
]
"""Of the pull; its last rows have no label."""


@dataclass(frozen=True)
class Written:
    """What a trial's file holds, lost samples as rows: t_s [T], values [T, C], valid [T, S]."""

    t_s: npt.NDArray[np.float64]
    values: npt.NDArray[np.float64]
    valid: npt.NDArray[np.bool_]
    label: list[str | None]


def write_lossy_set(root: Path) -> dict[str, Written]:
    """The two trials below a new folder, by name; the pass has no losses."""
    return {
        PULL: _write(root / PULL, "pull", PHASES, lossy=True),
        PASS: _write(root / PASS, "pass", [{**PHASES[0], "t1_s": 1.2}], lossy=False),
    }


def _write(
    folder: Path, action: str, phases: list[dict[str, object]], lossy: bool
) -> Written:
    rng = np.random.default_rng(len(action))
    k = np.arange(ROWS)
    t_s = k / RATE_HZ
    values = rng.normal(0.0, 0.05, (ROWS, 3 * SENSORS))
    values[40:100, 2::3] += 4.0
    valid = np.ones((ROWS, SENSORS), dtype=np.bool_)
    kept = np.ones(ROWS, dtype=np.bool_)
    if lossy:
        valid[slice(*INVALID), 1] = False
        values[NAN_ROW, 6:9] = np.nan
        kept[list(NEVER_CAME)] = False
    _write_files(folder, action, phases, np.column_stack([t_s, values, k, valid])[kept])
    values[~kept], valid[~kept] = np.nan, False
    valid &= np.isfinite(values).reshape(ROWS, SENSORS, 3).all(axis=2)
    labels = [
        next((p["label"] for p in phases if p["t0_s"] <= t < p["t1_s"]), None)
        for t in t_s
    ]
    return Written(t_s, values, valid, labels)  # type: ignore[arg-type]


def _write_files(
    folder: Path,
    action: str,
    phases: list[dict[str, object]],
    table: npt.NDArray[np.float64],
) -> None:
    folder.mkdir(parents=True)
    valid = [f"valid{n + 1}" for n in range(SENSORS)]
    header = ",".join(["Time", *channel_names(SENSORS), "sequence", *valid])
    np.savetxt(folder / "tactile.csv", table, "%.9g", ",", header=header, comments="")
    meta = {
        "recorder": 1,
        "state": "kept",
        "person": folder.parts[-4],
        "object": "soft-ball",
    }
    meta |= {"action": action, "unit": "N", "started_utc": STARTED_UTC}
    (folder / "meta.json").write_text(json.dumps(meta))
    (folder / "tactile.truth.json").write_text(json.dumps({"phases": phases}))
    (folder / "events.jsonl").write_text(
        '{"t_s": 0.8, "mark": "load_onset", "provenance": "key"}'
    )
