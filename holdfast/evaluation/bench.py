"""`holdfast bench latency`: whether this machine is fast enough for a model file.

Step and grip command are timed interleaved on one stream, the golden sequence of the file, whose
faults and values take every path. Absolute microseconds belong to one machine; ratios carry over
to others. Percentiles are of all calls but the first of each turn. That one comes to cold caches
and has a median of its own. The floor is a busy wait as long as the step: its tail is the machine's
own jitter.

    ours, whole step     guard, bank, detectors, features, learner, votes: what runs on the hand
    ours, grip command   friction margin, controller and supervisor, from the step's answer on

`make bench NAME=latency` times the parts of the step, its form in C and a bare forest as well.
"""

from __future__ import annotations

import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import cycle
from pathlib import Path

import numpy as np

from holdfast import edge_runtime
from holdfast.core.contract import BoolArray, FloatArray, Json, Sample
from holdfast.edge_runtime.graph import StepGraph
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.model import golden_input
from holdfast.edge_runtime.monitor import GripMonitor, Model

STEP = "ours, whole step"
GRIP = "ours, grip command"
FLOOR = "floor"
"""Names of the calls of `holdfast bench latency`, as latency.json has them."""
Stream = tuple[FloatArray, BoolArray]
"""Values [T, C] and valid [T, C/3] of samples that calls take in turn."""
BUDGET = Path(edge_runtime.__file__).with_name("budget.toml")
PERCENTILES = (50, 99, 99.9)
KIND = "time on this machine, samples made by formula"
"""Stands next to every figure."""
Calls = dict[str, Callable[[], object]]
TURNS = 40
"""Rounds in which every call takes its turn."""
CALLS_A_TURN = 100
"""Calls of a turn; its first comes to cold caches."""
LIBRARIES = (
    "import os; os.environ['ORT_DISABLE_TELEMETRY'] = '1'; import numpy, onnxruntime"
)
LIVE_PATH = """
import sys
import numpy as np
from holdfast.core.contract import Sample
from holdfast.edge_runtime.monitor import GripMonitor, Model
monitor = GripMonitor(Model(sys.argv[1]), None)
card = monitor.card
monitor.feed(Sample(0, np.zeros(card.n_channels), np.ones(card.n_channels // 3, dtype=np.bool_), 0))
"""
RESIDENT_KB = """
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmRSS")))
"""


@dataclass(frozen=True)
class CallTimes:
    """Time of n calls, us: percentiles of the warm ones, and the median of each turn's first."""

    what: str
    n: int
    p50_us: float
    p99_us: float
    p999_us: float
    cold_p50_us: float

    def to_json(self) -> Json:
        """As it stands in latency.json."""
        return {
            "what": self.what,
            "n": self.n,
            "p50": self.p50_us,
            "p99": self.p99_us,
            "p99.9": self.p999_us,
            "cold_p50": self.cold_p50_us,
        }


def figures_of(path: Path, turns: int = TURNS) -> Json:
    """What latency.json holds of a model file: calls, memory, budgets, and what breaks one.

    turns: how often each call takes its turn.
    """
    model = Model(path)
    stream = golden(model)
    step = step_of(model, stream)
    calls = {STEP: step, GRIP: grip_of(model, stream), **with_floor(step, FLOOR)}
    rows = timed(calls, turns)
    libraries, live = processes = memory(path)
    found = {
        **board_ratios(rows, model.card.rate_hz),
        "model_mib": path.stat().st_size / 2**20,
        # A difference: how many pages of libraries are mapped depends on the machine.
        "over_libraries_mb": live.resident_mb - libraries.resident_mb,
    }
    limited = budgets("at_most", found)
    return {
        "model": model.card.model_id,
        "rows": [row.to_json() for row in rows],
        "memory": [asdict(row) for row in processes],
        **budget_figures(limited),
    }


def board_ratios(rows: Sequence[CallTimes], rate_hz: float) -> dict[str, float]:
    """Ratios of one run, by the name of their budget."""
    of = {one.what: one for one in rows}
    step, grip = of[STEP], of[GRIP]
    return {
        # With cold caches, as a loop that sleeps between samples pays them; the rest of the time
        # between two samples is left for the bus and for a busy machine.
        "step_and_grip_of_period": 1e-6
        * rate_hz
        * (step.cold_p50_us + grip.cold_p50_us),
        # Medians for speed: their ratio changes little from run to run.
        "grip_over_step": grip.p50_us / step.p50_us,
        # Tails are compared with a floor of the same length, which has the machine's jitter alone.
        "step_p999_over_floor_p999": step.p999_us / of[FLOOR].p999_us,
    }


@dataclass(frozen=True)
class Budget:
    """A figure and its largest value in budget.toml."""

    budget: str
    value: float
    limit: float

    @property
    def is_broken(self) -> bool:
        """Whether the figure is beyond the limit."""
        return self.value > self.limit

    @property
    def line(self) -> str:
        """For people."""
        return f"{self.budget}: {self.value:.3g}, at most {self.limit:g}"

    def to_json(self) -> Json:
        """As it stands in latency.json."""
        return {**asdict(self), "limit": f"at most {self.limit:g}"}


def budgets(section: str, found: Mapping[str, float]) -> list[Budget]:
    """The budgets of a section of budget.toml whose figures were found."""
    limits = tomllib.loads(BUDGET.read_text(encoding="utf-8"))[section]
    measured = []
    for name, limit in limits.items():
        if name in found:
            measured.append(Budget(name, found[name], limit))
    return measured


def budget_figures(limited: Sequence[Budget]) -> Json:
    """The budgets as latency.json has them, and the lines of the broken ones."""
    return {
        "budgets": [one.to_json() for one in limited],
        "broken": [one.line for one in limited if one.is_broken],
    }


def step_of(model: Model, stream: Stream | None = None) -> Callable[[], object]:
    """Step over a stream again and again, by default over the golden sequence with its faults."""
    values, valid = stream or golden(model)
    graph = StepGraph(model.session)
    turn = cycle(range(len(values)))

    def step() -> None:
        index = next(turn)
        # Into the buffers of the graph, as the live loop does it: no array is made.
        graph.sample[0] = values[index]
        graph.valid[0] = valid[index]
        graph.step()

    return step


def grip_of(model: Model, stream: Stream) -> Callable[[], object]:
    """The grip controller's command for each sample of a stream, its predictions made before."""
    card = model.card
    values, valid = stream
    monitor = GripMonitor(model, None)
    period_ns = 1e9 / card.rate_hz
    predictions = []
    for k in range(len(values)):
        # Times at the model's rate: no sample is late, and no state unknown for it.
        t_ns = round(k * period_ns)
        sample = Sample(t_ns, values[k], valid[k], k)
        # All before the timing, so that only the controller is timed.
        predictions.append(monitor.feed(sample))

    fingers = card.n_channels // 3
    control = GripControl("holdfast", card.rate_hz, unit=card.unit, n_fingers=fingers)
    turn = cycle(range(len(values)))

    def command() -> None:
        index = next(turn)
        control.step(predictions[index], values[index], valid[index])

    return command


def golden(model: Model) -> Stream:
    """The sequence every file is checked with at load, of this model."""
    card = model.card
    return golden_input(card.n_channels, card.unit, card.settle_samples)


def with_floor(call: Callable[[], object], floor: str) -> Calls:
    """A busy wait as long as a call, by the floor's name."""
    # The median: a floor as long as a usual call, not as a disturbed one.
    times_us = time_in_turns({floor: call}, turns=5)[floor]
    return {floor: busy_wait(float(np.median(times_us)))}


def timed(calls: Mapping[str, Callable[[], object]], turns: int) -> list[CallTimes]:
    """Calls of microseconds that take turns, so that a busy moment hits all alike."""
    times = time_in_turns(calls, turns)
    return [_call_times(name, each.reshape(turns, -1)) for name, each in times.items()]


def _call_times(what: str, times_us: FloatArray) -> CallTimes:
    """times_us: [turns, calls]."""
    # The first call of a turn comes to cold caches, as in a live loop after 7 ms.
    p50, p99, p999 = np.percentile(times_us[:, 1:], PERCENTILES).tolist()
    cold_p50 = float(np.median(times_us[:, 0]))
    return CallTimes(what, times_us.size, p50, p99, p999, cold_p50)


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
                # Whole ns around the call alone: what stores the time is not in it.
                started = time.perf_counter_ns()
                call()
                ended = time.perf_counter_ns()
                # Turn 0 pays for what is allocated and compiled at the first call.
                if turn:
                    times[name].append((ended - started) / 1000.0)

    return {name: np.array(values) for name, values in times.items()}


def busy_wait(microseconds: float) -> Callable[[], None]:
    """A call that does nothing for this time.

    Its tail is the machine's own jitter (the reference).
    """
    wait_ns = round(1000 * microseconds)

    # Not a sleep: a process that sleeps is measured by how late the system wakes it.
    def wait() -> None:
        until = time.perf_counter_ns() + wait_ns
        while time.perf_counter_ns() < until:
            pass

    return wait


@dataclass(frozen=True)
class ProcessMemory:
    """A process: its resident memory, and the time of its start and end."""

    process: str
    resident_mb: float
    start_s: float


def memory(model_path: Path) -> list[ProcessMemory]:
    """Two processes: libraries alone, and the live path with a model."""
    rows = []
    for name, program in (
        ("floor", LIBRARIES),
        ("live path, default model", LIVE_PATH),
    ):
        started = time.perf_counter()
        # A fresh process each: memory that was once used is rarely given back.
        command = [sys.executable, "-c", program + RESIDENT_KB, str(model_path)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        # Start and end together: what a user waits for a program that does nothing else.
        took_s = time.perf_counter() - started

        # The kernel counts in KiB.
        resident_mb = int(done.stdout) / 1024
        rows.append(ProcessMemory(name, resident_mb, took_s))

    return rows
