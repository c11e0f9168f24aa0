"""The table of docs and README, written from metrics.json: `python -m studies.real.table METRICS
PAGE`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from evaluation.markers import write_between


def table(figures: dict[str, Any]) -> str:
    """Every row of metrics.json as Markdown, with what must stand beside it."""
    rows = "\n".join(_row(name, row) for name, row in figures["rows"].items())
    checked, cost = figures["verification"], figures["features_cost"]
    return f"""human_slip_uskin: {figures["n_trials"]} trials of {figures["n_groups"]} people, public real data.

| | macro F1, four situations | AUC, risky within 0.25 s | average precision |
|---|---|---|---|
{rows}

**Read with it:** {figures["caveat"]} Clock-free: {figures["clock_free"]}.
Exported files and reference: {checked["label_mismatches"]} of {checked["rows"]:,} labels differ. Features of all
{cost["samples"]:,} samples: {cost["cpu_s"]:.1f} CPU s. The whole command: {figures["seconds"]:.0f} s.
"""


def _row(name: str, row: dict[str, Any]) -> str:
    situations, head = row["situations"], row["predict_250ms"]
    cells = (
        name,
        _figure(situations, "macro_f1"),
        _figure(head, "auc"),
        _figure(head, "average_precision"),
    )
    return f"| {' | '.join(cells)} |"


def _figure(row: dict[str, Any], name: str) -> str:
    low, high = row[f"{name}_ci"]
    return f"{row[name]:.3f} ({low:.3f} to {high:.3f})"


def main(metrics: str, page: str) -> None:
    """Replace what stands between the page's markers."""
    write_between(page, "real", table(json.loads(Path(metrics).read_text(encoding="utf-8"))))


if __name__ == "__main__":
    main(*sys.argv[1:])
