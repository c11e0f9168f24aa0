"""docs/what-accuracy-costs.md and its figure, from build/bench: `make docs`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.scenes_page import markdown
from edge_runtime.writing import write_whole
from training.pictures import OURS, QUIET, STYLE, WARNING, svg

INTRO = """# What accuracy costs in time

Written by `make docs` from `holdfast bench cost` and `holdfast bench latency`. **Simulated**: forests fitted on 400 trials
of the card `thesis`, asked about 200 trials they never met, sample by sample; the threshold on the risky share of the
votes is chosen on 100 other trials so that at most one false alarm a minute is left. A minute of `thesis` holds about
four grasps, so this is a hard minute. "lead used": delay after the load came on over the time from there to the moment all
fingers slide; above 1 the hand is asked while the object already slides.

![What accuracy costs in time](what-accuracy-costs.svg)

Where the milliseconds are, for the default at 150 Hz: the window of the features 100 ms (how far they look back, not how
late they are), debounce 6.7 ms a sample, the sensor's conversion 2.4 ms, the bus 1.5 to 1.9 ms ([hand](hand.md)), computing
0.1 to 0.4 ms. Time is lost by waiting for a second sample and by a higher threshold, hardly by computing: a forest of
500 trees costs microseconds more, a debounce of three samples costs 13 ms.
"""
FRONT = """## The front: nothing here is beaten in both

Forest alone, one row in onnxruntime, us; recall at one false alarm a minute at most.

"""
HEADS = ("rate_hz", "trees", "depth", "groups", "debounce", "forest_us", "recall", "false_per_min", "delay_ms",
         "lead_used", "macro_f1")  # fmt: skip


def page(cost: dict[str, Any], latency: dict[str, Any]) -> str:
    """The whole page."""
    told = "; ".join(f"{name.replace('_', ' ')} {value:.2f}" for name, value in latency["ratios"].items())
    return "\n\n".join(
        [
            INTRO,
            FRONT + markdown([_row(row) for row in cost["front"]]),
            "## Everything that was tried\n\nOne thing changed at a time, and trees against depth.\n\n"
            + markdown([_row(row) for row in cost["rows"]]),
            "## One decision beside its peers\n\nAll in turns in one run, us; the floor is a busy wait as long as our "
            f"step. Ratios: {told}.\n\n" + markdown(latency["rows"]),
        ]
    ) + "\n"


def _row(row: dict[str, Any]) -> dict[str, Any]:
    return {head: row[head] for head in HEADS}


def figure(rows: list[dict[str, Any]], front: list[dict[str, Any]]) -> str:
    """Left recall against the forest's time with the front; right recall and delay by debounce, rate and groups."""
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(9.4, 3.6))
        drawn.suptitle("simulated", x=0.995, ha="right", fontsize=8, color=WARNING, style="italic")
        left, right = drawn.subplots(1, 2)
        left.plot([r["forest_us"] for r in rows], [r["recall"] for r in rows], "o", color=QUIET, markersize=4)
        left.plot([r["forest_us"] for r in front], [r["recall"] for r in front], "o-", color=OURS, markersize=5)
        for row in front:
            _named(left, row["forest_us"], row["recall"], f"{row['trees']} trees")
        left.set(xlabel="forest alone, us a decision", ylabel="risky slips caught at 1 false alarm a minute", xscale="log")
        late = [row for row in rows if row["trees"] == 60 and row["depth"] is None and row["delay_ms"] is not None]
        right.plot([r["delay_ms"] for r in late], [r["recall"] for r in late], "o", color=OURS, markersize=5)
        for row in late:
            _named(right, row["delay_ms"], row["recall"], _what(row))
        right.set(xlabel="asked so long after the load came on, ms (median)")
        for axes in (left, right):
            axes.grid(color="#e4e7eb")
        return svg(drawn)


def _named(axes: Axes, x: float, y: float, name: str) -> None:
    axes.annotate(name, (x, y), (4, 4), textcoords="offset points", fontsize=7, color="#52606d")


def _what(row: dict[str, Any]) -> str:
    """What is not the default about a row."""
    told = [f"{row['rate_hz']:g} Hz"] if row["rate_hz"] != 150.0 else []
    told += [f"debounce {row['debounce']}"] if row["debounce"] != 2 else []
    return ", ".join(told + ([row["groups"]] if row["groups"] != "clock-free" else [])) or "default"


if __name__ == "__main__":
    bench, docs = Path(sys.argv[1]), Path(sys.argv[2])
    measured = json.loads((bench / "cost.json").read_text("utf-8"))
    decided = json.loads((bench / "latency.json").read_text("utf-8"))
    write_whole(docs / "what-accuracy-costs.svg", figure(measured["rows"], measured["front"]))
    write_whole(docs / "what-accuracy-costs.md", page(measured, decided))
