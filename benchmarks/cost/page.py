"""docs/what-accuracy-costs.md with its figure, and the README's table of ten lines, from
build/bench: `make docs`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.cost.point import DEBOUNCES, DEPTHS, GOOD, RATES_HZ, TREES, Point
from edge_runtime.writing import write_whole
from evaluation.markers import write_between
from evaluation.page import markdown
from evaluation.style import INK, OURS, QUIET, STYLE, WARNING, svg

INTRO = """# What accuracy costs in time

Written by `make docs` from `holdfast bench cost`, `latency`, `training` and `instructions`. **Scenes are simulated**:
forests fitted on 400 trials of the card `thesis`, asked about {events} risky slips in {minutes:.0f} minutes of `daily`,
one grasp after another, sample by sample; the hand is simulated once, and a slower rate is every so manieth of its
samples. **People are public real data** (human_slip_uskin, 18 channels, forests of 20 trees): everybody is asked about
by a forest that never met him. The threshold of the alarm is chosen on other streams (on other people) so that at most
one false alarm a minute is left. *macro_f1*: over four situations, at the labelled windows of the same streams.

*found*: the hand is asked to act between load onset and loss of contact; an alarm that was on before does not count.
*in time*: before all fingers slide. *delay*: from load onset to the alarm (on people from the object's first 5 degrees,
since nobody recorded the load), median. *lead used*: the delay over the time there is until all fingers slide; above 1
the object slides already. Microseconds are this machine's, all in turns in one run.

![What accuracy costs in time](what-accuracy-costs.svg)

## Where the milliseconds are

At 150 Hz, from the pull to the request:

| | ms |
|---|---|
| the sensor's conversion, 32 averages | 2.4 |
| waiting for the next sample, mean | 3.3 |
| the bus, six fingers ([measured](hand.md)) | 1.5 to 1.9 |
| one decision ([below](#one-decision-beside-its-peers)) | {step_ms:.2f} |
| every further sample the debounce waits for | 6.7 |

How far the features look back (window 100 ms, history 500 ms) and how long a 10 Hz resonator rings (159 ms) is no delay
of an alarm: a new sample counts at once. Computing is the smallest part: a forest ten times as large costs
microseconds, one more sample of debounce costs 6.7 ms.
"""
CHOICE = """## Which model

`models/` holds the default; the others are `make models SIZE=tiny` and `make models SIZE=best`. They differ in
microseconds and kilobytes more than in what they find; the debounce and the rate, which cost nothing to compute, decide
what comes in time.

"""
FRONT = """No other point beats one of these in both microseconds and what its last column names. Points within each
other's intervals change places with the next draw of grasps."""
HEADS = (
    "what",
    "step_us",
    "forest_us",
    "kib",
    "found",
    "found_95",
    "in_time",
    "false_per_min",
    "delay_ms",
    "lead_used",
    "macro_f1",
)
README_ROWS = (
    Point(),
    Point(debounce=2),
    Point(debounce=3),
    Point(trees=8, depth=10),
    Point(trees=100, depth=0),
    Point(trees=1),
    Point(rate_hz=50.0),
    Point(groups="raw window"),
    Point("human"),
    Point("human", groups="raw window"),
)
README_HEADS = ("set", "what", "step_us", "found", "in_time", "delay_ms", "macro_f1")
RECOMMENDED = {
    "tiny": Point(trees=8, depth=10),
    "default": Point(),
    "best": Point(trees=100, depth=0),
}


def page(bench: dict[str, Any]) -> str:
    """The whole page, from the JSON of each bench by name."""
    rows, fronts, latency = bench["cost"]["rows"], bench["cost"]["fronts"], bench["latency"]
    by_choice = {(row["of"], row["what"]): row for row in rows}
    default = next(row for row in rows if row["of"] == "scenes" and row["what"] == "default")
    step_us = latency["rows"][0]["p50"]
    ratios = "; ".join(
        f"{name.replace('_', ' ')} {value:.2f}" for name, value in latency["ratios"].items()
    )
    parts = [
        INTRO.format(events=default["events"], minutes=default["minutes"], step_ms=1e-3 * step_us)
    ]
    parts.append(
        CHOICE
        + markdown(
            [
                {"model": name} | line(by_choice[point.of, point.what])
                for name, point in RECOMMENDED.items()
            ]
        )
    )
    parts += [told] if (told := _took(bench["cost"]["took"], len(rows))) else []
    for of, title in (("scenes", "Scenes (simulated)"), ("human", "People (public real data)")):
        here = [row for row in rows if row["of"] == of]
        parts.append(f"## {title}: the front\n\n{FRONT}\n\n{markdown(front(here, fronts[of]))}")
        parts.append(f"### Everything that was tried\n\n{markdown([line(row) for row in here])}")
    parts.append(
        "## One decision beside its peers\n\nAll in turns in one run on the same samples, us; the floor is a busy wait "
        "as long as our step. *cold_p50*: the first call of each turn, to caches full of the others' things, which is "
        f"what a loop that sleeps between samples meets. {ratios}.\n\n{markdown(latency['rows'])}"
    )
    parts.append(
        "Instructions a call, by callgrind, free of the machine's noise; the last column is a **projection** "
        "to a board of 1.5 GHz at one instruction a cycle, not a measurement.\n\n"
        + markdown(bench["instructions"]["rows"])
    )
    parts.append(f"Memory and start of the live path:\n\n{markdown(latency['memory'])}")
    parts.append(
        f"## Training\n\nCPU seconds, simulated trials of `thesis` at 150 Hz.\n\n"
        f"{markdown(bench['training']['rows'])}\n\nThe simulator's time against its step and its error: "
        "[scenes](scenes.md)."
    )
    return "\n\n".join(parts) + "\n"


def _took(took: dict[str, Any], points: int) -> str:
    """How long the surface took, where every point was made in one run."""
    if took["new_points"] < points or took["cores"] is None:
        return ""
    minutes = took["wall_s"] / 60.0
    return f"`holdfast bench cost` made all {points} points in {minutes:.1f} minutes on {took['cores']} cores."


def front(rows: list[dict[str, Any]], fronts: dict[str, list[str]]) -> list[dict[str, Any]]:
    """Lines of all points on a front, cheapest first, each saying on which."""
    return [
        line(row)
        | {
            "unbeaten_in": ", ".join(
                GOOD[good] for good, names in fronts.items() if row["what"] in names
            )
        }
        for row in sorted(rows, key=lambda row: float(row["step_us"]))
        if any(row["what"] in names for names in fronts.values())
    ]


def short(figures: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """What is printed of a surface: the front of each set."""
    rows = figures["rows"]
    return {
        of: front([row for row in rows if row["of"] == of], told)
        for of, told in figures["fronts"].items()
    }


def line(row: dict[str, Any]) -> dict[str, Any]:
    """A row of the surface as a line of a table."""
    interval = row["recall_ci"]
    told = {
        "set": {"scenes": "scenes", "human": "people"}[row["of"]],
        "found": row["recall"],
        "kib": row["bytes"] / 1024,
        "found_95": f"{interval[0]:.2f} to {interval[1]:.2f}" if interval else "-",
        "delay_ms": row["delay_ms"]["p50"] if row["delay_ms"] else None,
        "lead_used": row["lead_used"]["p50"] if row["lead_used"] else None,
    }
    return {head: told.get(head, row.get(head)) for head in HEADS}


def readme_table(rows: list[dict[str, Any]]) -> str:
    """The README's ten lines."""
    by_choice = {(row["of"], row["what"]): row for row in rows}
    lines = [line(by_choice[point.of, point.what]) | {"set": _set(point)} for point in README_ROWS]
    return markdown([{head: one[head] for head in README_HEADS} for one in lines]) + "\n"


def _set(point: Point) -> str:
    return "people, real" if point.of == "human" else "scenes, simulated"


def figure(rows: list[dict[str, Any]]) -> str:
    """Scenes: slips found in time against microseconds, and against the delay; what was varied as
    lines."""
    by_name = {row["what"]: row for row in rows if row["of"] == "scenes"}
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(9.4, 4.0))
        drawn.suptitle("simulated", x=0.995, ha="right", fontsize=8, color=WARNING, style="italic")
        left, right = drawn.subplots(1, 2, sharey=True)
        for axes, families, x in ((left, COMPUTED, _step_us), (right, WAITED, _delay_ms)):
            for colour, (family, points) in zip(FAMILY_COLOURS, families.items(), strict=False):
                told = [
                    (by_name[point.what], name) for name, point in points if point.what in by_name
                ]
                told = [(row, name) for row, name in told if x(row) is not None]
                _family(
                    axes, family, [(x(row), row["in_time"], name) for row, name in told], colour
                )
            default = by_name["default"]
            axes.plot(x(default), default["in_time"], "o", color=INK, markersize=8, zorder=3)
            beside, side = ((7, -12), "left") if axes is left else ((-6, -12), "right")
            axes.annotate(
                "default",
                (x(default), default["in_time"]),
                beside,
                textcoords="offset points",
                fontsize=8,
                ha=side,
            )
            axes.legend(
                frameon=False, fontsize=8, loc="lower right" if axes is left else "lower left"
            )
            axes.grid(color="#e4e7eb")
            axes.margins(x=0.1)
        left.set_xscale("log")
        left.set_xlim(left=36.0)
        left.xaxis.set_major_formatter("{x:g}")
        left.xaxis.set_minor_formatter("{x:g}")
        left.set(
            xlabel="computing: one decision, us",
            ylabel="risky slips acted on before all fingers slide,\n"
            "at about one false alarm a minute",
        )
        right.set(xlabel="waiting: load onset to the request, ms (median)")
        return svg(drawn)


COMPUTED = {
    "trees": [(f"{n}", Point(trees=n)) for n in TREES],
    "depth": [(f"{n or 'unlimited'}", Point(depth=n)) for n in DEPTHS],
    "features": [(name, Point(groups=name)) for name in ("now", "now, differences", "raw window")],
}
WAITED = {
    "debounce, samples": [(f"{n}", Point(debounce=n)) for n in DEBOUNCES],
    "sampling rate, Hz": [(f"{hz:g}", Point(rate_hz=hz)) for hz in RATES_HZ],
}
"""Families of points that the figure draws as lines: (label, point)."""
FAMILY_COLOURS = (OURS, WARNING, QUIET)
LABELLED = {"1", "2", "3", "500", "4", "50", "100", "300", "now", "raw window"}


def _step_us(row: dict[str, Any]) -> float | None:
    return float(row["step_us"])


def _delay_ms(row: dict[str, Any]) -> float | None:
    return float(row["delay_ms"]["p50"]) if row["delay_ms"] else None


def _family(axes: Axes, family: str, points: Sequence[tuple[Any, float, str]], colour: str) -> None:
    """A line through the points of a family (dots where they have no order), the ends and the odd
    ones named."""
    line = "" if family == "features" else "-"
    xs, ys = [x for x, _, _ in points], [y for _, y, _ in points]
    axes.plot(xs, ys, f"o{line}", color=colour, markersize=4.5, label=family)
    for x, y, name in points:
        if name in LABELLED:
            beside, side = (
                ((5, 4), "left") if colour == OURS else ((-6, -8 if line else -3), "right")
            )
            axes.annotate(
                name, (x, y), beside, textcoords="offset points", fontsize=7, color=colour, ha=side
            )


if __name__ == "__main__":
    folder, docs = Path(sys.argv[1]), Path(sys.argv[2])
    bench = {
        name: json.loads((folder / f"{name}.json").read_text("utf-8"))
        for name in ("cost", "latency", "training", "instructions")
    }
    write_whole(docs / "what-accuracy-costs.svg", figure(bench["cost"]["rows"]))
    write_whole(docs / "what-accuracy-costs.md", page(bench))
    write_between("README.md", "cost", readme_table(bench["cost"]["rows"]))
