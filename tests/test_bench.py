"""`holdfast bench`: every effect has a price, and the page shows what was measured."""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.effects import prices
from benchmarks.scenes_page import page
from benchmarks.simulator import plausibility
from simulation.card import shipped
from simulation.effects import EFFECTS

ROOT = Path(__file__).resolve().parent.parent


def test_every_effect_has_a_price_beside_the_core_s():
    rows = prices(lanes=2, pairs=1)
    wanted = {name for name, effect in EFFECTS.items() if effect.stage != "camera"}
    assert {row["effect"] for row in rows} == {"(core alone)", *wanted}
    assert rows[0]["ns_per_sample"] > 0


def test_the_lead_of_every_style_is_near_what_it_was_fitted_to():
    for row in plausibility(trials=75):
        if row["expected_ms"] is not None:
            assert 0.6 < row["p50_ms"] / row["expected_ms"] < 1.6


def test_the_page_of_scenes_names_every_card_and_effect_and_its_measured_price(tmp_path):
    prices_of = [{"effect": "(core alone)", "ns_per_sample": 1234.0}]
    prices_of += [{"effect": name, "ns_per_sample": 77.0} for name in EFFECTS]
    (tmp_path / "effects.json").write_text(json.dumps({"prices": prices_of, "empty_list_over_core": 1.0}), "utf-8")
    curves = {name: [{"x": 1.0}] for name in ("step", "by_trials", "by_elements", "plausibility")}
    (tmp_path / "simulator.json").write_text(json.dumps(curves), "utf-8")
    text = page(tmp_path)
    assert "1,234 ns" in text
    for name in [*shipped(), *EFFECTS]:
        assert f"`{name}`" in text


def test_the_page_in_the_repository_knows_every_card_and_effect():
    text = (ROOT / "docs" / "scenes.md").read_text("utf-8")
    assert [name for name in [*shipped(), *EFFECTS] if f"`{name}`" not in text] == []
