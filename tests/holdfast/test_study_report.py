"""Two virtual participants from consent to report, and what a report says and does not say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import Run
from hazard_marks import ADVERSE_EVENT
from recorder_bench import said
from study_bench import TRIALS, Study

from holdfast.core.errors import DataNotFound
from holdfast.sessions.study.outcome import outcome_of, summary_lines, write_report
from holdfast.sessions.study.run import write_participant_report
from holdfast.training.datasets import load

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


def test_trials_are_counted_by_how_they_ended_and_steps_by_what_was_done(
    two: Study,
) -> None:
    figures, page = report_of(two, "p01")
    counts = {(one["object"], one["action"]): one for one in figures["trials"]}
    soft = counts["soft-ball", "pass"]
    assert (soft["planned"], soft["kept"], soft["interrupted"]) == (2, 2, 1)
    assert counts["soft-ball", "pull"]["kept"] == 0
    states = [one["state"] for one in figures["parts"]]
    assert states == ["done"] * 4 + ["skipped"] + ["done"] * 2
    assert [one["text"] for one in figures["notes"]] == ["first <note>"]
    assert "first &lt;note&gt;" in page


def test_a_study_of_a_scene_says_that_it_is_a_rehearsal(two: Study) -> None:
    figures, page = report_of(two, "p01")
    assert figures["rehearsal"]
    assert "A rehearsal without a participant" in page


def test_a_void_film_is_not_counted_and_an_unfinished_study_says_so(
    tmp_path: Path, card: Path
) -> None:
    study = Study(tmp_path, TRIALS, f"sim://{card}")
    study.run("  " + "   " + "q")
    for number, void in ((1, None), (2, "the camera was unplugged")):
        meta = study.home / f"soft-ball/pass/trial_{number}/meta.json"
        filmed = json.loads(meta.read_text()) | {"camera": {"void": void}}
        meta.write_text(json.dumps(filmed))
    outcome = outcome_of(study.out, "p01", study.protocol)
    counts = [(one.kept, one.filmed) for one in outcome.trials]
    assert counts == [(2, 1), (0, 0), (0, 0)]
    page = write_report(study.home, outcome)
    assert "not finished" in page.read_text()
    assert said(summary_lines(outcome, page), "2 of 6 trials kept")


def test_the_report_of_a_person_can_be_written_again(two: Study, run: Run) -> None:
    before = (two.out / "p02/report.html").read_bytes()
    words = f"--out {two.out} --person p02 --report"
    code, out, err = run("study", two.path, *words.split())
    assert code == 0, err
    assert "p02: 6 of 6 trials kept, 0 adverse events" in out
    assert (two.out / "p02/report.html").read_bytes() == before


def test_a_folder_without_a_study_has_no_report(two: Study, tmp_path: Path) -> None:
    (tmp_path / "p09").mkdir()
    with pytest.raises(DataNotFound, match="no study of this person"):
        outcome_of(tmp_path, "p09", two.protocol)
