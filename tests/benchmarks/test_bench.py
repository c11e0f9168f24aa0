"""`python -m benchmarks`: every effect has a price, and the page shows what was measured."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from page_tables import filled

from benchmarks import simulator
from benchmarks.__main__ import MEASURES
from benchmarks.effects import CARD, Effort, prices
from benchmarks.pictures import PICTURES
from benchmarks.simulator import plausibility
from holdfast.simulation import shipped_scenes
from holdfast.simulation.effect import EFFECT_MODULES, module_effects
from holdfast.simulation.scene_file import read_scene_file

ROOT = Path(__file__).resolve().parents[2]

COARSE = "[physics]\nstep_s = 0.005\n"
BRIEF = '"pull"\nclose_at_s = 0.1\nclosing_s = 0.1\nhold_s = 0.8\nmove_s = 0.2\ntail_s = 0.2'
"""A card's step and a pull in short."""


SHOWN: dict[str, tuple[dict[str, Any], str]] = {
    "effects": (
        {"prices": [{"effect": "tremor", "stage": "physics", "ns_per_sample": 9.0}]},
        "tremor",
    ),
    "hand": (
        {
            "scans": [
                {
                    "bridge": "ft232h",
                    "layout": "mux",
                    "bus_khz": 400,
                    "scan_ms": 1.4,
                    "serves_model_hz": 300.0,
                }
            ]
        },
        "ft232h, mux, 400 kHz",
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
    names = ("step", "by_trials", "by_elements", "plausibility")
    curves = {name: [{"trials": 1.0}] for name in names}
    figures = {
        "effects": {"prices": prices_of, "empty_list_over_core": 1.0},
        "simulator": curves,
    }
    text = filled("docs/scenes.md", figures, tmp_path)
    assert "| 77 |" in text
    for name in [*shipped_scenes(), *EFFECT_MODULES]:
        assert f"`{name}`" in text


def test_the_page_in_the_repository_knows_every_card_and_effect():
    text = (ROOT / "docs" / "scenes.md").read_text("utf-8")
    assert [
        name for name in [*shipped_scenes(), *EFFECT_MODULES] if f"`{name}`" not in text
    ] == []
