"""`python -m benchmarks`: every effect has a price, and the page shows what was measured."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from page_tables import filled

from benchmarks import simulator
from benchmarks.__main__ import MEASURES
from benchmarks.effects import CARD, Effort, prices
from benchmarks.hold_and_pull import measure, rows
from benchmarks.mujoco_scene import Scene
from benchmarks.pictures import PICTURES
from benchmarks.simulator import plausibility
from holdfast.simulation import shipped_scenes
from holdfast.simulation.effect import EFFECT_MODULES, module_effects
from holdfast.simulation.scene_file import read_scene_file
from studies.row_names import OURS

ROOT = Path(__file__).resolve().parents[2]

FRICTION = {
    "law": "regularised",
    "share": 0.5,
    "vibration": 0.0,
    "lets_go": False,
    "creep_m": 0.0324,
    "step_s": 1e-3,
    "cost_ns_per_s": 12300.0,
}


COARSE = "[physics]\nstep_s = 0.005\n"
BRIEF = '"pull"\nclose_at_s = 0.1\nclosing_s = 0.1\nhold_s = 0.8\nmove_s = 0.2\ntail_s = 0.2'
"""A card's step and a pull in short."""


def study() -> dict[str, Any]:
    """Figures as `make study NAME=scenes` writes them, one rate and one line of the table."""
    row = {
        level: {"accuracy": value, "macro_f1": value + 0.01}
        for level, value in (("eight", 0.701), ("seven", 0.801), ("four", 0.901))
    }
    calls = {
        "risky": {"share": 0.921},
        "safe": {"share": 0.031},
        "grasp": {"share": None},
    }
    rows: dict[str, Any] = {OURS: row | {"calls": calls}}
    rate = {
        "data": {"n_trials": 9},
        "rows": rows,
        "leak": {
            "eight_class_accuracy": 0.702,
            "eight_class_accuracy_ci99": [0.69, 0.71],
        },
        "objects": {OURS: {"soft-ball": rows[OURS]}},
        "others": {"apple": {"rows": rows}},
        "retrainings": {
            OURS: {
                "recall": {"grasp_light": [0.9, 0.95]},
                "spread": {"grasp_light": 0.05},
            }
        },
    }
    return {"headline_hz": "150", "rates": {"150": rate}}


SHOWN: dict[str, tuple[dict[str, Any], str]] = {
    "latency": (
        {
            "rows": [
                {"what": "ours, whole step", "p50": 60.0, "p99": 70.0, "p99.9": 90.0}
            ]
        },
        "ours, whole step",
    ),
    "training": (
        {"rows": [{"trials": n, "features_cpu_s": 0.1 * n} for n in (10, 20)]},
        "features",
    ),
    "instructions": (
        {"rows": [{"what": "whole step", "instructions": 5e5}]},
        "whole step",
    ),
    "effects": (
        {"prices": [{"effect": "tremor", "stage": "physics", "ns_per_sample": 9.0}]},
        "tremor",
    ),
    "hand": (
        {
            "scans": [
                {
                    "bridge": "ft232h",
                    "reads": "1-byte",
                    "layout": "mux",
                    "bus_khz": 400,
                    "scan_ms": 1.4,
                    "serves_model_hz": 300.0,
                }
            ]
        },
        "ft232h, 1-byte, mux, 400 kHz",
    ),
    "onset": (
        {
            "ramps": [
                {"fps": 60.0, "mm_per_s2": a, "start_worst_ms": 9.0}
                for a in (10.0, 100.0)
            ]
        },
        "60 fps",
    ),
    "simulator": (
        {
            "step": [
                {
                    "step_ms": ms,
                    "p50_ms": ms,
                    "p90_ms": 2 * ms,
                    "cpu_s_per_trial": 0.1 / ms,
                }
                for ms in (1.0, 2.0)
            ]
        },
        "90 % of slips",
    ),
}
"""What each measure finds, in short, and what must be read in its picture; the cost surface has
tests of its own."""


def test_every_measure_leaves_a_picture_that_names_what_was_measured():
    assert set(PICTURES) == {*SHOWN, "cost", "robust"} <= set(MEASURES)
    for name, (figures, read) in SHOWN.items():
        assert read in PICTURES[name](figures)


def test_our_core_holds_what_friction_can_hold_and_lets_go_what_it_cannot():
    row = measure(Scene(hold_s=1.5, pull_s=0.4), 2e-3, 2)
    assert row.creep_mm is not None
    assert row.creep_mm < 1e-9
    assert row.slip_8n_ms is None
    assert 80 < (row.slip_16n_ms or 0.0) < 200


def test_rows_of_the_peer_stand_beside_ours(tmp_path):
    run = {
        "variant": "default",
        "step_s": 1e-3,
        "cpu_s_per_s": 8e-3,
        "held_s": 11.5,
        "creep_m": None,
        "pulls": [{"slip_s": 0.101}, {"slip_s": None}],
    }
    (tmp_path / "mujoco.json").write_text(
        json.dumps({"versions": {"mujoco": "4.0.0"}, "runs": [run]}), "utf-8"
    )
    peer = rows(tmp_path, Scene(hold_s=0.02, settled_s=0.01, pull_s=0.01))[-1]
    assert (peer.solver, peer.held_s, peer.slip_8n_ms) == (
        "MuJoCo 4.0.0, default",
        11.5,
        101.0,
    )
    assert peer.creep_mm is None


def test_every_effect_has_a_price_beside_the_core_s(monkeypatch):
    # a price is measured, not good physics
    effects = module_effects("texture")
    any_step = replace(effects["texture"], longest_step_s=math.inf)
    monkeypatch.setitem(effects, "texture", any_step)
    rows = prices(Effort(lanes=2, pairs=1, card=COARSE + CARD.replace('"pull"', BRIEF)))
    assert {row.effect for row in rows} == {"(core alone)", *EFFECT_MODULES}
    assert rows[0].ns_per_sample > 0


def test_the_lead_of_every_style_is_near_what_it_was_fitted_to(monkeypatch):
    """In steps of 3 ms, which are a few per cent of a lead."""
    monkeypatch.setattr(
        simulator,
        "read_scene_file",
        lambda name: replace(read_scene_file(name), step_s=0.003),
    )
    for row in plausibility(trials=75):
        if row.expected_ms is not None:
            assert 0.6 < row.p50_ms / row.expected_ms < 1.6


def test_the_page_of_scenes_names_every_card_and_effect_and_its_measured_price(
    tmp_path,
):
    prices_of = [{"effect": "(core alone)", "ns_per_sample": 1234.0}]
    prices_of += [{"effect": name, "ns_per_sample": 77.0} for name in EFFECT_MODULES]
    names = ("step", "by_trials", "by_elements", "plausibility", "hold_and_pull")
    curves = {name: [{"trials": 1.0}] for name in names}
    figures = {
        "effects": {"prices": prices_of, "empty_list_over_core": 1.0},
        "simulator": {**curves, "friction": [FRICTION]},
        "scenes": study(),
    }
    text = filled("docs/scenes.md", figures, tmp_path)
    assert "| core alone, CPU ns per sample | 1,234 |" in text
    assert (
        "| 150 Hz: ours, clock-free | 0.701 | 0.801 | 0.901 | 0.911 | 0.921 | 0.031 | - |"
        in text
    )
    assert "| 150 | 0.702 (0.690 to 0.710) |" in text
    assert "| apple: ours, clock-free | 0.701" in text
    assert "| grasp light | 0.900 0.950 | 0.05 |" in text
    for name in [*shipped_scenes(), *EFFECT_MODULES]:
        assert f"`{name}`" in text


def test_the_page_in_the_repository_knows_every_card_and_effect():
    text = (ROOT / "docs" / "scenes.md").read_text("utf-8")
    assert [
        name for name in [*shipped_scenes(), *EFFECT_MODULES] if f"`{name}`" not in text
    ] == []
