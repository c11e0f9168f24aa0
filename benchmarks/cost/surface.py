"""`holdfast bench cost`: what accuracy costs in time, on scenes and on people, one choice changed at a time.

Every point is a forest asked about streams that it never met, sample by sample: how many risky slips it finds at one
false alarm a minute, how long after the load came on, and how much of the lead there was is used up. Beside it the
macro F1 over four situations of held-out windows, and, all in turns in one run, the microseconds of the forest alone
and of the whole step. Points are kept one by one, so that a run that was interrupted goes on where it was; they are
measured two at a time, or on a Dask cluster.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from joblib import Parallel, delayed, parallel_config

from benchmarks.cost import sets
from benchmarks.cost.measure import measure
from benchmarks.cost.point import GOOD, GROUPS, Point, points
from benchmarks.cost.sets import PARTS, Parts, prepare, some, whole_rows, windows
from edge_runtime.contract import FloatArray
from edge_runtime.graph import StepGraph, open_session
from edge_runtime.timing import time_in_turns
from edge_runtime.writing import write_whole
from export.verify import cut_forests
from training.featurise import FloatRows

WORKERS = 2
TIMED_ROWS = 200
TIMED_EVENTS, TIMED_S = 10, 0.2
TURNS, CALLS = 10, 60


def cost(
    folder: Path, chosen: Sequence[Point] | None = None, *, dask: str | None = None, parts: Parts = PARTS
) -> dict[str, Any]:
    """Rows of all points, and for each set the front of the step's time against what is found.

    folder: keeps sets, features and points. dask: address of a scheduler whose workers see the same folder.
    """
    chosen = points() if chosen is None else chosen
    with _workers(dask) as where:
        wanted = dict.fromkeys((point.of, point.rate_hz) for point in chosen)
        Parallel(**where)(delayed(prepare)(folder, *one, parts) for one in wanted)
        Parallel(**where)(delayed(_features)(folder, point) for point in _by_features(chosen))
        alike = _by_forest(chosen)
        one_by_one = Parallel(**where, batch_size=1, pre_dispatch=2 * WORKERS)
        kept = one_by_one(delayed(_kept)(folder, points) for points in alike)
    told = {(row["what"], row["of"]): row for rows in kept for row in rows}
    rows = [told[point.what, point.of] | us for point, us in zip(chosen, _priced(folder, chosen), strict=True)]
    return {"rows": rows, "fronts": fronts(rows)}


def _by_forest(chosen: Sequence[Point]) -> list[list[Point]]:
    """Points that share a forest together, the dearest first, so that no worker is left with it at the end."""
    alike: dict[Point, list[Point]] = {}
    for point in chosen:
        alike.setdefault(point.fitted, []).append(point)
    return sorted(alike.values(), key=lambda points: -points[0].plan(1).situation.n_estimators)


def _by_features(chosen: Sequence[Point]) -> list[Point]:
    """One point for each set of features that has to be made: the raw window, and everything else."""
    raw = {one: "window" in GROUPS[one.groups] for one in chosen}
    return list({(one.of, one.rate_hz, raw[one]): one for one in chosen}.values())


def fronts(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, list[str]]]:
    """Set -> what is good -> the points that no other beats both in it and in the step's time, cheapest first."""
    return {
        of: {good: [row["what"] for row in pareto([row for row in rows if row["of"] == of], "step_us", good)]
             for good in GOOD}
        for of in dict.fromkeys(row["of"] for row in rows)
    }  # fmt: skip


def pareto(rows: Sequence[dict[str, Any]], less: str, more: str) -> list[dict[str, Any]]:
    """Rows that no other beats in both, cheapest first.

    >>> rows = [{"t": 1, "q": 5}, {"t": 2, "q": 4}, {"t": 3, "q": 9}]
    >>> pareto(rows, "t", "q")
    [{'t': 1, 'q': 5}, {'t': 3, 'q': 9}]
    """
    front: list[dict[str, Any]] = []
    for row in sorted(rows, key=lambda row: (row[less], -row[more])):
        if not front or row[more] > front[-1][more]:
            front.append(row)
    return front


@contextmanager
def _workers(dask: str | None) -> Iterator[dict[str, Any]]:
    """Where the points are measured, as joblib is told. Named call by call: a worker's forests keep to its threads."""
    if dask is None:
        yield {"backend": "multiprocessing", "n_jobs": WORKERS}
        return
    from distributed import Client

    with Client(dask), parallel_config(backend="dask"):
        yield {}


def _features(folder: Path, point: Point) -> None:
    """Make the features of a point, unless they are there."""
    windows(folder, point)
    for part in dict.fromkeys(("train",) if point.of == "human" else ("choose", _asked(point))):
        whole_rows(folder, point, part)


def _asked(point: Point) -> str:
    """The part whose streams a point is asked about."""
    return "train" if point.of == "human" else "ask"


def _kept(folder: Path, points: Sequence[Point]) -> list[dict[str, Any]]:
    """Points that share a forest from their files, or measured and written there."""
    paths = {point: folder / "points" / f"{point.name}.json" for point in points}
    model_path = _model(folder, points[0])
    missing = [point for point in points if not paths[point].is_file()]
    if missing or not model_path.is_file():
        figures, model = measure(points[0].fitted, missing, folder)
        write_whole(model_path, model.SerializeToString())
        for point, told in zip(missing, figures, strict=True):
            write_whole(paths[point], json.dumps(asdict(point) | {"what": point.what} | told) + "\n")
    return [json.loads(path.read_text("utf-8")) for path in paths.values()]


def _model(folder: Path, point: Point) -> Path:
    return folder / "points" / f"{point.fitted.name}.onnx"


def _priced(folder: Path, chosen: Sequence[Point]) -> list[dict[str, float]]:
    """Microseconds (p50) of the forest alone and of the whole step, and bytes; all points in turns, one run."""
    calls: dict[str, Callable[[], object]] = {}
    forests = list(dict.fromkeys(point.fitted for point in chosen))
    for point in forests:
        model = onnx.load(_model(folder, point))
        calls[f"{point.name} forest"] = _forest_call(model, some(folder, point, _asked(point), TIMED_ROWS))
        calls[f"{point.name} step"] = _step_call(model, _about_events(folder, point))
    us = {name: float(np.median(times)) for name, times in time_in_turns(calls, TURNS, CALLS).items()}
    return [
        {"forest_us": us[f"{point.fitted.name} forest"], "step_us": us[f"{point.fitted.name} step"],
         "bytes": float(_model(folder, point).stat().st_size)}
        for point in chosen
    ]  # fmt: skip


def _forest_call(model: onnx.ModelProto, rows: FloatRows) -> Callable[[], object]:
    session = open_session(cut_forests(model))
    one, turn = [rows[k : k + 1] for k in range(len(rows))], cycle(range(len(rows)))
    return lambda: session.run(["votes"], {"features": one[next(turn)]})


def _step_call(model: onnx.ModelProto, samples: FloatArray) -> Callable[[], object]:
    graph = StepGraph(open_session(model.SerializeToString()))
    graph.valid[:] = True
    turn = cycle(range(len(samples)))

    def step() -> None:
        graph.sample[0] = samples[next(turn)]
        graph.step()

    return step


def _about_events(folder: Path, point: Point) -> FloatArray:
    """[T, C] samples about the load's onset, one risky slip after another: what the forest is there for."""
    recordings = sets.read(folder, point.of, point.rate_hz, _asked(point)).recordings
    about = [
        one.samples[max(0, round((event.onset_s - TIMED_S) * one.rate_hz)) :][: round(2.0 * TIMED_S * one.rate_hz)]
        for one in recordings
        for event in one.events
    ]
    return np.concatenate(about[:TIMED_EVENTS])
