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

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from holdfast import edge_runtime
from holdfast.core.contract import FloatArray, Json
from holdfast.edge_runtime.monitor import Model
from holdfast.evaluation.latency.calls import (
    FLOOR,
    GRIP,
    STEP,
    golden,
    grip_of,
    step_of,
)
from holdfast.evaluation.latency.memory import memory
from holdfast.evaluation.latency.timing import TURNS, busy_wait, time_in_turns

BUDGET = Path(edge_runtime.__file__).with_name("budget.toml")
PERCENTILES = (50, 99, 99.9)
KIND = "time on this machine, samples made by formula"
"""Stands next to every figure."""
Calls = dict[str, Callable[[], object]]


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
    return [
        Budget(name, found[name], limit)
        for name, limit in limits.items()
        if name in found
    ]


def budget_figures(limited: Sequence[Budget]) -> Json:
    """The budgets as latency.json has them, and the lines of the broken ones."""
    return {
        "budgets": [one.to_json() for one in limited],
        "broken": [one.line for one in limited if one.is_broken],
    }
