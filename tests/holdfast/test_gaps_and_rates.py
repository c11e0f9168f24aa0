"""Lost samples and other rates, in every verb that reads recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_line import Run, fails
from live_bench import DEFAULT
from own_data import rewrite

from holdfast.core.contract import GRASP
from holdfast.core.errors import EmptyRecording
from holdfast.core.source import SelfPacedSource, SourceReading
from holdfast.core.trial_file import block_means
from holdfast.core.trial_layout import truth_path
from holdfast.data.datasets import load
from holdfast.data.fixture import write_fixture
from holdfast.data.recording import whole_history
from holdfast.drivers.replay import AveragedSource
from holdfast.evaluation.alarms import event_scores, match_alarms

if TYPE_CHECKING:
    from conftest import Built

PULL = "soft-ball/pull/trial_1.csv"
GAP_S = 0.2


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A small labelled set at 50 Hz."""
    write_fixture(tmp_path / "set", trials_per_cell=1)
    return tmp_path / "set"


def with_a_gap(path: Path, at_s: float) -> None:
    """The trial without the rows of a span."""

    def cut(table: np.ndarray) -> np.ndarray:
        t_s = table[:, 0] - table[0, 0]
        rows: np.ndarray = table[(t_s < at_s) | (t_s >= at_s + GAP_S)]
        return rows

    rewrite(path, cut)


def onset_s(path: Path) -> float:
    phases = json.loads(truth_path(path).read_text())["phases"]
    return float(next(one["t0_s"] for one in phases if one["label"] == "risky_slip"))


def test_a_gap_is_lost_samples_for_check_training_and_replay(
    run: Run, made: Path, eight_classes: Built
) -> None:
    path = made / PULL
    with_a_gap(path, 4.0)
    code, out, _ = run("check", made)
    assert (code, "1 gap of 0.20 s together, the longest of 0.20 s" in out) == (0, True)
    data = load(made)
    (number,) = [
        k for k, one in enumerate(data.recordings) if f"{one.trial_id}.csv" == PULL
    ]
    whole = whole_history(data.recordings[number])
    assert np.flatnonzero(~whole).tolist() == list(range(200, 210 + 25))
    rows = data.tasks["classes"]
    assert whole[rows.row[rows.trial == number]].all()
    code, out, _ = run("replay", eight_classes.model, path)
    answers = [json.loads(line) for line in out.splitlines()]
    assert len(answers) == len(whole) - 10
    why = {one["t_acquired_ns"] // 10**7: one["why"] for one in answers}
    assert (why[398], why[420], why[440], why[480]) == ("", "settling", "settling", "")


def test_an_event_that_begins_in_a_gap_counts_as_missed_and_the_report_says_so(
    run: Run, made: Path, eight_classes: Built
) -> None:
    path = made / PULL
    with_a_gap(path, onset_s(path) - 0.4)
    data = load(made, windows="none")
    recordings = {f"{one.trial_id}.csv": one for one in data.recordings}
    (event,) = recordings[PULL].events
    assert event.lost
    always = np.arange(len(recordings[PULL].samples)) / 50.0 >= event.onset_s
    scores = event_scores([match_alarms(recordings[PULL], always)])
    assert (scores.events, scores.found, scores.missed) == (1, 0, 1)
    events = sum(len(one.events) for one in data.recordings)
    said = f"1 of {events} risky events begin while samples are lost"
    assert said in run("evaluate", eight_classes.model, "--data", made)[1]


def test_a_trial_is_refused_where_nothing_is_left(run: Run, made: Path) -> None:
    def every_tenth(table: np.ndarray) -> np.ndarray:
        kept: np.ndarray = table[np.arange(len(table)) % 20 < 10]
        return kept

    rewrite(made / PULL, every_tenth)
    with pytest.raises(EmptyRecording, match=r"no 0\.5 s without lost samples"):
        load(made)
    assert "nothing is left" in run("check", made)[1]


def faster(path: Path, times: int) -> None:
    """Every row so many times, in the same time."""

    def repeated(table: np.ndarray) -> np.ndarray:
        rows = np.repeat(table, times, axis=0)
        rows[:, 0] = np.arange(len(rows)) / (50.0 * times)
        return rows

    rewrite(path, repeated)


@pytest.mark.parametrize("times", [2, 7])
def test_a_recording_at_a_multiple_of_the_rate_is_averaged_down_to_it(
    run: Run, made: Path, eight_classes: Built, times: int
) -> None:
    path = made / PULL
    _, before, _ = run("replay", eight_classes.model, path)
    faster(path, times)
    code, out, err = run("replay", eight_classes.model, path)
    assert code == 0
    said = f"{50 * times} Hz averaged down to 50 Hz, means of {times} samples"
    assert said in err
    states = [
        [json.loads(line)["state"] for line in of.splitlines()] for of in (out, before)
    ]
    assert states[0] == states[1]
    for other in made.rglob("*trial_1.csv"):
        if other != path:
            faster(other, times)
    code, out, _ = run("evaluate", eight_classes.model, "--data", made)
    assert code == 0
    assert said in out


def test_another_rate_is_refused_with_the_file_that_fits_or_how_to_train_one(
    run: Run, made: Path
) -> None:
    faster(made / PULL, 4)
    fails(run, 3, "RateError", "replay", DEFAULT, made / PULL, says="use holdfast-50hz")
    rewrite(made / PULL, lambda table: table * ([200 / 70] + [1] * 18))
    fails(run, 3, "RateError", "replay", DEFAULT, made / PULL, says="--rate 70")


def test_a_model_learns_at_the_rate_that_is_asked_for(
    run: Run, made: Path, tmp_path: Path
) -> None:
    for path in made.rglob("*trial_1.csv"):
        faster(path, 3)
    words = ("--data", made, "--learner", "forest", "--size", "tiny", "--out")
    code, out, _ = run("train", *words, tmp_path / "model", "--rate", 50)
    assert code == 0
    assert "recordings at 50 Hz" in out
    assert "averaged down to 50 Hz" in out
    fails(run, 3, "RateError", "train", *words, tmp_path / "no", "--rate", 60)


class Counting(SelfPacedSource):
    """Readings 0, 1, 2, .. of one sensor at 300 Hz; every fourth is lost."""

    unit, n_channels, rate_hz = "N", 3, 300.0

    def __init__(self) -> None:
        self.k = -1

    def read(self) -> SourceReading | None:
        self.k += 1
        if self.k == 12:
            return None
        valid = np.array([self.k % 4 != 3])
        return SourceReading(self.k, np.full(3, float(self.k)), valid)

    def close(self) -> None:
        self.k = 12


def test_a_live_source_is_averaged_as_a_recording_is() -> None:
    source = AveragedSource(Counting(), 3)  # type: ignore[arg-type]
    assert source.rate_hz == 100.0
    readings = [source.read() for _ in range(5)]
    values = np.repeat(np.arange(12.0)[:, None], 3, axis=1)
    rows = np.arange(12)
    times, means, valid = block_means(rows, values, rows[:, None] % 4 != 3, 3)
    assert readings[4] is None
    live = [one for one in readings if one is not None]
    assert [one.t_ns for one in live] == times.tolist() == [2, 5, 8, 11]
    assert np.array_equal(np.stack([one.values for one in live]), means)
    assert np.array_equal(np.stack([one.valid for one in live]), valid)
    assert means[:, 0].tolist() == [1.0, 4.5, 7.0, 9.5]


def test_a_pull_that_ends_before_the_script_acts_is_labelled_by_its_folder(
    made: Path,
) -> None:
    path = made / PULL
    truth_path(path).unlink()
    rewrite(path, lambda table: table[table[:, 0] < table[0, 0] + 6.5])
    found = {f"{one.trial_id}.csv": one for one in load(made).recordings}[PULL]
    assert GRASP not in {phase.situation for phase in found.phases}
    assert [one.timed for one in found.events] == [False]
