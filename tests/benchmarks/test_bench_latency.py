"""`holdfast bench latency`: a row a call, ratios of one run, and a broken budget is named."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from dataclasses import replace

import pytest

from benchmarks import timed_calls
from benchmarks.cost import peers
from holdfast.core.schema import DEFAULT_MODEL, model_path
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.latency import check as bench
from holdfast.evaluation.latency.calls import (
    BARE,
    C_FLOOR,
    C_STEP,
    FLOOR,
    GRIP,
    OWN,
    STEP,
)
from holdfast.evaluation.latency.check import (
    BUDGET,
    C_RATIOS,
    CallTimes,
    budgets,
    latency,
    ratios,
)
from holdfast.evaluation.latency.memory import LIVE_PATH, memory
from holdfast.simulation.scene_file import SceneFile, read_scene_file


def in_long_steps(name: str, rate_hz: float) -> SceneFile:
    """A card for trials that are timed, not looked at."""
    return replace(read_scene_file(name, rate_hz=rate_hz), step_s=0.02)


@pytest.mark.filterwarnings("ignore::holdfast.export.spec.BandsLeftOut")
def test_every_call_has_its_row_and_every_budget_its_figure(monkeypatch, eight_classes):
    monkeypatch.setattr(bench, "TRIALS", 30)
    monkeypatch.setattr(bench, "STREAMED", 2)
    monkeypatch.setattr(bench, "read_scene_file", in_long_steps)
    few = replace(bench.RAW_BASELINE.situation, n_estimators=10)
    monkeypatch.setattr(
        bench, "RAW_BASELINE", replace(bench.RAW_BASELINE, situation=few)
    )
    figures = latency(eight_classes.model, turns=3)
    timed = {row.what for row in figures.rows}
    # these need a compiler
    assert timed - {C_STEP, C_FLOOR} == {STEP, GRIP, OWN, BARE, FLOOR}
    limited = set(tomllib.loads(BUDGET.read_text("utf-8"))["at_most"])
    measured = {*figures.ratios, "model_mib", "over_libraries_mb"}
    assert limited - measured == (set() if C_STEP in timed else set(C_RATIOS))
    assert measured <= limited
    assert (C_FLOOR in timed) == (C_STEP in timed)


def timed(name: str, p50_us: float, p999_us: float) -> CallTimes:
    return CallTimes(name, 100, p50_us, p999_us, p999_us, p50_us)


def test_ratios_are_of_medians_and_the_tail_of_the_floor_s_tail():
    calls = {name: timed(name, 10.0, 20.0) for name in (STEP, OWN, BARE)}
    calls |= {GRIP: timed(GRIP, 2.0, 9.0), FLOOR: timed(FLOOR, 10.0, 10.0)}
    without_a_compiler = ratios(list(calls.values()))
    calls |= {C_STEP: replace(timed(C_STEP, 1.0, 9.0), cold_p50_us=2.0)}
    calls |= {C_FLOOR: timed(C_FLOOR, 1.0, 3.0)}
    in_c = dict(zip(C_RATIOS, (0.1, 3.0, 0.2), strict=True))
    assert ratios(list(calls.values())) == {**in_c, **without_a_compiler}
    assert without_a_compiler == {
        "step_over_bare_full_depth_forest": 1.0,
        "step_over_own_learner": 1.0,
        "grip_over_step": 0.2,
        "step_p999_over_floor_p999": 2.0,
    }


WITHIN = {
    "step_over_bare_full_depth_forest": 1.0,
    "step_over_own_learner": 1.0,
    "grip_over_step": 0.2,
    "step_p999_over_floor_p999": 1.0,
}
"""Ratios that keep every budget."""


def broken(ratios: dict[str, float], n_bytes: int, over_mb: float) -> list[str]:
    return [one.line for one in budgets(ratios, n_bytes, over_mb) if one.is_broken]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({}, ""),
        ({"step_over_own_learner": 99.0}, "step_over_own_learner: 99, at most"),
        ({C_RATIOS[0]: 0.1}, ""),
        ({C_RATIOS[0]: 0.9}, "c_step_over_step: 0.9, at most"),
        ({C_RATIOS[2]: 0.9}, "c_cold_over_step_cold: 0.9, at most"),
    ],
)
def test_a_broken_budget_is_named_with_its_limit(change, line):
    found = broken(WITHIN | change, 2**20, over_mb=40.0)
    assert [one.startswith(line) for one in found] == ([True] if line else [])


def test_a_model_or_a_process_too_big_is_over_budget():
    assert len(broken(WITHIN, 9 * 2**20, over_mb=60.0)) == 2


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


def test_peers_and_an_older_file_are_timed_beside_the_step(
    monkeypatch, eight_classes, tmp_path
):
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
