"""Time of a decision: a row a call, ratios of one run, and a broken budget is named."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from dataclasses import replace

import pytest

from benchmarks import latency, timed_calls
from benchmarks.cost import peers
from benchmarks.latency import BARE, C_FLOOR, C_STEP, OWN, part_ratios
from holdfast.core.schema import DEFAULT_MODEL, model_path
from holdfast.edge_runtime.model import Model
from holdfast.evaluation import bench
from holdfast.live.bench import (
    BUDGET,
    FLOOR,
    GRIP,
    LIVE_PATH,
    STEP,
    CallTimes,
    board_ratios,
    budget_figures,
    budgets,
    memory,
)

LIMITS = tomllib.loads(BUDGET.read_text("utf-8"))


def test_a_board_s_figures_have_every_budget_of_a_board(eight_classes):
    figures = bench.figures_of(eight_classes.model, turns=3)
    assert [row["what"] for row in figures["rows"]] == [STEP, GRIP, FLOOR]
    assert [one["budget"] for one in figures["budgets"]] == list(LIMITS["at_most"])


@pytest.mark.filterwarnings("ignore::holdfast.export.spec.BandsLeftOut")
def test_the_parts_of_a_step_have_their_budgets_too(monkeypatch, eight_classes):
    monkeypatch.setattr(latency, "simulated_set", lambda *_: eight_classes.data)
    few = replace(latency.RAW_BASELINE.situation, n_estimators=10)
    raw = replace(latency.RAW_BASELINE, situation=few)
    monkeypatch.setattr(latency, "RAW_BASELINE", raw)
    figures = latency.figures_of(eight_classes.model, turns=3)
    timed = {row["what"] for row in figures["rows"]}
    assert timed - {C_STEP, C_FLOOR} == {STEP, GRIP, OWN, BARE, FLOOR}
    assert (C_FLOOR in timed) == (C_STEP in timed)
    measured = {one["budget"] for one in figures["budgets"]}
    # these need a compiler
    in_c = {name for name in LIMITS["parts"] if name.startswith("c_")}
    missing = set() if C_STEP in timed else in_c
    assert measured == {*LIMITS["at_most"], *LIMITS["parts"]} - missing


def timed(name: str, p50_us: float, p999_us: float, cold_us: float = 0.0) -> CallTimes:
    return CallTimes(name, 100, p50_us, p999_us, p999_us, cold_us)


def test_ratios_are_of_medians_and_the_tail_of_the_floor_s_tail():
    calls = [timed(STEP, 10.0, 20.0, 40.0), timed(GRIP, 2.0, 9.0, 10.0)]
    calls += [timed(FLOOR, 10.0, 5.0), timed(OWN, 5.0, 9.0), timed(BARE, 4.0, 9.0)]
    assert board_ratios(calls, rate_hz=1000.0) == {
        "step_and_grip_of_period": pytest.approx(0.05),
        "grip_over_step": 0.2,
        "step_p999_over_floor_p999": 4.0,
    }
    without_a_compiler = {
        "step_over_bare_full_depth_forest": 2.5,
        "step_over_own_learner": 2.0,
    }
    assert part_ratios(calls) == without_a_compiler
    calls += [timed(C_STEP, 1.0, 9.0, 8.0), timed(C_FLOOR, 1.0, 3.0)]
    in_c = {"c_step_over_step": 0.1, "c_p999_over_floor_p999": 3.0}
    assert part_ratios(calls) == {
        **without_a_compiler,
        **in_c,
        "c_cold_over_step_cold": 0.2,
    }


def test_a_broken_budget_is_named_with_its_limit():
    limited = budgets("at_most", {"grip_over_step": 0.9, "model_mib": 7.9})
    assert budget_figures(limited)["broken"] == ["grip_over_step: 0.9, at most 0.5"]


MOST_OWN_MB = 58.0
"""Memory of no file: 55 of the live path, 62 with a second copy of the model."""
OWN_KB = """
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("RssAnon")))
"""


def test_the_live_path_keeps_no_second_copy_of_its_file_and_is_within_its_memory():
    path = model_path(DEFAULT_MODEL)
    floor, live = memory(path)
    assert 0.0 < floor.resident_mb < live.resident_mb
    # how many pages of files are mapped differs by machine, so the budget of these is the bench's
    words = [sys.executable, "-c", LIVE_PATH + OWN_KB, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert int(done.stdout) / 1024 <= MOST_OWN_MB
    size = path.stat().st_size
    model = Model(path)
    # whatever the session holds of the file, it is not its bytes
    held = [one for one in vars(model.session).values() if isinstance(one, bytes)]
    assert max(map(len, held), default=0) < size // 100


def test_peers_and_an_older_file_are_timed_beside_the_step(monkeypatch, eight_classes):
    few = replace(peers.RAW_BASELINE.situation, n_estimators=3)
    raw = replace(peers.RAW_BASELINE, situation=few)
    monkeypatch.setattr(peers, "RAW_BASELINE", raw)
    monkeypatch.setattr(peers, "simulated_set", lambda *_: eight_classes.data)
    monkeypatch.setattr(timed_calls, "simulated_set", lambda *_: eight_classes.data)
    path = model_path(DEFAULT_MODEL)

    found = peers.peer_times(path, 1, 2)
    rows = {row["call"]: row["step_us"] for row in found["peers"]}
    assert {STEP, peers.SKLEARN, peers.THESIS} <= set(rows)
    slow = rows[peers.THESIS] < peers.LEAST_THESIS_OVER_STEP * rows[STEP]
    assert bool(found["broken"]) == slow

    beside = timed_calls.steps_beside(path, path)
    assert [row["file"] for row in beside][:2] == ["the older file", "this file"]
    assert beside[0]["over_first"] == 1.0
