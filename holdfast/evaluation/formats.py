"""How numbers and names of methods are written for people: reports, documents, terminals.

figures.json keeps the stored names. "-" stands where a figure is not defined; an interval that is
not defined is not written at all. What figures were measured on is written with them: host and
versions.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from holdfast.core.contract import BoolArray, Json
from holdfast.core.writing import write_whole
from holdfast.data.metrics import ABSENT, Interval, Share

# Figures that every table uses: a spread of times, a share with its interval, McNemar's test.
#
# Shares of things that happen once a trial (a voluntary action, a hold) have exact binomial
# intervals (Clopper & Pearson, Biometrika 26, 1934): a bootstrap of a share of one gives 1 to 1.


@dataclass(frozen=True)
class Spread:
    """The 5th, 50th (median) and 95th percentile, in the unit of the values."""

    p5: float
    p50: float
    p95: float


def spread(values: Sequence[float]) -> Spread | None:
    """The percentiles of some values; None without a value."""
    if not values:
        return None
    # No mean: a single alarm that came seconds late would move it.
    p5, p50, p95 = np.percentile(values, (5, 50, 95)).tolist()
    return Spread(p5, p50, p95)


def share(hits: Sequence[bool]) -> Share:
    """The share of the hits that are true, and its exact interval."""
    n = len(hits)
    # Nothing happened, so there is no share, and no interval of one.
    if not n:
        return Share(None, None, 0)
    n_true = sum(hits)
    # Clopper and Pearson: never too narrow, however few the trials are.
    exact = binomtest(n_true, n).proportion_ci(0.95, method="exact")
    interval = (float(exact.low), float(exact.high))
    return Share(n_true / n, interval, n)


@dataclass(frozen=True)
class McNemar:
    """Events that only one of two methods detected, and the exact two-sided p of that split."""

    only_ours: int
    only_theirs: int
    both: int
    neither: int
    p: float


def mcnemar(ours: BoolArray, theirs: BoolArray) -> McNemar:
    """Compare two methods [E], [E] event by event."""
    only_ours = int((ours & ~theirs).sum())
    only_theirs = int((theirs & ~ours).sum())
    both = int((ours & theirs).sum())
    neither = int((~ours & ~theirs).sum())
    # Events on which both agree say nothing about which is better.
    n = only_ours + only_theirs
    # Without a difference both are equally likely to win each event: p = 1.
    p = float(binomtest(only_ours, n, 0.5).pvalue) if n else 1.0
    return McNemar(only_ours, only_theirs, both, neither, p)


DEPLOYED = "ours, as deployed"
CHOSEN = "ours, confidence chosen"
BAND = "band-pass bank"
CONE = "friction cone"
SHEAR_RATE = "one line of code"
RAW = "raw-window forest"
ORACLE = "perfect intent"
DISPLAY_NAMES = {
    DEPLOYED: "this model, as deployed",
    CHOSEN: "this model, chosen confidence",
    SHEAR_RATE: "shear-rate threshold",
    ORACLE: "oracle",
}
"""Stored name -> the name that people read, where they differ."""
LAWS = {
    BAND: "a shear signal exceeds its own noise floor in one of ten bands (setting: ratio)",
    CONE: "shear / normal force of a finger leaves the friction cone (setting: coefficient)",
    SHEAR_RATE: "summed shear changes within two samples by more than a threshold (setting: N)",
    RAW: "the thesis' forest: 100 untuned trees on the last 0.10 s (setting: confidence)",
    ORACLE: "an upper bound: knows the person's intent, acts one sample after load onset",
}
"""How each baseline decides, and what its setting is."""


def number(value: float | None, places: int = 2) -> str:
    """So many decimal places; "-" where there is no figure."""
    return ABSENT if value is None else f"{value:.{places}f}"


def whole(value: float) -> str:
    """Rounded to a whole number, never "-0"."""
    # round() gives an int, which has no sign at 0.
    return str(round(value))


def percent(value: float | None) -> str:
    """A share as a percentage; "-" where there is none."""
    return ABSENT if value is None else f"{100 * value:.1f} %"


def interval(ends: Interval | None, places: int = 2) -> str:
    """From one end to the other, or nothing."""
    if ends is None:
        return ""
    low, high = ends
    return f"{low:.{places}f} to {high:.{places}f}"


def percent_interval(ends: Interval | None) -> str:
    """An interval of a share, as percentages."""
    if ends is None:
        return ""
    low, high = ends
    return interval((100 * low, 100 * high), 1)


def p_value(p: float) -> str:
    """The p of a test, to three places."""
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def spaced(name: str) -> str:
    """A name of the contract as words: safe slip."""
    return name.replace("_", " ")


def display_name(stored: str) -> str:
    """A stored name as people read it.

    >>> display_name("one line of code"), display_name("friction cone")
    ('shear-rate threshold', 'friction cone')
    """
    return DISPLAY_NAMES.get(stored, stored)


def is_this_model(stored: str) -> bool:
    """Whether a stored name is the evaluated model and no baseline."""
    return stored in (DEPLOYED, CHOSEN)


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as a table of a document; all have the columns of the first."""
    heads = list(rows[0])
    lines = [heads, ["---"] * len(heads)]
    for row in rows:
        # By name: a row may hold further figures that are no column.
        lines.append([markdown_cell(row[head]) for head in heads])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def markdown_cell(value: Any) -> str:
    """A cell of such a table: three digits of a number, or thousands with commas."""
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
    return ABSENT if value is None else str(value)


def onsets_in_words(by: Mapping[str, int]) -> str:
    """What gave the load onsets, where a camera or a person did; "" for a scene or a script."""
    # A scene and a script know their onsets exactly, and need no such note.
    if not by.keys() & {"camera", "key"}:
        return ""
    counts = ", ".join(f"{name} {count}" for name, count in by.items())
    return (
        f"source of load onsets: {counts}; a camera gives the object's first motion, a pressed key "
        "is late"
    )


# -- the files of a measurement

SEED = 0
"""All measures use fixed seeds."""


@dataclass(frozen=True)
class Host:
    """A machine. machine: its instruction set. cpus: logical ones, None where not known."""

    machine: str
    system: str
    cpus: int | None


def host() -> Host:
    """The machine that computes, as results name it."""
    return Host(platform.machine(), platform.system(), os.cpu_count())


def write_measured(out: Path, what: str, kind: str, figures: Json) -> list[str]:
    """Write WHAT.json, with the machine; returns its name and the broken budgets."""
    # A figure of time means nothing without its machine.
    text = json.dumps(figures | machine_facts(kind), indent=2) + "\n"
    path = write_whole(out / f"{what}.json", text)
    return [f"{path}"] + [f"over budget: {line}" for line in figures.get("broken", [])]


def table_lines(figures: Json) -> list[str]:
    """The tables among the figures as lines for people; nested figures are only in the JSON."""
    lines = []
    for title, rows in figures.items():
        if isinstance(rows, list) and rows and isinstance(rows[0], dict):
            lines.append(f"{title}\n{markdown(rows)}\n")
    return lines


def machine_facts(kind: str) -> Json:
    """Where and with what it was measured. kind: of the data."""
    from holdfast.training.fitting import (
        versions,  # late: what writes a number trains nothing
    )

    machine = {**asdict(host()), "cpu": _processor()}
    return {"kind": kind, "seed": SEED, "host": machine, "versions": versions()}


def _processor() -> str | None:
    """The processor's name, None where the system does not have it."""
    try:
        # Other systems than Linux have no such file.
        text = Path("/proc/cpuinfo").read_text("utf-8")
    except OSError:
        return None

    for line in text.splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()

    return None
