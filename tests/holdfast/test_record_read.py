"""What training makes of recorded trials, and the page about recording."""

from __future__ import annotations

import json
import re
import shutil

import pytest
from recorder_bench import TRIAL, meta_of

from holdfast.cli.main import main
from holdfast.core.contract import SITUATIONS
from holdfast.core.errors import EmptyRecording, LabelError, TimeError
from holdfast.data.datasets import load

# -- what training makes of it


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


@pytest.mark.filterwarnings("ignore::holdfast.step.spec.BandsLeftOut")
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
        # a gap that may be, but fewer rows than were recorded
        ("tactile.csv", counted("900"), EmptyRecording),
    ],
)
def test_a_recording_that_was_edited_wrongly_is_refused_by_name(
    people, tmp_path, name, text, error
):
    copy = shutil.copytree(people / "p01", tmp_path / "p01")
    (copy / "soft-ball/pull/trial_1" / name).write_text(text)
    with pytest.raises(error, match=re.escape(name)):
        load(copy)


# -- the page
