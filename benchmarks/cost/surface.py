"""`make bench NAME=cost`: what accuracy costs in time, one choice changed at a time.

Every point is a learner evaluated on unseen streams of scenes or people, sample by sample: recall
at one false alarm a minute, delay after load onset, macro F1 over four situations on held-out
windows; and the microseconds of a step, hot in a row and as deployed, one a sample and asleep in
between, the points of a rate interleaved in one run. Points are stored one by one, so an
interrupted run continues.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path

import numpy as np
import onnx

from benchmarks.cost.measure import measure
from benchmarks.cost.point import POINTS, Point
from benchmarks.cost.recordings import PARTS, Parts, evaluated_part, read, simulate
from holdfast.cli.options import CORES
from holdfast.core.contract import FloatArray, Json
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.graph import StepGraph, open_session
from holdfast.evaluation.jobs import Workers
from holdfast.live.bench import time_in_turns, time_us
from holdfast.live.running import RunClock, real_time

HERE = Workers(CORES)
Calls = dict[str, Callable[[], object]]
TIMED_EVENTS = 10
TIMED_S = 0.2
TURNS = 10
CALLS = 60
DEPLOYED_S = 5.0
"""So long each step runs as deployed."""


def cost(
    folder: Path,
    points: Sequence[Point] = POINTS,
    *,
    workers: Workers = HERE,
    parts: Parts = PARTS,
) -> Json:
    """Rows of all points, and the time that the new ones took.

    folder: keeps sets and points; the workers of a cluster see it too.
    """
    began_s = time.monotonic()
    folder = folder.absolute()  # which the workers of a cluster need
    missing = [one for one in points if not _file(folder, one, "json").is_file()]
    rates_hz = sorted({point.rate_hz for point in missing if point.of == "scenes"})
    if rates_hz:
        simulated = [partial(simulate, folder, part, rates_hz, parts) for part in parts]
        list(workers.run(simulated))

    alike: dict[Point, list[Point]] = {}
    for point in missing:
        alike.setdefault(point.featured, []).append(point)
    list(workers.run([partial(_keep, folder, of) for of in alike.values()]))

    times = _times_us(folder, points)
    rows = []
    for point in points:
        kept = json.loads(_file(folder, point, "json").read_text("utf-8"))
        rows.append({**kept, **times[point.fitted]})
    took = {"wall_s": time.monotonic() - began_s, "new_points": len(missing)}
    return {"rows": rows, "took": took}


def _keep(folder: Path, points: Sequence[Point]) -> None:
    """Measure points with the same features; keep figures, models and the samples to time on."""
    for fitted, found in measure(points, folder).items():
        write_whole(_file(folder, fitted, "onnx"), found.model.SerializeToString())
        for point, row in found.rows.items():
            write_whole(_file(folder, point, "json"), json.dumps(row) + "\n")


def _file(folder: Path, point: Point, kind: str) -> Path:
    return folder / "points" / f"{point.name}.{kind}"


def _times_us(folder: Path, points: Sequence[Point]) -> dict[Point, Json]:
    """Median us of every learner's step; those of a rate interleaved in one run."""
    steps: dict[float, Calls] = {}
    samples: dict[Point, FloatArray] = {}
    fitted = list(dict.fromkeys(point.fitted for point in points))
    for point in fitted:
        at = Point(point.of, point.rate_hz)
        if at not in samples:
            samples[at] = _about_events(folder, at)
        model = onnx.load(_file(folder, point, "onnx"))
        step = step_call(model.SerializeToString(), samples[at])
        steps.setdefault(point.rate_hz, {})[point.name] = step

    hot: dict[str, FloatArray] = {}
    deployed: dict[str, list[float]] = {}
    with real_time():
        for rate_hz, of in steps.items():
            hot |= time_in_turns(of, TURNS, CALLS)
            deployed |= time_deployed(of, rate_hz)
    found = {}
    for point in fitted:
        step_us = float(np.median(deployed[point.name]))
        hot_us = float(np.median(hot[point.name]))
        found[point] = {"step_us": step_us, "hot_us": hot_us}
    return found


def time_deployed(
    calls: Calls, rate_hz: float, seconds: float = DEPLOYED_S
) -> dict[str, list[float]]:
    """Wall-clock us of calls that come once each period, asleep in between.

    Each call has `seconds` of its own, a second at a time in turn.
    """
    clock = RunClock()
    times: dict[str, list[float]] = {name: [] for name in calls}
    for name in round(seconds) * list(calls):
        start_ns = clock.now_ns()
        for k in range(1, 1 + round(rate_hz)):
            clock.wait_until(start_ns + round(1e9 * k / rate_hz))
            times[name].append(time_us(calls[name]))
    return times


def step_call(model: bytes, samples: FloatArray) -> Callable[[], object]:
    """Steps over one of the samples [T, C] a call, in turn; all sensors are valid."""
    graph = StepGraph(open_session(model))
    graph.valid[:] = True
    turn = cycle(samples)

    def step() -> None:
        graph.sample[0] = next(turn)
        graph.step()

    return step


def _about_events(folder: Path, point: Point) -> FloatArray:
    """[T, C] samples around load onsets, one risky slip after another."""
    about = []
    for one in read(folder, point, evaluated_part(point)).recordings:
        for event in one.events:
            first = max(0, round((event.onset_s - TIMED_S) * one.rate_hz))
            about.append(one.samples[first:][: round(2 * TIMED_S * one.rate_hz)])
    return np.concatenate(about[:TIMED_EVENTS])
