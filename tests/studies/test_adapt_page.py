"""The study of adaptation: its cards, and its page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from page_tables import filled

from holdfast.simulation.scenes.scene_file import read_scene_file
from studies.adapt import STYLES, adapt_card


def test_every_table_of_the_page_has_its_place(tmp_path: Path) -> None:
    row: dict[str, Any] = {
        "style": "p1",
        "file": "as it is",
        "blocked": 3,
        "handovers": 20,
    }
    row |= {
        "saved": 6,
        "preventable": 8,
        "extra_force_n_p95": 5.9,
        "extra_delay_ms_p95": 264.0,
    }
    for name in ("blocked", "disturbed", "saved"):
        row |= {f"{name}_share": 0.5, f"{name}_share_ci": (0.25, 0.75)}
    text = filled("docs/recording-and-study.md", {"adapt": {"rows": [row]}}, tmp_path)
    assert "| p1 | as it is | 3 of 20 | 5.9 | 264 | 0.50 | 6 of 8 |" in text


@pytest.mark.parametrize("style", STYLES)
def test_a_person_of_a_style_hands_over_eight_times_in_it(
    style: str, tmp_path: Path
) -> None:
    (tmp_path / "card.toml").write_text(adapt_card(style), "utf-8")
    card, shipped = (
        read_scene_file(str(tmp_path / "card.toml")),
        read_scene_file("adapt"),
    )
    (passes,) = [row for row in card.rows if row.action == "pass"]
    (plain,) = [row for row in shipped.rows if row.action == "pass"]
    assert passes.count * len(passes.objects) == 8
    assert passes.values != plain.values
