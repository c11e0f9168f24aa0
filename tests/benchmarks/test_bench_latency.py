"""Time of a decision: hot and as deployed, the way of a sample, and a broken budget is named."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from functools import partial
from typing import ClassVar

import numpy as np
import pytest

from holdfast.core.schema import DEFAULT_MODEL, model_path
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.model import Model
from holdfast.live import bench
from holdfast.live.bench import (
    BUDGET,
    C_STEP,
    FLOOR,
    GRIP,
    OLDER,
    STEP,
    CallTimes,
    StageTimes,
    ratios,
)
from holdfast.live.loop import STAGES

LIMITS = tomllib.loads(BUDGET.read_text("utf-8"))["at_most"]


def test_the_bench_times_a_file_an_older_one_and_the_way_of_a_sample(run, tmp_path):
    """On the virtual hand; in C too where there is a compiler, which is made for this run alone."""
    model = model_path(DEFAULT_MODEL)
    words = ("bench", "latency", "--older", model, "--seconds", 0.4, "--out", tmp_path)
    code, out, err = run(*words)
    assert code == 0, err
    assert STEP in out
    found = json.loads((tmp_path / "latency.json").read_text("utf-8"))
    timed = {row["what"] for row in found["rows"]}
    assert timed - {C_STEP} == {STEP, OLDER, GRIP, FLOOR}
    in_c = C_STEP in timed
    engines = ["onnxruntime", "C"] if in_c else ["onnxruntime"]
    stages = [*STAGES, "read to emit"]
    assert [(row["engine"], row["stage"]) for row in found["way"]] == [
        (engine, stage) for engine in engines for stage in stages
    ]
    measured = {row["budget"] for row in found["budgets"]}
    assert measured == LIMITS.keys() - (set() if in_c else {"c_step_over_step"})
    assert not list(model.parent.glob("*-c"))


class Schedule(VirtualClock):
    """Notes what it is asked to wait for."""

    waits_ns: ClassVar[list[int]] = []

    def wait_until(self, t_ns: int) -> None:
        self.waits_ns.append(t_ns)
        super().wait_until(t_ns)


def test_as_deployed_calls_come_once_a_period_and_take_turns_by_the_second(monkeypatch):
    monkeypatch.setattr(bench, "MonotonicClock", Schedule)
    came: list[str] = []
    calls = {name: partial(came.append, name) for name in ("one", "other")}
    times = bench.time_deployed(calls, rate_hz=20.0, seconds=2.0)
    a_second = 20 + bench.FIRST
    assert came == (["one"] * a_second + ["other"] * a_second) * 2
    # what the other call left in the caches does not count
    sizes = {name: len(values) for name, values in times.items()}
    assert sizes == dict.fromkeys(calls, 40)
    # asleep in between, for a period
    assert set(np.diff(Schedule.waits_ns)) == {50_000_000}


def timed(name: str, p50_us: float, p99_us: float, hot_us: float = 1.0) -> CallTimes:
    return CallTimes(name, hot_us, hot_us, p50_us, p99_us)


def test_ratios_are_of_calls_as_deployed():
    calls = [timed(STEP, 10.0, 40.0, 4.0), timed(GRIP, 2.0, 10.0)]
    on_a_board = {
        "step_and_grip_of_period": pytest.approx(0.05),
        "grip_over_step": 0.2,
    }
    assert ratios(calls, rate_hz=1000.0) == on_a_board
    calls += [timed(C_STEP, 1.0, 9.0), timed(OLDER, 20.0, 30.0, 16.0)]
    assert ratios(calls, rate_hz=1000.0) == {**on_a_board, "c_step_over_step": 0.1}
    way = [
        StageTimes("onnxruntime", stage, us, us, 0)
        for stage, us in zip(STAGES, (2000.0, 1.0, 10.0, 2.0, 3.0), strict=True)
    ]
    assert bench.around_over_step(way) == pytest.approx(0.6)


def test_a_broken_budget_is_named_with_its_limit():
    rows = bench.budget_rows(
        {"grip_over_step": 0.9, "model_mib": 7.9, "no_budget": 1e9}
    )
    assert bench.broken(rows) == ["grip_over_step: 0.9, at most 0.5"]


MOST_OWN_MB = 58.0
"""Memory of no file: 55 of the live path, 62 with a second copy of the model."""
LIVE_PATH = """
import sys
import numpy as np
from holdfast.core.contract import Sample
from holdfast.edge_runtime.monitor import GripMonitor, Model
monitor = GripMonitor(Model(sys.argv[1]), None)
card = monitor.card
monitor.feed(Sample(0, np.zeros(card.n_channels), np.ones(card.n_channels // 3, dtype=np.bool_), 0))
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(status["RssAnon"].split()[0])
"""


def test_the_live_path_keeps_no_second_copy_of_its_file_and_is_within_its_memory():
    path = model_path(DEFAULT_MODEL)
    # a fresh process: memory that was once used is rarely given back
    command = [sys.executable, "-c", LIVE_PATH, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    # how many pages of files are mapped differs by machine, so those do not count
    assert float(done.stdout) / 1024 <= MOST_OWN_MB
    size = path.stat().st_size
    model = Model(path)
    # whatever the session holds of the file, it is not its bytes
    held = [one for one in vars(model.session).values() if isinstance(one, bytes)]
    assert max(map(len, held), default=0) < size // 100
