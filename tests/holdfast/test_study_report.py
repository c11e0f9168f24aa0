"""Two virtual participants from consent to report, and what a report says and does not say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import Run
from hazard_marks import ADVERSE_EVENT
from study_bench import TRIALS, Study

from holdfast.data.datasets import load
from holdfast.sessions.study.run import write_participant_report

CARD = TRIALS
TASKS = (("hard-ball", "fall"), ("soft-ball", "pass"), ("soft-ball", "pull"))


@pytest.fixture(scope="module")
def two(card: Path, tmp_path_factory: pytest.TempPathFactory) -> Study:
    """p01 with an operator, an adverse event and answers; p02 in a second run. Read only."""
    study = Study(
        tmp_path_factory.mktemp("two"), CARD, f"sim://{card}", "--seconds", "60"
    )
    typed = "   shock & <awe>\n1\ny\n  nfirst <note>\n  s"
    assert study.run(typed + "    ", in_trials={40: "a"}) == "finished"
    other = Study(study.path.parent, CARD, f"sim://{card}?seed=1", "--seconds", "60")
    other.args.person = "p02"
    assert other.run(" " * 30) == "finished"
    for person in ("p01", "p02"):
        write_participant_report(study.out, person, study.protocol)
    return study


def report_of(study: Study, person: str) -> tuple[dict[str, Any], str]:
    """(figures, page) of a person."""
    home = study.out / person
    return json.loads((home / "report.json").read_text()), (
        home / "report.html"
    ).read_text()


def test_two_virtual_participants_go_from_consent_to_report(
    two: Study, run: Run
) -> None:
    data = load(two.out, windows="natural")
    assert data.groups() == ["p01", "p02"]
    kept = {("p01", *task): 2 for task in TASKS[:2]} | {
        ("p02", *task): 2 for task in TASKS
    }
    found = [(one.person, one.object_name, one.action) for one in data.recordings]
    assert {key: found.count(key) for key in set(found)} == kept
    code, out, _ = run("check", two.out)
    assert (code, "ready for holdfast" in out) == (0, True)
    for person in ("p01", "p02"):
        assert report_of(two, person)[0]["finished"]


@ADVERSE_EVENT.mark
def test_an_adverse_event_comes_before_everything_that_was_recorded(two: Study) -> None:
    figures, page = report_of(two, "p01")
    (event,) = figures["adverse"]
    assert (event["severity"], event["text"], event["step"]) == (
        "mild",
        "shock & <awe>",
        3,
    )
    assert page.index("Adverse events: 1") < page.index("<h2>Trials")
    assert "shock &amp; &lt;awe&gt;" in page
    assert "<awe>" not in page
    assert "No adverse event was noted" in report_of(two, "p02")[1]
