"""The truth of a simulated source, as events of a recorded trial."""

from __future__ import annotations

from collections.abc import Callable

from holdfast.edge_runtime.live import Source
from holdfast.edge_runtime.reading import Json
from holdfast.live_sources import scene_of
from holdfast.recorder.labels import MARKS

TruthEvents = Callable[[int, int], list[Json]]
"""(time of the first sample, time of the last), ns -> events."""


def truth_of(url: str, source: Source) -> TruthEvents | None:
    """A function for the events of a trial of a scene; None for another source."""
    scene_and_trial = scene_of(url) if "://" in url else None
    if scene_and_trial is None:
        return None
    truth = scene_and_trial[1].truth
    began_ns = getattr(source, "began_ns", None)

    def events(first_ns: int, last_ns: int) -> list[Json]:
        shift_s = 0.0 if began_ns is None else 1e-9 * (began_ns - first_ns)
        return _events(truth.shifted(shift_s).to_json(), 1e-9 * (last_ns - first_ns))

    return events


def _events(truth: Json, end_s: float) -> list[Json]:
    """Phases and marks between the first sample and the last, at end_s."""
    by = {"provenance": "scene", "by": "holdfast record"}
    phases = [
        {
            "t0_s": max(0.0, one["t0_s"]),
            "t1_s": min(end_s, one["t1_s"]),
            "label": one["label"],
            **by,
        }
        for one in truth["phases"]
        if one["t1_s"] > 0.0 and one["t0_s"] < end_s
    ]
    times = {name: truth[f"{name}_s"] for name in MARKS}
    marks = [
        {"t_s": t_s, "mark": name, **by}
        for name, t_s in times.items()
        if t_s is not None and 0.0 <= t_s <= end_s
    ]
    return [*phases, *marks]
