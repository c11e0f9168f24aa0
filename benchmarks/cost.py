"""`holdfast bench cost`: what accuracy costs, on scenes: trees, depth, features, rate and debounce against time.

Every point is a forest fitted on one simulated set and asked about streams it never met, sample by sample: how many
risky slips it catches at one false alarm a minute, how long after the load came on, and how much of the time that was
there is used up. The threshold on the risky share of the votes is chosen on streams of their own. Beside it the macro
F1 over four situations (windows, trials held out), and the forest's microseconds and bytes as onnxruntime runs it.
Points are kept one by one: a run that was interrupted goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_runtime.contract import RISKY_SLIP, FloatArray
from edge_runtime.errors import EmptyRecording
from edge_runtime.graph import open_session
from edge_runtime.timing import time_in_turns
from edge_runtime.writing import write_whole
from export.builder import GraphBuilder
from export.forest import Forest
from export.heads import Head, add_heads
from export.reference import reference_votes, situation_votes
from export.step_graph import add_step
from export.verify import cut_forests
from simulation.card import read_card
from simulation.folder import write_set
from simulation.scene import Scene
from training.crossval import cross_validate, fit_calibration, fit_forest
from training.datasets import load
from training.featurise import FloatRows, features_everywhere, features_of, spec_for
from training.fitting import held_out_figures
from training.objects import read_json
from training.plan import CLOCK_FREE_GROUPS, RAW_GROUPS, TrainingPlan
from training.recording import DataSet
from training.timeline import truth_path

RATES_HZ = (50.0, 100.0, 150.0, 300.0)
TREES = (1, 3, 10, 30, 60, 100, 200, 500)
DEPTHS = (4, 6, 8, 10, 14)
GROUPS = {
    "now": ("now",), "raw window": RAW_GROUPS, "now, differences": CLOCK_FREE_GROUPS[:2],
    "without activity": CLOCK_FREE_GROUPS[:-1], "all and bands": (*CLOCK_FREE_GROUPS, "bands"),
}  # fmt: skip
DEBOUNCES = (1, 2, 3)
HEAD_RATE_HZ = 150.0
TRIALS, TUNED, ASKED = 400, 100, 200
"""Trials to train on, to choose the threshold on, and to ask about."""
SEEDS = {"train": 0, "tune": 1, "ask": 2}
FALSE_PER_MIN = 1.0
THRESHOLDS = np.arange(0, 1000, 10)
"""Thousandths of the votes."""


@dataclass(frozen=True)
class Point:
    """One choice: rate, trees, depth (None: to the leaves of 8 windows), groups by name, debounce."""

    rate_hz: float = HEAD_RATE_HZ
    trees: int = 60
    depth: int | None = None
    groups: str = "clock-free"
    debounce: int = 2

    @property
    def plan(self) -> TrainingPlan:
        """As a training plan."""
        base = TrainingPlan()
        forest = replace(base.situation, n_estimators=self.trees, max_depth=self.depth)
        return replace(base, groups=GROUPS.get(self.groups, CLOCK_FREE_GROUPS), situation=forest)


def points() -> Iterator[Point]:
    """Around the default, one thing changed at a time; and trees against depth."""
    yield from (Point(debounce=debounce) for debounce in DEBOUNCES)
    yield from (Point(trees=trees) for trees in TREES)
    yield from (Point(depth=depth, trees=trees) for depth in DEPTHS for trees in (10, 60, 200))
    yield from (Point(groups=name) for name in GROUPS)
    yield from (Point(rate_hz=rate_hz) for rate_hz in RATES_HZ)


def cost(out: Path) -> dict[str, Any]:
    """Measure every point that out/cost does not hold yet; returns all rows, and the front."""
    rows = [_kept(out / "cost", point) for point in dict.fromkeys(points())]
    front = pareto(rows, "forest_us", "recall")
    return {"rows": rows, "front": front}


def pareto(rows: list[dict[str, Any]], less: str, more: str) -> list[dict[str, Any]]:
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


def _kept(folder: Path, point: Point) -> dict[str, Any]:
    """A point from its file, or measured and written there."""
    told = asdict(point)
    name = hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:12]
    path = folder / f"{name}.json"
    if path.is_file():
        row: dict[str, Any] = json.loads(path.read_text("utf-8"))
        return row
    row = told | measure(point, folder)
    write_whole(path, json.dumps(row) + "\n")
    return row


def measure(point: Point, folder: Path) -> dict[str, Any]:
    """Fit, ask, time one point."""
    data = _set(folder, point.rate_hz, "train")
    plan, everything = point.plan, np.arange(len(data.tasks["classes"]))
    features = _windows(folder, point.rate_hz, plan.groups)
    held = cross_validate(data, {"classes": features}, plan)
    forest = fit_forest(data, features, plan, "classes", everything, 0)
    threshold = choose_threshold(_streams(folder, point, "tune", forest), point)
    figures = score(_streams(folder, point, "ask", forest), point, threshold)
    return {
        "macro_f1": held_out_figures(data, held)["situations"]["macro_f1"],
        **figures, "threshold_permille": threshold, **_price(data, plan, forest, held.shares("classes"), features),
    }  # fmt: skip


@dataclass(frozen=True)
class Stream:
    """One trial free-running: risky share in thousandths [T]; times in s of onset, gross slip and loss, or None."""

    permille: npt.NDArray[np.int64]
    rate_hz: float
    onset_s: float | None
    gross_s: float | None
    lost_s: float | None
    risky: bool


def acts_at(stream: Stream, threshold: int, debounce: int) -> FloatArray:
    """Times in s at which the hand is asked to act: risky, above the threshold, `debounce` samples in a row.

    One that is on from the first sample began then, however early that is.
    """
    if not len(stream.permille):
        return np.zeros(0)
    risky = stream.permille > threshold
    run = np.convolve(risky, np.ones(debounce, dtype=np.int64))[: len(risky)] >= debounce
    return np.flatnonzero(run & ~np.concatenate([[False], run[:-1]])) / stream.rate_hz


def score(streams: list[Stream], point: Point, threshold: int) -> dict[str, Any]:
    """Recall, false alarms a minute, and of what was caught the median delay and share of the lead used.

    Recall is None without an event, and false alarms a minute without a sample. An alarm that is on already when the
    load comes on is a false one and catches nothing; a second one in the same event is neither false nor a catch.
    """
    caught, delays, shares, false, events = 0, [], [], 0, 0
    for stream in streams:
        acts = acts_at(stream, threshold, point.debounce)
        within = np.zeros(len(acts), dtype=np.bool_)
        if stream.risky and stream.onset_s is not None and stream.gross_s is not None:
            events += 1
            within = (acts >= stream.onset_s) & (acts <= (np.inf if stream.lost_s is None else stream.lost_s))
            if within.any():
                caught += 1
                delays.append(acts[within][0] - stream.onset_s)
                shares.append(delays[-1] / max(stream.gross_s - stream.onset_s, 1e-3))
        false += int((~within).sum())
    minutes = sum(len(stream.permille) / stream.rate_hz for stream in streams) / 60.0
    return {
        "recall": caught / events if events else None, "events": events,
        "false_per_min": false / minutes if minutes else None,
        "delay_ms": 1e3 * float(np.median(delays)) if delays else None,
        "lead_used": float(np.median(shares)) if shares else None,
    }  # fmt: skip


def choose_threshold(streams: list[Stream], point: Point) -> int:
    """The lowest that gives at most one false alarm a minute on streams that are not scored. Raises EmptyRecording."""
    if not any(len(stream.permille) for stream in streams):
        raise EmptyRecording("no streams to choose a threshold on", next_step="simulate some")
    for threshold in THRESHOLDS.tolist():
        if score(streams, point, threshold)["false_per_min"] <= FALSE_PER_MIN:
            return int(threshold)
    return int(THRESHOLDS[-1])


def _streams(folder: Path, point: Point, part: str, forest: Forest) -> list[Stream]:
    data, everywhere = _set(folder, point.rate_hz, part), _everywhere(folder, point.rate_hz, part, point.plan.groups)
    settle = spec_for(data, point.plan.groups).settle_samples - 1
    streams = []
    for recording, rows in zip(data.recordings, everywhere, strict=True):
        votes = situation_votes(reference_votes(forest, rows, len(data.tasks["classes"].classes)))
        permille = 1000 * votes[:, RISKY_SLIP] // votes.sum(axis=1)
        permille[votes.argmax(axis=1) != RISKY_SLIP] = 0
        permille[:settle] = 0
        truth = read_json(truth_path(folder / _name(point.rate_hz, part) / f"{recording.trial_id}.csv"))
        onset_s, gross_s, lost_s = (truth.get(name) for name in ("load_onset_s", "gross_slip_s", "contact_lost_s"))
        risky = recording.action in ("pull", "fall")
        streams.append(Stream(permille, recording.rate_hz, onset_s, gross_s, lost_s, risky))
    return streams


def _price(data: DataSet, plan: TrainingPlan, forest: Forest, shares: FloatArray, rows: FloatRows) -> dict[str, float]:
    """Microseconds (p50) and bytes of the exported forest alone, one row at a time."""
    task = data.tasks["classes"]
    spec = spec_for(data, plan.groups)
    graph = GraphBuilder(spec.n_sensors)
    head = Head("situation", task.classes, forest, fit_calibration(shares, task.label))
    add_heads(graph, add_step(graph, spec), [head])
    cut = cut_forests(graph.model())
    session = open_session(cut)
    one, turn = [rows[k : k + 1] for k in range(len(rows))], cycle(range(len(rows)))
    times = time_in_turns({"forest": lambda: session.run(["votes"], {"features": one[next(turn)]})}, turns=10)
    return {"forest_us": float(np.median(times["forest"])), "forest_bytes": float(len(cut))}


def _name(rate_hz: float, part: str) -> str:
    return f"{rate_hz:g}hz-{part}"


@cache
def _set(folder: Path, rate_hz: float, part: str) -> DataSet:
    place = folder / _name(rate_hz, part)
    trials = {"train": TRIALS, "tune": TUNED, "ask": ASKED}[part]
    if not (place / "meta.json").is_file():
        write_set(Scene(read_card("thesis", rate_hz=rate_hz), SEEDS[part]), place, trials)
    return load(place, balanced=part == "train")


@cache
def _windows(folder: Path, rate_hz: float, groups: tuple[str, ...]) -> FloatRows:
    data = _set(folder, rate_hz, "train")
    return features_of(data, spec_for(data, groups))["classes"]


@cache
def _everywhere(folder: Path, rate_hz: float, part: str, groups: tuple[str, ...]) -> list[FloatRows]:
    data = _set(folder, rate_hz, part)
    return features_everywhere(data, spec_for(data, groups))
