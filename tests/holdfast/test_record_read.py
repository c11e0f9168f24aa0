"""What training makes of recorded trials, and the page about recording."""

from __future__ import annotations

import json
import re
import shlex
import shutil

import pytest
from recorder_bench import ROOT, TRIAL, meta_of, options_of, truth_of

from holdfast.cli.main import main
from holdfast.core.contract import SITUATIONS
from holdfast.core.errors import EmptyRecording, LabelError, TimeError
from holdfast.sessions.recorder.keys import KEYS
from holdfast.sessions.recorder.protocol import read_protocol
from holdfast.training.datasets import load

# -- what training makes of it


def test_people_are_groups_and_a_single_one_s_trials_are(people):
    both, one = load(people), load(people / "p01", windows="natural")
    assert both.groups() == ["p01", "p02"]
    assert (both.kind, both.unit, both.rate_hz) == ("simulated", "N", 50.0)
    assert len(one.groups()) == 4
    assert "do not apply to other people" in one.caveat
    assert len(both.recordings) == 8


def test_the_truth_of_a_scene_is_the_trial_s_and_only_kept_trials_are_read(
    people, tmp_path
):
    data = load(people, windows="natural")
    pull = next(one for one in data.recordings if one.action == "pull")
    assert (pull.object_name, [phase.situation for phase in pull.phases]) == (
        "soft-ball",
        [0, 1, 3, 0],
    )
    assert pull.events[0].gross_s is not None
    copy = shutil.copytree(people, tmp_path / "trials")
    meta = next(copy.glob("p01/soft-ball/pull/trial_1/meta.json"))
    meta.write_text(json.dumps(meta_of(meta.parent) | {"state": "interrupted"}))
    discarded = copy / "p02/discarded/hard-ball/fall/trial_1-1"
    shutil.move(copy / "p02/hard-ball/fall/trial_1", discarded)
    (discarded / "meta.json").write_text('{"recorder": 1, "state": "redone"}')
    again = load(copy, windows="natural")
    assert len(again.recordings) == 6


@pytest.mark.filterwarnings("ignore::holdfast.export.spec.BandsLeftOut")
def test_what_was_recorded_trains_evaluates_and_replays_as_it_is(
    people, tmp_path, capsys
):
    from holdfast.export.exporting import export_artifact
    from holdfast.training.fitting import train
    from holdfast.training.plan import ForestPlan, TrainingPlan

    few = ForestPlan(n_estimators=4)
    train(
        load(people),
        tmp_path / "model",
        TrainingPlan(situation=few, prediction=few, folds=2),
    )
    model = str(export_artifact(tmp_path / "model")[0])
    path = tmp_path / "figures.json"
    assert main(["evaluate", model, "--data", str(people), "--json", str(path)]) == 0
    figures = json.loads(path.read_text())
    assert (figures["n_groups"], figures["group_kind"]) == (2, "person")
    capsys.readouterr()
    folder = people / TRIAL
    for source in (str(folder), str(folder / "tactile.csv"), f"{people}#0"):
        assert main(["replay", model, source]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert json.loads(lines[-1])["state"] in SITUATIONS
    assert len(lines) > 150


def counted(last: str) -> str:
    """A table of two rows, the second with this in the column of sequence numbers."""
    return f"Time,X1,Y1,Z1,sequence\n0,1,1,1,0\n1,1,1,1,{last}\n"


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("tactile.truth.json", "[1]", LabelError),
        ("tactile.truth.json", '{"phases": [3]}', LabelError),
        ("meta.json", "{", LabelError),
        *[
            ("tactile.csv", counted(last), TimeError)
            for last in ("0", "1e300", "1.5", "nan")
        ],
        # meta.json counts more samples than these two
        ("tactile.csv", counted("90"), EmptyRecording),
    ],
)
def test_a_recording_that_was_edited_wrongly_is_refused_by_name(
    people, tmp_path, name, text, error
):
    copy = shutil.copytree(people / "p01", tmp_path / "p01")
    (copy / "soft-ball/pull/trial_1" / name).write_text(text)
    with pytest.raises(error, match=re.escape(name)):
        load(copy)


@pytest.mark.parametrize(
    "line", ["nonsense", "3", '{"mark": "contact", "provenance": "key"}']
)
def test_events_that_cannot_be_understood_are_refused_by_name(people, tmp_path, line):
    from holdfast.sessions.recorder.labels import relabel

    folder = shutil.copytree(people / TRIAL, tmp_path / "trial_1")
    before = relabel(folder)
    assert before.to_json() == truth_of(people / TRIAL)
    (folder / "events.jsonl").write_text(line + "\n")
    with pytest.raises(LabelError, match=r"events\.jsonl"):
        relabel(folder)


def test_check_reads_the_same_folders_and_names_the_source_of_labels(people, capsys):
    assert main(["check", str(people), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["layout"], report["held_out_by"], report["groups"]) == (
        "recorded",
        "person",
        2,
    )
    pull = next(one for one in report["cells"] if one["action"] == "pull")
    assert (pull["person"], pull["object_name"], pull["unit"]) == (
        "p01",
        "soft-ball",
        "N",
    )
    assert "scene" in next(iter(pull["labels_by"]))


# -- the page


def test_the_page_shows_a_card_that_is_one_every_key_and_commands_that_are_understood(
    tmp_path,
):
    page = (ROOT / "docs/recording-and-study.md").read_text("utf-8")
    (card_text,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "shown.toml").write_text(card_text)
    assert read_protocol(tmp_path / "shown.toml").tasks
    shown = dict(re.findall(r"^\| `(\w+)` \| ([a-z_ ]+)", page, re.M))
    assert set(shown) >= {"space"} | {key for key in KEYS if key.isalpha()}
    commands = re.findall(r"^holdfast record (.*?)(?:\s+#.*)?$", page, re.M)
    assert len(commands) >= 3
    for command in commands:
        options_of(*shlex.split(command))
