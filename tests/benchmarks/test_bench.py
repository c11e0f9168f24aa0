"""`python -m benchmarks`: every effect has a price, and the page shows what was measured."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from page_tables import filled

from benchmarks import simulator
from benchmarks.simulator import CARD, Effort, plausibility, prices
from holdfast.simulation import shipped_scenes
from holdfast.simulation.effects.effect import EFFECT_MODULES, module_effects
from holdfast.simulation.scenes.scene_file import read_scene_file

ROOT = Path(__file__).resolve().parents[2]

COARSE = "[physics]\nstep_s = 0.01\n"
BRIEF = '"pull"\nclose_at_s = 0.1\nclosing_s = 0.1\nhold_s = 0.8\nmove_s = 0.2\ntail_s = 0.2'
"""A card's step and a pull in short."""


def test_every_effect_has_a_price_beside_the_core_s(monkeypatch):
    # a price is measured, not good physics
    effects = module_effects("texture")
    any_step = replace(effects["texture"], longest_step_s=math.inf)
    monkeypatch.setitem(effects, "texture", any_step)
    card = COARSE + CARD.replace('"pull"', BRIEF).replace("150.0", "50.0")
    rows = prices(Effort(lanes=2, pairs=1, card=card))
    assert {row.effect for row in rows} == {"(core alone)", *EFFECT_MODULES}
    assert rows[0].ns_per_sample > 0


def test_the_lead_of_every_style_is_near_what_it_was_fitted_to(monkeypatch):
    """In steps of 5 ms, which are a tenth of a lead."""
    monkeypatch.setattr(
        simulator,
        "read_scene_file",
        lambda name: replace(read_scene_file(name), step_s=0.005),
    )
    for row in plausibility(trials=75):
        if row.expected_ms is not None:
            assert 0.6 < row.p50_ms / row.expected_ms < 1.6


def test_the_page_of_scenes_names_every_card_and_effect_and_its_measured_price(
    tmp_path,
):
    prices_of = [{"effect": "(core alone)", "ns_per_sample": 1234.0}]
    prices_of += [{"effect": name, "ns_per_sample": 77.0} for name in EFFECT_MODULES]
    figures = {"prices": prices_of, "step": [{"step_ms": 1.5}]}
    text = filled("docs/scenes.md", {"simulator": figures}, tmp_path)
    assert "| 77 |" in text
    page = (ROOT / "docs" / "scenes.md").read_text("utf-8")
    for name in [*shipped_scenes(), *EFFECT_MODULES]:
        assert f"`{name}`" in text
        assert f"`{name}`" in page
