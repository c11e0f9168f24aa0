"""`make bench NAME=cost`: what accuracy costs in time, one choice changed at a time.

Every point is a learner evaluated on unseen streams of scenes or people, sample by sample: recall
at one false alarm a minute, delay after load onset, and the share of the lead that was used.
Further figures are macro F1 over four situations on held-out windows, and the microseconds of the
learner alone and of the whole step, all interleaved in one run: hot in a row, and the step as
deployed too, one a sample and asleep in between. Points are stored one by one, so an
interrupted run continues; they are measured many at once.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cost.features import some, whole_rows, windows
from benchmarks.cost.hands import HANDS
from benchmarks.cost.measure import Grown, measure
from benchmarks.cost.point import GOOD, GROUPS, ON_HANDS, POOLED, Point, points
from benchmarks.cost.recordings import PARTS, Parts, read, require_parts, simulate
from benchmarks.timed_calls import learner_call, step_call
from holdfast.cli.options import CORES
from holdfast.core.contract import FloatArray, Json
from holdfast.core.writing import write_whole
from holdfast.evaluation.jobs import Job, Workers
from holdfast.export.verify import cut_learners
from holdfast.live.bench import time_deployed, time_in_turns

HERE = Workers(CORES)
TIMED_ROWS = 200
TIMED_EVENTS = 10
TIMED_S = 0.2
TURNS = 10
CALLS = 60
DEPLOYED_S = 5.0
"""So long each step runs as deployed."""


@dataclass(frozen=True)
class Price:
    """Median microseconds of a point, and bytes of its graph.

    learner_us, hot_us: the learner alone and the whole step, in a row. step_us: as deployed.
    """

    learner_us: float
    hot_us: float
    step_us: float
    bytes: float


def cost(
    folder: Path,
    chosen: Sequence[Point] | None = None,
    *,
    workers: Workers = HERE,
    parts: Parts = PARTS,
) -> Json:
    """Rows of all points, the fronts of each set, and the time and cores of the new points.

    folder: keeps sets, features and points; the workers of a cluster see it too.
    """
    began_s = time.monotonic()
    chosen = points() if chosen is None else chosen
    new = sum(not _figures(folder, point).is_file() for point in chosen)
    require_parts(folder, parts)
    rates_hz = sorted({point.rate_hz for point in chosen if point.of == "scenes"})
    folder = folder.absolute()  # which the workers of a cluster need
    simulated: list[Job[None]] = [
        partial(simulate, folder, part, rates_hz, parts)
        for part in (parts if rates_hz else ())
    ]
    prepared: list[Job[None]] = [
        partial(_features, folder, alike, part) for alike, part in _by_features(chosen)
    ]
    for stage in (simulated, prepared):
        list(workers.run(stage))
    kept = workers.run([partial(_kept, folder, family) for family in _families(chosen)])
    figures_of = {(row["what"], row["of"]): row for rows in kept for row in rows}
    rows = [
        figures_of[point.what, point.of] | asdict(price)
        for point, price in zip(chosen, _priced(folder, chosen), strict=True)
    ]
    took = {
        "wall_s": time.monotonic() - began_s,
        "cores": None if workers.dask else workers.processes,
        "new_points": new,
    }
    return {"rows": rows, "fronts": fronts(rows), "took": took}


def _families(chosen: Sequence[Point]) -> list[list[Point]]:
    """Points whose forests differ in their number of trees alone, together; the slowest first."""
    alike: dict[Point, list[Point]] = {}
    for point in chosen:
        alike.setdefault(point.grown, []).append(point)
    return sorted(alike.values(), key=_most_trees, reverse=True)


def _most_trees(points: Sequence[Point]) -> int:
    return max(point.plan.situation.n_estimators for point in points)


def _by_features(chosen: Sequence[Point]) -> list[tuple[list[Point], str]]:
    """Points and a part for all features to compute, the largest first, then without bands."""
    sets: dict[Any, dict[bool, Point]] = {}
    for one in sorted(
        chosen,
        key=lambda one: ("bands" in GROUPS[one.groups], one.rate_hz),
        reverse=True,
    ):
        alike = sets.setdefault((one.of, one.rate_hz, _kind(one)), {})
        alike.setdefault("bands" in GROUPS[one.groups], one)
    largest = sorted(sets.items(), key=lambda item: item[0][1], reverse=True)
    found = [
        (list(alike.values()), part)
        for part in PARTS
        for (of, *_), alike in largest
        if of == "scenes" or part == "train"
    ]
    # One point of each kind is enough: it makes the features that all of its kind take.
    asked = {_kind(one): one for one in chosen if one in ON_HANDS}
    return found + [([one], f"ask, {name}") for name in HANDS for one in asked.values()]


def _kind(point: Point) -> str:
    """Points of a kind take their features from the same ones."""
    groups = GROUPS[point.groups]
    if groups[0].startswith(POOLED):
        return "pooled"
    return "window" if "window" in groups else "fixed"


def fronts(rows: Sequence[Json]) -> dict[str, dict[str, list[str]]]:
    """Set -> quality -> points that no other beats in it and in the step's time, fastest first."""
    return {
        of: {
            good: [
                row["what"]
                for row in pareto(
                    [row for row in rows if row["of"] == of], "step_us", good
                )
            ]
            for good in GOOD
        }
        for of in dict.fromkeys(row["of"] for row in rows)
    }


def pareto(rows: Sequence[Json], less: str, more: str) -> list[Json]:
    """Rows that no other beats in both, cheapest first.

    >>> rows = [{"t": 1, "q": 5}, {"t": 2, "q": 4}, {"t": 3, "q": 9}]
    >>> pareto(rows, "t", "q")
    [{'t': 1, 'q': 5}, {'t': 3, 'q': 9}]
    """
    front: list[Json] = []
    for row in sorted(rows, key=lambda row: (row[less], -row[more])):
        if not front or row[more] > front[-1][more]:
            front.append(row)
    return front


def _features(folder: Path, points: Sequence[Point], part: str) -> None:
    """Make the features of points, in their order, unless they are there."""
    for point in points:
        if part == "train":
            windows(folder, point)
        if part != "train" or part == _settings(point):
            whole_rows(folder, point, part)


def _settings(point: Point) -> str:
    """The part whose streams a point is evaluated on."""
    return "train" if point.of == "human" else "ask"


def _kept(folder: Path, family: Sequence[Point]) -> list[Json]:
    """Points of one forest family, from their files, or measured and written there."""
    grown = Grown(_most_trees(family))
    for fitted in dict.fromkeys(point.fitted for point in family):
        missing = [
            point
            for point in family
            if point.fitted == fitted and not _figures(folder, point).is_file()
        ]
        if missing or not _timed(folder, fitted).is_file():
            _measured(folder, fitted, missing, grown)
    return [json.loads(_figures(folder, point).read_text("utf-8")) for point in family]


def _measured(
    folder: Path, fitted: Point, points: Sequence[Point], grown: Grown
) -> None:
    """Measure points of one forest; keep their figures, the model and the rows to time it on."""
    figures, model = measure(fitted, points, folder, grown)
    write_whole(_model(folder, fitted), model.SerializeToString())
    write_whole(_learner(folder, fitted), cut_learners(model))
    packed = io.BytesIO()
    rows = some(folder, fitted, _settings(fitted), TIMED_ROWS)
    np.savez(packed, rows=rows, samples=_about_events(folder, fitted))
    write_whole(_timed(folder, fitted), packed.getvalue())
    for one in figures:
        write_whole(_figures(folder, one.point), json.dumps(one.to_json()) + "\n")


def _figures(folder: Path, point: Point) -> Path:
    return folder / "points" / f"{point.name}.json"


def _model(folder: Path, point: Point) -> Path:
    return folder / "points" / f"{point.fitted.name}.onnx"


def _learner(folder: Path, point: Point) -> Path:
    return folder / "points" / f"{point.fitted.name}.learner.onnx"


def _timed(folder: Path, point: Point) -> Path:
    return folder / "points" / f"{point.fitted.name}.npz"


def _priced(folder: Path, chosen: Sequence[Point]) -> list[Price]:
    """Price of every point; all points interleaved in one run."""
    calls: dict[str, Callable[[], object]] = {}
    by_rate: dict[float, dict[str, Callable[[], object]]] = {}
    for point in dict.fromkeys(point.fitted for point in chosen):
        timed = np.load(_timed(folder, point))
        calls[f"{point.name} learner"] = learner_call(
            _learner(folder, point).read_bytes(), timed["rows"]
        )
        step = step_call(_model(folder, point).read_bytes(), timed["samples"])
        calls[f"{point.name} step"] = step
        by_rate.setdefault(point.rate_hz, {})[f"{point.name} deployed"] = step

    times = time_in_turns(calls, TURNS, CALLS)
    for rate_hz, steps in by_rate.items():
        times |= time_deployed(steps, rate_hz, DEPLOYED_S)
    us = {name: float(np.median(values)) for name, values in times.items()}
    return [
        Price(
            learner_us=us[f"{point.fitted.name} learner"],
            hot_us=us[f"{point.fitted.name} step"],
            step_us=us[f"{point.fitted.name} deployed"],
            bytes=float(_model(folder, point).stat().st_size),
        )
        for point in chosen
    ]


def _about_events(folder: Path, point: Point) -> FloatArray:
    """[T, C] samples around load onsets, one risky slip after another."""
    recordings = read(folder, point.of, point.rate_hz, _settings(point)).recordings
    about = [
        one.samples[max(0, round((event.onset_s - TIMED_S) * one.rate_hz)) :][
            : round(2.0 * TIMED_S * one.rate_hz)
        ]
        for one in recordings
        for event in one.events
    ]
    return np.concatenate(about[:TIMED_EVENTS])
