"""`holdfast bench latency`: whether this machine is fast enough for a model file, as deployed.

*As deployed*: in live runs, each with its own engine or file, that take turns. A hand
is read once each period, and each sample goes its whole way: read, convert, step, decide, emit.
Between two samples the loop sleeps, so caches are cold, and a step takes several times as long. The
step of such a run is the step as deployed, so there is one figure of it. The grip command and the
busy wait follow each sample, outside its stages.

*Hot*: each call in rows of a hundred, on the golden sequence of the file, whose faults and values
take every path. Calls take turns, so that a busy moment hits all alike. The floor is a busy wait as
long as the hot step: its spread is the machine's own jitter.

    step in onnxruntime  guard, bank, detectors, features, learner, votes
    step in C            the same, where a compiler or a C form is
    grip command         friction margin, controller and supervisor, from the step's answer on

As deployed, a step has the watches of edge_runtime/health.py in it.
"""

from __future__ import annotations

import os
import time
import tomllib
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np

from holdfast import edge_runtime
from holdfast.core.contract import FloatArray, Json, Sample
from holdfast.core.lines import LineWriter
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.model import Model, answer_names, golden_input
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.live.hand_files import force_of
from holdfast.live.loop import Summary, percentiles
from holdfast.live.outputs import LineOutput, emit_to
from holdfast.live.run import answer
from holdfast.live.running import RunClock, real_time, say, until
from holdfast.live.sources import open_live

STEP = "step in onnxruntime"
C_STEP = "step in C"
OLDER = "step of the older file"
GRIP = "grip command"
FLOOR = "busy-wait reference"
"""Names of the calls, as latency.json has them."""
ENGINES = {STEP: "onnxruntime", C_STEP: "C"}
"""The runs that the way of a sample shows."""
BUDGET = Path(edge_runtime.__file__).with_name("budget.toml")
Calls = dict[str, Callable[[], object]]
TURNS = 40
"""Rounds in which every call takes its turn, hot."""
CALLS_A_TURN = 100
TURN_S = 5.0
"""So long a live run has before the next one takes its turn."""
Percentiles = dict[str, float]
"""p50 and p99 of times, us."""


@dataclass(frozen=True)
class BenchRequest:
    """What is measured: a model, its C form, an older file beside it, and a hand's URL.

    compiled: None without a C form. seconds: of each live run.
    """

    model: Model
    compiled: OpenedModel | None = None
    older: Model | None = None
    source: str = "virtual://ft232h"
    calibration: Path | None = None
    seconds: float = 20.0

    def models(self) -> dict[str, OpenedModel]:
        """The models by the name of their step."""
        models: dict[str, OpenedModel] = {STEP: self.model}
        if self.compiled is not None:
            models[C_STEP] = self.compiled
        if self.older is not None:
            models[OLDER] = self.older
        return models


def figures_of(request: BenchRequest) -> Json:
    """What latency.json holds: calls, the way of a sample, budgets, and those that are exceeded.

    Raises the errors of `holdfast run`.
    """
    card = request.model.card
    calls: Calls = {}
    for name, model in request.models().items():
        calls[name] = step_of(model)

    # the median: a floor as long as a usual call, not as a disturbed one
    usual = percentiles(time_in_turns({STEP: calls[STEP]}, turns=5)[STEP])
    between = {GRIP: grip_of(request.model), FLOOR: busy_wait(usual["p50"])}
    with real_time():
        hot = time_in_turns(calls | between)
        runs, deployed = live_runs(request, between)

    way: list[Json] = []
    for name, run in runs.items():
        stages = run.latency_us()
        deployed[name] = stages["step"]
        # the older file is there for its step alone
        if name == OLDER:
            continue
        for stage, us in stages.items():
            of = {"engine": ENGINES[name], "stage": stage, "overruns": run.overruns}
            way.append(of | _named(us))

    rows: list[Json] = []
    for name, values in hot.items():
        us = _named(percentiles(values), "hot_") | _named(deployed[name])
        rows.append({"what": name, **us})

    found = ratios(deployed, runs[STEP].latency_us(), card.rate_hz)
    found["model_mib"] = request.model.path.stat().st_size / 2**20
    budgets = budget_rows(found)
    return {
        "model": card.model_id,
        "rate_hz": card.rate_hz,
        "source": request.source,
        "rows": rows,
        "way": way,
        "budgets": budgets,
        "broken": [row["budget"] for row in budgets if row["value"] > row["at_most"]],
    }


def _named(us: Percentiles, before: str = "") -> Json:
    """Median and 99 % by their names in latency.json."""
    return {f"{before}p50_us": us["p50"], f"{before}p99_us": us["p99"]}


# -- budgets


def ratios(
    deployed: Mapping[str, Percentiles],
    stages: Mapping[str, Percentiles],
    rate_hz: float,
) -> dict[str, float]:
    """Ratios of one run as deployed, by the name of their budget; of C where it was timed.

    deployed: us of each call; stages: of the way of a sample in onnxruntime.
    """
    step, grip = deployed[STEP], deployed[GRIP]
    # what a sample takes besides reading it and its step
    around_us = sum(stages[one]["p50"] for one in ("convert", "decide", "emit"))
    found = {
        # the rest of the time between two samples is left for the bus and for a busy machine
        "step_and_grip_of_period": 1e-6 * rate_hz * (step["p99"] + grip["p99"]),
        "grip_over_step": grip["p50"] / step["p50"],
        "around_over_step": around_us / step["p50"],
    }
    if C_STEP in deployed:
        found["c_step_over_step"] = deployed[C_STEP]["p50"] / step["p50"]
    return found


def budget_rows(found: Mapping[str, float]) -> list[Json]:
    """Figures by the name of their budget, and their largest values."""
    limits = tomllib.loads(BUDGET.read_text(encoding="utf-8"))["at_most"]
    rows = []
    for name, most in limits.items():
        # the C form is not everywhere
        if name in found:
            rows.append({"budget": name, "value": found[name], "at_most": most})
    return rows


# -- calls, and hot


def step_of(model: OpenedModel) -> Callable[[], object]:
    """Step over the golden sequence with its faults again and again."""
    card = model.card
    rows = golden_input(card.n_channels, card.unit, card.settle_samples)
    graph = model.stepper(answer_names(card))
    turn = cycle(zip(*rows, strict=True))

    def step() -> None:
        # Into the buffers of the graph, as the live loop does it: no array is made.
        graph.sample[0], graph.valid[0] = next(turn)
        graph.step()

    return step


def grip_of(model: Model) -> Callable[[], object]:
    """The grip controller's command for each golden sample, its predictions made before."""
    card = model.card
    rows = golden_input(card.n_channels, card.unit, card.settle_samples)
    monitor = GripMonitor(model, None)
    felt = []
    for k, (values, valid) in enumerate(zip(*rows, strict=True)):
        # Times at the model's rate: no sample is late, and no state unknown for it.
        sample = Sample(round(k * 1e9 / card.rate_hz), values, valid, k)
        felt.append((monitor.feed(sample), values, valid))

    fingers = card.n_channels // 3
    control = GripControl("holdfast", card.rate_hz, unit=card.unit, n_fingers=fingers)
    turn = cycle(felt)
    return lambda: control.step(*next(turn))


def busy_wait(microseconds: float) -> Callable[[], None]:
    """A call that does nothing for this time.

    Its tail is the machine's own jitter (the reference).
    """
    wait_ns = round(1000 * microseconds)

    # Not a sleep: a process that sleeps is measured by how late the system wakes it.
    def wait() -> None:
        until_ns = time.perf_counter_ns() + wait_ns
        while time.perf_counter_ns() < until_ns:
            pass

    return wait


def time_in_turns(
    calls: Mapping[str, Callable[[], object]],
    turns: int = TURNS,
    calls_a_turn: int = CALLS_A_TURN,
) -> dict[str, FloatArray]:
    """Wall-clock us of every call, [turns x calls_a_turn] each.

    The first turn is warm-up and left out.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(turns + 1):
        for name, call in calls.items():
            for _ in range(calls_a_turn):
                took_us = time_us(call)
                # Turn 0 pays for what is allocated and compiled at the first call.
                if turn:
                    times[name].append(took_us)

    return {name: np.array(values) for name, values in times.items()}


def time_us(call: Callable[[], object]) -> float:
    """Wall-clock us of one call."""
    # Whole ns around the call alone: what stores the time is not in it.
    started = time.perf_counter_ns()
    call()
    ended = time.perf_counter_ns()
    return (ended - started) / 1000.0


# -- as deployed


def live_runs(
    request: BenchRequest, between: Calls
) -> tuple[dict[str, Summary], dict[str, Percentiles]]:
    """Live runs by the name of their step, and percentiles of what was called between samples.

    A hand is read, and answers are written as JSON lines.
    """
    clock = RunClock()
    to_force = force_of(request.calibration)
    lines = LineOutput([LineWriter(os.open(os.devnull, os.O_WRONLY))], say)
    source = open_live(request.source, clock=clock, report=say, to_force=to_force)
    models = request.models()
    runs: dict[str, Summary] = {}
    for name in models:
        runs[name] = Summary()
    times: dict[str, list[float]] = {}
    for name in between:
        times[name] = []

    # asked between two samples, outside the stages of both
    def called() -> bool:
        for name, call in between.items():
            times[name].append(time_us(call))
        return False

    turns = max(1, round(request.seconds / TURN_S))
    with closing(lines), closing(source):
        for name in turns * list(models):
            end = until(called, clock, request.seconds / turns)
            run = runs[name]
            answer(source, models[name], clock, emit_to([lines]), end, summary=run)

    deployed = {}
    for name, us in times.items():
        deployed[name] = percentiles(np.array(us))
    return runs, deployed
