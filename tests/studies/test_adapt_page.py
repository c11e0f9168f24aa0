"""The study of adaptation: its cards, its figures over persons, and its page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_tables import filled

from holdfast.core.contract import GRASP, RISKY_SLIP, SAFE_SLIP
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.evaluation.alarms import Answers
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.recording import Recording
from holdfast.training.timeline import Phase
from studies.adapt import STYLES, adapt_card, file_figures


def way(called: float) -> dict[str, Any]:
    return {
        "called": called,
        "called_ci": (0.1, 0.2),
        "recall": 0.98,
        "recall_ci": None,
        "false_per_min": 0.5,
        "false_per_min_ci": (0.4, 0.6),
        "before_gross_slip": None,
    }


def test_every_table_of_the_page_has_its_place(tmp_path: Path) -> None:
    ways = {"as it is": way(0.4), "adapted": way(0.1)}
    styles = {"styles": {"p1": {"ways": ways}}}
    made = {"adapt": styles}
    text = filled("docs/recording-and-study.md", made, tmp_path)
    assert "| p1 | adapted | 0.1 (0.10 to 0.20) | 0.98 |" in text


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


def test_a_trial_that_two_persons_files_answer_is_one_group() -> None:
    def answers(risky: bool, name: str) -> Answers:
        phases = (Phase(0, 20, GRASP), Phase(20, 40, SAFE_SLIP))
        samples, valid = np.zeros((60, 3)), np.ones((60, 1), dtype=bool)
        one = Recording(
            name, name, samples, valid, 100.0, "N", action="pass", phases=phases
        )
        situation = np.full(60, GRASP)
        situation[25:30] = RISKY_SLIP if risky else SAFE_SLIP
        return Answers(one, situation, np.full(60, 900))

    rules = DecisionRules(act_samples=1)
    one = ([answers(True, "a"), answers(False, "b")], rules)
    other = ([answers(False, "a"), answers(False, "b")], rules)
    figures = file_figures([one, other])
    assert (figures.called, figures.actions) == (0.25, 4)
    assert figures.called_ci is not None
    assert figures.called_ci[1] <= 0.5
