"""The words of an evaluation's report come from what its data are."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from holdfast.data.fixture import write_fixture
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.alarms import event_scores
from holdfast.evaluation.evaluate import EvaluationRequest, evaluate_events
from holdfast.evaluation.formats import Spread
from holdfast.evaluation.report import write_event_report
from holdfast.evaluation.scored_set import Evaluation

if TYPE_CHECKING:
    from conftest import Built


@pytest.fixture(scope="module")
def recorded(
    eight_classes: Built, tmp_path_factory: pytest.TempPathFactory
) -> Evaluation:
    """A model evaluated on recordings of two people without a voluntary action. Read only."""
    folder = tmp_path_factory.mktemp("words") / "own"
    for seed, person in enumerate(("anna", "bert"), start=7):
        write_fixture(folder / person, trials_per_cell=1, seed=seed)
        meta = folder / person / "meta.json"
        about = json.loads(meta.read_text("utf-8")) | {"kind": "recorded"}
        meta.unlink()
        for action in ("pass", "put-down"):
            for away in (folder / person).glob(f"*/{action}"):
                shutil.rmtree(away)
    (folder / "meta.json").write_text(json.dumps(about), encoding="utf-8")
    model = ModelChoice(str(eight_classes.model))
    return evaluate_events(model, EvaluationRequest((str(folder),)))


def page_of(evaluation: Evaluation, folder: Path) -> str:
    page = write_event_report(folder / "report.html", evaluation).read_text("utf-8")
    return re.sub(r"\s+", " ", page)


@pytest.fixture(scope="module")
def page(recorded: Evaluation, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report of the recordings."""
    return page_of(recorded, tmp_path_factory.mktemp("page"))


def test_no_more_than_the_whole_lead_is_used() -> None:
    none = event_scores([])
    late = replace(
        none, lead_used=Spread(-0.1, 9.12, 20.0), available_ms=Spread(25, 50, 80)
    )
    assert late.share_of_lead == Spread(0.0, 1.0, 1.0)
    at_once = replace(late, available_ms=Spread(0.0, 5.0, 19.0))
    assert none.share_of_lead is at_once.share_of_lead is None


def test_an_evaluation_on_training_data_says_so_first_and_prints_no_big_number(
    recorded: Evaluation, page: str, tmp_path: Path
) -> None:
    assert '<div class="answer">' in page
    name, figures = next(iter(recorded.sets.items()))
    card = replace(figures.card, trained_on_recordings=3)
    seen = replace(recorded, sets={name: replace(figures, card=card)})
    flattered = page_of(seen, tmp_path)
    first = f"the model was trained on 3 of these {card.recordings} recordings"
    assert flattered.index(first) < flattered.index("<table")
    assert '<div class="answer">' not in flattered
    assert "grips that fail, an act" not in flattered
