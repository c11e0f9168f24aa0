"""The tables of docs/shared-control.md, from loop.json."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from holdfast.core.reading import Json
from studies.shared_control.plan import CURVE_SETS, OUR_LEAD_N, OURS, UNSEEN
from studies.shared_control.targets import target_rows
from tools.doc_tables import fill, table, with_interval

PAGE = Path("docs/shared-control.md")
CONTROLLER_HEADS = {
    "controller": "controller",
    "saved": "preventable drops saved (95 %)",
    "slip": "slip of the saved, mm",
    "blocked": "hand-overs blocked (95 %)",
    "force": "extra force, N",
    "delay": "extra delay, 95 %, ms",
    "disturbed": "put-downs disturbed",
    "excess": "grip above need, N s a trial",
}
SET_HEADS = {
    "set": "set",
    "drops": "drops of the bare hand",
    "preventable": "preventable",
    "saved": "saved (95 %)",
    "handovers": "hand-overs",
    "blocked": "blocked (95 %)",
    "crushed": "crushed",
    "tightenings": "tightenings a minute",
}
PART_HEADS = {
    "set": "set",
    "controller": "left out",
    "saved": "saved (95 %)",
    "blocked": "blocked (95 %)",
    "excess": "grip above need, N s a trial",
}
TIME_HEADS = {
    "set": "set",
    "lag": "lag of the drive, ms",
    "late": "targets late by, ms",
    "preventable": "preventable",
    "saved": "saved (95 %)",
    "slip": "slip of the saved, mm",
    "blocked": "blocked (95 %)",
}
NOISE_HEADS = {
    "set": "set",
    "noise": "noise, times a chip's",
    "preventable": "preventable",
    "saved": "saved (95 %)",
    "slip": "slip of the saved, mm",
    "blocked": "blocked (95 %)",
    "tightenings": "tightenings a minute",
    "excess": "grip above need, N s a trial",
}
TARGET_HEADS = ("target", "aim", "measured", "reached")
Row = Json


def fill_page(figures: Json) -> None:
    """Write each table that has rows between its markers. Raises DataNotFound without markers."""
    rows = figures["rows"]
    chosen = {
        "author": (_of(rows, "table", ["author"]), CONTROLLER_HEADS),
        "unseen": (_worst_of_unseen(rows), CONTROLLER_HEADS),
        "sets": (
            [r for r in _part(rows, "table") if r["controller"] == OURS],
            SET_HEADS,
        ),
        "parts": (_part(rows, "without"), PART_HEADS),
        "milliseconds": (_in_time(rows), TIME_HEADS),
        "noise": (_part(rows, "noise"), NOISE_HEADS),
    }
    made = {
        n: table([shown(r) for r in of], heads)
        for n, (of, heads) in chosen.items()
        if of
    }
    if _part(rows, "table"):
        made |= {"targets": table(target_rows(rows), {h: h for h in TARGET_HEADS})}
    fill(PAGE, made)


def _part(rows: Sequence[Row], part: str) -> list[Row]:
    return [row for row in rows if row["part"] == part]


def _in_time(rows: Sequence[Row]) -> list[Row]:
    """Ours at its usual setting, by the lag of the drive and by how late its targets come."""
    lagged = [
        r
        for r in _part(rows, "lag")
        if r["controller"] == OURS and r["setting"] == OUR_LEAD_N
    ]
    usual = [r for r in _of(rows, "table", CURVE_SETS) if r["controller"] == OURS]
    by_lag = sorted([*lagged, *usual], key=lambda row: (row["set"], row["lag_ms"]))
    return [*by_lag, *_part(rows, "delay")]


def _of(rows: Sequence[Row], part: str, sets: Sequence[str]) -> list[Row]:
    return [row for row in rows if row["part"] == part and row["set"] in sets]


def _worst_of_unseen(rows: Sequence[Row]) -> list[Row]:
    """For each controller the unseen style on which it saves the least."""
    worst: dict[str, Row] = {}
    for row in _of(rows, "table", UNSEEN):
        name = row["controller"]
        if name not in worst or (row["saved_share"] or 0) < (
            worst[name]["saved_share"] or 0
        ):
            worst[name] = row
    return [
        {**row, "controller": f"{name} ({row['set']})"} for name, row in worst.items()
    ]


def shown(row: Row) -> Row:
    """A row of the study as the tables print it."""
    return {
        **{
            key: row[key]
            for key in ("set", "controller", "drops", "preventable", "handovers")
        },
        "lag": f"{row['lag_ms']:g}",
        "noise": f"{row['noise']:g}",
        "late": f"{1e3 * row['delay_samples'] / 150.0:.0f}",
        "saved": with_interval(row["saved_share"], row["saved_share_ci"]),
        "blocked": with_interval(row["blocked_share"], row["blocked_share_ci"]),
        "disturbed": with_interval(row["disturbed_share"], row["disturbed_share_ci"]),
        "crushed": with_interval(row["crushed_share"], row["crushed_share_ci"]),
        "slip": _number(row["slip_mm_p50"]),
        "force": _number(row["extra_force_n_p50"]),
        "delay": _number(row["extra_delay_ms_p95"], 0),
        "excess": _number(row["grip_excess"], 2),
        "tightenings": _number(row["tightenings_per_min"], 2),
    }


def _number(value: float | None, digits: int = 1) -> str | None:
    return None if value is None else f"{value:.{digits}f}"
