"""Two virtual participants from consent to report, and what a report says and does not say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from command_line import Run
from hazard_marks import ADVERSE_EVENT
from recorder_bench import said
from study_bench import TRIALS, Study

from holdfast.core.errors import DataNotFound
from holdfast.sessions.study.outcome import outcome_of, summary_lines, write_report
from holdfast.sessions.study.run import write_participant_report
from holdfast.training.datasets import load

if TYPE_CHECKING:
    from conftest import Built

CARD = TRIALS
TASKS = (("hard-ball", "fall"), ("soft-ball", "pass"), ("soft-ball", "pull"))


@pytest.fixture(scope="module")
def two(
    card: Path, eight_classes: Built, tmp_path_factory: pytest.TempPathFactory
) -> Study:
    """p01 with an operator, an adverse event and answers; p02 in a second run. Read only."""
    study = Study(
        tmp_path_factory.mktemp("two"), CARD, f"sim://{card}", "--seconds", "60"
    )
    study.args.model = eight_classes.model
    typed = "   shock & <awe>\n1\ny\n  nfirst <note>\n  s"
    assert study.run(typed + "    ", in_trials={40: "a"}) == "finished"
    other = Study(study.path.parent, CARD, f"sim://{card}?seed=1", "--seconds", "60")
    other.args.person = "p02"
    assert other.run(" " * 30) == "finished"
    for person in ("p01", "p02"):
        write_participant_report(study.out, person, study.protocol, eight_classes.model)
    return study


def report_of(study: Study, person: str) -> tuple[dict[str, Any], str]:
    """(figures, page) of a person."""
    home = study.out / person
    return json.loads((home / "report.json").read_text()), (
        home / "report.html"
    ).read_text()


@pytest.mark.filterwarnings("ignore::holdfast.export.spec.BandsLeftOut")
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
        figures, page = report_of(two, person)
        assert figures["finished"]
        assert figures["answers"]["kind"] == "simulated"
        pictures = len(figures["answers"]["actions"]) + 1
        assert page.count("<svg") == pictures, "each action, and one trial in full"


@ADVERSE_EVENT.mark
def test_an_adverse_event_comes_before_everything_that_was_recorded(two: Study) -> None:
    figures, page = report_of(two, "p01")
    (event,) = figures["adverse"]
    assert (event["severity"], event["text"], event["step"]) == (
        "mild",
        "shock & <awe>",
        3,
    )
    assert page.index("Adverse events: 1") < page.index("Recall by action")
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


def test_every_figure_of_the_model_adds_up_over_actions_and_cells(two: Study) -> None:
    answers = report_of(two, "p02")[0]["answers"]
    assert answers["trials"] == 6
    assert answers["labels_by"].keys() == {"scene"}
    for name in ("trials", "labelled", "recognised", "false_alarms"):
        for rows in (answers["actions"], answers["cells"]):
            assert sum(one[name] for one in rows) == answers["all"][name], name
    assert answers["all"]["labelled"] == 6


def test_trials_without_a_label_are_not_recognised_and_not_missed(
    tmp_path: Path, card: Path, eight_classes: Built
) -> None:
    study = Study(tmp_path, TRIALS, f"sim://{card}")
    study.run("  " + "   " + " " + "   " + "q")
    for truth in study.home.rglob("tactile.truth.json"):
        truth.write_text(json.dumps(json.loads(truth.read_text()) | {"phases": []}))
    for number, void in ((1, None), (2, "the camera was unplugged")):
        meta = study.home / f"soft-ball/pass/trial_{number}/meta.json"
        meta.write_text(
            json.dumps(json.loads(meta.read_text()) | {"camera": {"void": void}})
        )
    outcome = outcome_of(study.out, "p01", study.protocol, eight_classes.model)
    assert outcome.figures is not None
    assert [(one.kept, one.filmed) for one in outcome.trials] == [
        (2, 1),
        (2, 0),
        (0, 0),
    ]
    whole = outcome.figures.whole
    assert (whole.trials, whole.labelled, whole.recognised) == (4, 0, 0)
    passes = next(one for one in outcome.figures.actions if one.action == "pass")
    assert whole.minutes == passes.minutes > 0.0, "an alarm in a pull may be right"
    page = write_report(study.home, outcome).read_text()
    assert "Trials without a label of their action: 4" in page
    assert outcome.figures.unlabelled == {"no key l, and no camera": 4}
    assert "not finished" in page


def test_a_model_that_does_not_fit_leaves_a_report_that_says_so(two: Study) -> None:
    outcome = outcome_of(
        two.out, "p02", two.protocol, Path("models/holdfast-150hz.onnx")
    )
    assert outcome.figures is None
    assert outcome.no_figures.startswith("RateError: ")
    lines = summary_lines(outcome, two.out)
    assert said(lines, "6 of 6 trials kept")
    assert said(lines, "no figures of a model: RateError")


def test_the_report_of_a_person_can_be_written_again(
    two: Study, eight_classes: Built, run: Run
) -> None:
    before = (two.out / "p02/report.html").read_bytes()
    words = f"--out {two.out} --person p02 --report --model {eight_classes.model}"
    code, out, err = run("study", two.path, *words.split())
    assert code == 0, err
    assert "p02: 6 of 6 trials kept, 0 adverse events" in out
    assert (two.out / "p02/report.html").read_bytes() == before


def test_a_folder_without_a_study_has_no_report(two: Study, tmp_path: Path) -> None:
    (tmp_path / "p09").mkdir()
    with pytest.raises(DataNotFound, match="no study of this person"):
        outcome_of(tmp_path, "p09", two.protocol, two.args.model)
