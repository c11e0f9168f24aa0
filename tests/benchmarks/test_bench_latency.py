"""`holdfast bench latency`: every peer has its row, ratios are of one run, and a broken budget is
named."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from dataclasses import replace

import pytest

from holdfast.core.reading import DEFAULT_MODEL, model_path
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.latency import check as bench
from holdfast.evaluation.latency.calls import (
    BARE,
    C_FLOOR,
    C_STEP,
    FLOOR,
    GRIP,
    OWN,
    SKLEARN,
    STEP,
    THESIS,
    WALK,
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
def test_every_peer_has_its_row_and_every_budget_its_figure(monkeypatch, eight_classes):
    monkeypatch.setattr(bench, "TRIALS", 30)
    monkeypatch.setattr(bench, "STREAMED", 2)
    monkeypatch.setattr(bench, "SLOW_CALLS", 4)
    monkeypatch.setattr(bench, "read_scene_file", in_long_steps)
    few = replace(bench.RAW_BASELINE.situation, n_estimators=10)
    monkeypatch.setattr(
        bench, "RAW_BASELINE", replace(bench.RAW_BASELINE, situation=few)
    )
    figures = latency(eight_classes.model, turns=3)
    timed = {row.what for row in figures.rows}
    # these need a compiler
    assert timed - {WALK, C_STEP, C_FLOOR} == {
        STEP,
        GRIP,
        OWN,
        BARE,
        SKLEARN,
        THESIS,
        FLOOR,
    }
    budget = tomllib.loads(BUDGET.read_text("utf-8"))
    limited = set(budget["at_most"]) | set(budget["at_least"])
    measured = {*figures.ratios, "model_mib", "over_libraries_mb"}
    assert limited - measured == (set() if C_STEP in timed else set(C_RATIOS))
    assert measured <= limited
    assert (C_FLOOR in timed) == (C_STEP in timed)
    assert figures.bytes == eight_classes.model.stat().st_size


def timed(name: str, p50_us: float, p999_us: float) -> CallTimes:
    return CallTimes(name, 100, p50_us, p999_us, p999_us, p50_us)


def test_a_row_of_the_json_has_percentiles_by_their_names():
    written = CallTimes("step", 7, 1.0, 2.0, 3.0, 4.0).to_json()
    assert written == {
        "what": "step",
        "n": 7,
        "p50": 1.0,
        "p99": 2.0,
        "p99.9": 3.0,
        "cold_p50": 4.0,
    }


def test_ratios_are_of_medians_and_the_tail_of_the_floor_s_tail():
    calls = {name: timed(name, 10.0, 20.0) for name in (STEP, OWN, BARE, SKLEARN)}
    calls |= {GRIP: timed(GRIP, 2.0, 9.0)}
    calls |= {THESIS: timed(THESIS, 4000.0, 9000.0), FLOOR: timed(FLOOR, 10.0, 10.0)}
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
        "thesis_over_step": 400.0,
    }


WITHIN = {
    "step_over_bare_full_depth_forest": 1.0,
    "step_over_own_learner": 1.0,
    "grip_over_step": 0.2,
    "step_p999_over_floor_p999": 1.0,
    "thesis_over_step": 1000.0,
}
"""Ratios that keep every budget."""


def broken(ratios: dict[str, float], n_bytes: int, over_mb: float) -> list[str]:
    return [one.line for one in budgets(ratios, n_bytes, over_mb) if one.is_broken]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({}, ""),
        ({"step_over_own_learner": 99.0}, "step_over_own_learner: 99, at most"),
        ({"thesis_over_step": 1.0}, "thesis_over_step: 1, at least"),
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
