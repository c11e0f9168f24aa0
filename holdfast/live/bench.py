"""`holdfast bench latency`: whether this machine is fast enough for a model file, as deployed.

Every call is timed twice on the golden sequence of the file, whose faults and values take every
path. *Hot*: in rows of a hundred. *As deployed*: once each period, asleep in between, as the loop
of a hand makes it; caches are cold then, and a step takes several times as long. In both, calls
take turns, so that a busy moment hits all alike. The floor is a busy wait as long as the hot step:
its spread is the machine's own jitter.

    step in onnxruntime  guard, bank, detectors, features, learner, votes
    step in C            the same, where a compiler or a C form is
    grip command         friction margin, controller and supervisor, from the step's answer on

The way of a sample is a live run with each engine, by stage: read, convert, step, decide, emit. Its
step has the watches of edge_runtime/health.py in it.
"""

from __future__ import annotations

import os
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from itertools import cycle
from pathlib import Path

import numpy as np

from holdfast import edge_runtime
from holdfast.core.contract import BoolArray, FloatArray, Json, Sample
from holdfast.core.lines import LineWriter
from holdfast.core.source import MonotonicClock
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.model import Model, answers_of, golden_input
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.live.hand_files import force_of
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
BUDGET = Path(edge_runtime.__file__).with_name("budget.toml")
Calls = dict[str, Callable[[], object]]
TURNS = 40
"""Rounds in which every call takes its turn, hot."""
CALLS_A_TURN = 100
FIRST = 3
"""Calls of a second that do not count as deployed: another call had the caches before them."""


@dataclass(frozen=True)
class BenchRequest:
    """What is measured: a model, its C form, an older file beside it, and a hand's URL.

    compiled: None without a C form. seconds: of each call as deployed, and of each live run.
    """

    model: Model
    compiled: OpenedModel | None = None
    older: Model | None = None
    source: str = "virtual://ft232h"
    calibration: Path | None = None
    seconds: float = 20.0


@dataclass(frozen=True)
class CallTimes:
    """Percentiles of a call's time, us: hot in a row, and as deployed."""

    what: str
    hot_p50_us: float
    hot_p99_us: float
    p50_us: float
    p99_us: float


def figures_of(request: BenchRequest) -> Json:
    """What latency.json holds: calls, the way of a sample, budgets, and what breaks one."""
    model, rate_hz = request.model, request.model.card.rate_hz
    rows = call_times(_calls(request), rate_hz, request.seconds)
    way = way_of_a_sample(request)
    found = {
        **ratios(rows, rate_hz),
        "around_over_step": around_over_step(way),
        "model_mib": model.path.stat().st_size / 2**20,
    }
    limited = budget_rows(found)
    return {
        "model": model.card.model_id,
        "rate_hz": rate_hz,
        "source": request.source,
        "rows": [asdict(row) for row in rows],
        "way": [asdict(row) for row in way],
        "budgets": limited,
        "broken": broken(limited),
    }


def _calls(request: BenchRequest) -> Calls:
    step = step_of(request.model)
    calls: Calls = {STEP: step}
    if request.compiled is not None:
        calls[C_STEP] = step_of(request.compiled)
    if request.older is not None:
        calls[OLDER] = step_of(request.older)
    # the median: a floor as long as a usual call, not as a disturbed one
    usual_us = float(np.median(time_in_turns({STEP: step}, turns=5)[STEP]))
    return {**calls, GRIP: grip_of(request.model), FLOOR: busy_wait(usual_us)}


def ratios(rows: Sequence[CallTimes], rate_hz: float) -> dict[str, float]:
    """Ratios of one run as deployed, by the name of their budget; of C where it was timed."""
    of = {one.what: one for one in rows}
    step, grip = of[STEP], of[GRIP]
    found = {
        # the rest of the time between two samples is left for the bus and for a busy machine
        "step_and_grip_of_period": 1e-6 * rate_hz * (step.p99_us + grip.p99_us),
        "grip_over_step": grip.p50_us / step.p50_us,
    }
    if C_STEP in of:
        found["c_step_over_step"] = of[C_STEP].p50_us / step.p50_us
    return found


def budget_rows(found: Mapping[str, float]) -> list[Json]:
    """Figures by the name of their budget, and their largest values."""
    limits = tomllib.loads(BUDGET.read_text(encoding="utf-8"))["at_most"]
    return [
        {"budget": name, "value": found[name], "at_most": most}
        for name, most in limits.items()
        if name in found
    ]


def broken(rows: Sequence[Json]) -> list[str]:
    """A line for each budget that a figure exceeds."""
    return [
        f"{row['budget']}: {row['value']:.3g}, at most {row['at_most']:g}"
        for row in rows
        if row["value"] > row["at_most"]
    ]


def step_of(model: OpenedModel) -> Callable[[], object]:
    """Step over the golden sequence with its faults again and again."""
    values, valid = golden(model)
    graph = model.stepper(answers_of(model.card))
    turn = cycle(range(len(values)))

    def step() -> None:
        index = next(turn)
        # Into the buffers of the graph, as the live loop does it: no array is made.
        graph.sample[0] = values[index]
        graph.valid[0] = valid[index]
        graph.step()

    return step


def grip_of(model: Model) -> Callable[[], object]:
    """The grip controller's command for each golden sample, its predictions made before."""
    card = model.card
    monitor = GripMonitor(model, None)
    felt = []
    for k, (values, valid) in enumerate(zip(*golden(model), strict=True)):
        # Times at the model's rate: no sample is late, and no state unknown for it.
        sample = Sample(round(k * 1e9 / card.rate_hz), values, valid, k)
        felt.append((monitor.feed(sample), values, valid))

    fingers = card.n_channels // 3
    control = GripControl("holdfast", card.rate_hz, unit=card.unit, n_fingers=fingers)
    turn = cycle(felt)
    return lambda: control.step(*next(turn))


def golden(model: OpenedModel) -> tuple[FloatArray, BoolArray]:
    """Values [T, C] and valid [T, C/3] of the sequence that this file is checked with at load."""
    card = model.card
    return golden_input(card.n_channels, card.unit, card.settle_samples)


def call_times(calls: Calls, rate_hz: float, seconds: float) -> list[CallTimes]:
    """Calls of microseconds, hot and as deployed."""
    with real_time():
        hot = time_in_turns(calls)
    deployed = time_deployed(calls, rate_hz, seconds)
    rows = []
    for name, times_us in deployed.items():
        hot_p50, hot_p99 = np.percentile(hot[name], (50, 99)).tolist()
        p50, p99 = np.percentile(times_us, (50, 99)).tolist()
        rows.append(CallTimes(name, hot_p50, hot_p99, p50, p99))
    return rows


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
                took_us = _time_us(call)
                # Turn 0 pays for what is allocated and compiled at the first call.
                if turn:
                    times[name].append(took_us)

    return {name: np.array(values) for name, values in times.items()}


def time_deployed(
    calls: Mapping[str, Callable[[], object]], rate_hz: float, seconds: float
) -> dict[str, FloatArray]:
    """Wall-clock us of calls that come once each period, asleep in between.

    Each call has `seconds` of its own, a second at a time in turn, and without the first few calls
    of it; as in a run, with real-time priority where the system gives it.
    """
    clock = MonotonicClock()
    times: dict[str, list[float]] = {name: [] for name in calls}
    with real_time():
        for _ in range(max(1, round(seconds))):
            for name, call in calls.items():
                start_ns = clock.now_ns()
                for k in range(FIRST + round(rate_hz)):
                    clock.wait_until(start_ns + round(1e9 * (k + 1) / rate_hz))
                    took_us = _time_us(call)
                    if k >= FIRST:
                        times[name].append(took_us)

    return {name: np.array(values) for name, values in times.items()}


def _time_us(call: Callable[[], object]) -> float:
    # Whole ns around the call alone: what stores the time is not in it.
    started = time.perf_counter_ns()
    call()
    ended = time.perf_counter_ns()
    return (ended - started) / 1000.0


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


# -- the way of a sample


@dataclass(frozen=True)
class StageTimes:
    """Time of a stage of the live loop, us. overruns: samples that this engine's run missed."""

    engine: str
    stage: str
    p50_us: float
    p99_us: float
    overruns: int


def way_of_a_sample(request: BenchRequest) -> list[StageTimes]:
    """A live run with each engine: a hand is read, and answers are written as JSON lines.

    Raises the errors of `holdfast run`.
    """
    models: dict[str, OpenedModel] = {"onnxruntime": request.model}
    if request.compiled is not None:
        models["C"] = request.compiled
    clock = RunClock()
    to_force = force_of(request.calibration)
    lines = LineOutput([LineWriter(os.open(os.devnull, os.O_WRONLY))], say)
    source = open_live(request.source, clock=clock, report=say, to_force=to_force)
    rows = []
    with closing(lines), closing(source), real_time():
        for name, model in models.items():
            end = until(lambda: False, clock, request.seconds)
            done = answer(source, model, clock, emit_to([lines]), end)
            for stage, us in done.latency_us().items():
                times_us = us["p50"], us["p99"]
                rows.append(StageTimes(name, stage, *times_us, done.overruns))
    return rows


def around_over_step(way: Sequence[StageTimes]) -> float:
    """What convert, decide and emit take together, over the step of onnxruntime."""
    of = {one.stage: one.p50_us for one in way if one.engine == "onnxruntime"}
    return (of["convert"] + of["decide"] + of["emit"]) / of["step"]
