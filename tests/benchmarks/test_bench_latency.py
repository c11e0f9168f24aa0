"""Time of a decision: hot and as deployed, the way of a sample, and a broken budget is named."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib

import pytest

from holdfast.core.schema import DEFAULT_MODEL, model_path
from holdfast.edge_runtime.model import Model
from holdfast.live.bench import (
    BUDGET,
    C_STEP,
    ENGINES,
    FLOOR,
    GRIP,
    OLDER,
    STEP,
    ratios,
)
from holdfast.live.loop import STAGES, WHOLE

LIMITS = tomllib.loads(BUDGET.read_text("utf-8"))["at_most"]


def test_the_bench_times_a_file_an_older_one_and_the_way_of_a_sample(run, tmp_path):
    """On the virtual hand; in C too where there is a compiler, which is made for this run alone."""
    model = model_path(f"{DEFAULT_MODEL}-tiny")
    words = ("--older", model, "--seconds", 0.4, "--out", tmp_path)
    code, out, err = run("bench", "latency", model, *words)
    assert code == 0, err
    assert STEP in out
    found = json.loads((tmp_path / "latency.json").read_text("utf-8"))
    timed = {row["what"] for row in found["rows"]}
    assert timed - {C_STEP} == {STEP, OLDER, GRIP, FLOOR}
    in_c = C_STEP in timed
    way = {(row["engine"], row["stage"]): row["p50_us"] for row in found["way"]}
    engines = [one for name, one in ENGINES.items() if name in timed]
    assert list(way) == [(one, stage) for one in engines for stage in (*STAGES, WHOLE)]
    # one figure: the step as deployed is the step on the way of a sample
    deployed = {row["what"]: row["p50_us"] for row in found["rows"]}
    for name in timed & ENGINES.keys():
        assert deployed[name] == way[ENGINES[name], "step"]
    over = [row["budget"] for row in found["budgets"] if row["value"] > row["at_most"]]
    assert found["broken"] == over
    measured = {row["budget"] for row in found["budgets"]}
    assert measured == LIMITS.keys() - (set() if in_c else {"c_step_over_step"})
    assert not list(model.parent.glob("*-c"))


def of(p50_us: float, p99_us: float) -> dict[str, float]:
    return {"p50": p50_us, "p99": p99_us}


def test_ratios_are_of_calls_as_deployed():
    times_us = (2000.0, 1.0, 10.0, 2.0, 3.0)
    way = {stage: of(us, us) for stage, us in zip(STAGES, times_us, strict=True)}
    calls = {STEP: of(10.0, 40.0), GRIP: of(2.0, 10.0)}
    on_a_board = {
        "step_and_grip_of_period": pytest.approx(0.05),
        "grip_over_step": 0.2,
        "around_over_step": pytest.approx(0.6),
    }
    assert ratios(calls, way, rate_hz=1000.0) == on_a_board
    calls |= {C_STEP: of(1.0, 9.0), OLDER: of(20.0, 30.0)}
    in_c = {**on_a_board, "c_step_over_step": 0.1}
    assert ratios(calls, way, rate_hz=1000.0) == in_c


MOST_OWN_MB = 61.0
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
