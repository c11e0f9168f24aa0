"""docs/features.md, written from the feature groups themselves: `python -m export.features_page >
docs/features.md`."""

from __future__ import annotations

import math
import sys

from edge_runtime.contact import NORMAL_FLOOR
from export.features import GROUPS, LAGS_S, feature_count
from export.spec import StepSpec
from export.step_graph import feature_graph

SHOWN = (6, 58.9)
"""Sensors and rate the page's numbers are for."""

HEAD = """# Features

Written by `python -m export.features_page`; a test keeps it in step with the code.

x[t] is the guarded, prepared sample (C channels), Sum x the sum over the sensors, and l a lag of {lags} s
(rounded to samples, at most 0.50 s back). Zs = max(Sum z, floor): the grip force, but never less than {floor}, because
in the air a ratio of noise to noise says nothing. Memory is how far back a feature can see, exactly; a test alters
older samples and finds every bit of the features unchanged (while a lost sample is bridged, its last good value
stands in, which is at most 20 ms older). Numbers are for {sensors} sensors at {rate} Hz; nodes are
what the group adds to a graph that has only `now`. What each brings and costs in microseconds: `make ablation`.

| group | features | memory, s | nodes | formula | why |
|---|---|---|---|---|---|
"""


def page() -> str:
    """The page as Markdown."""
    sensors, rate_hz = SHOWN
    head = HEAD.format(
        lags=", ".join(f"{lag:.2f}" for lag in LAGS_S),
        floor=", ".join(f"{value:g} {unit}" for unit, value in NORMAL_FLOOR.items()),
        sensors=sensors,
        rate=rate_hz,
    )
    alone = _nodes(("now",))
    return head + "".join(_row(name, alone) for name in GROUPS)


def _row(name: str, alone: int) -> str:
    group = GROUPS[name]
    memory = (
        f"{group.memory_s:.2f}" if math.isfinite(group.memory_s) else "unlimited: not clock-free"
    )
    nodes = "0" if name == "now" else str(_nodes(("now", name)) - alone)
    formula = group.formula.replace("|", "\\|")
    return f"| `{name}` | {feature_count(_spec((name,)))} | {memory} | {nodes} | {formula} | {group.reason} |\n"


def _nodes(groups: tuple[str, ...]) -> int:
    return len(feature_graph(_spec(groups)).graph.node)


def _spec(groups: tuple[str, ...]) -> StepSpec:
    return StepSpec(SHOWN[0], SHOWN[1], "N", groups)


if __name__ == "__main__":
    sys.stdout.write(page())
