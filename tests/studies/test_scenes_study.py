"""The study of simulated scenes: what its figures mean, what no model was trained on, and its
page."""

from __future__ import annotations

import argparse
import html
import json
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from holdfast.core.contract import (
    CLASSES,
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    FloatArray,
)
from holdfast.core.errors import DataNotFound, RateError, UnitError
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.baseline_signals import (
    BACK_SAMPLES,
    JUMP_N,
    clock_features,
    raw_windows,
    shear_rate_at,
    shear_rate_fires,
)
from holdfast.evaluation.style import FINGER_COLOURS, FINGER_LINES, SITUATION_COLOURS
from holdfast.evaluation.window_scores import (
    CEILING,
    ClassScores,
    answers_at,
    calls,
    leak_check,
    scores,
    spread_of,
)
from holdfast.export.network import IntArray
from holdfast.export.spec import window_samples
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.crossval import HeldOut
from holdfast.training.featurise import features_of, spec_for
from holdfast.training.plan import (
    CLOCK_PLAN,
    RAW_BASELINE,
    RAW_GROUPS,
    ForestPlan,
    TrainingPlan,
)
from holdfast.training.recording import DataSet, LabelledRows, Recording
from studies.__main__ import PROGRAMS
from studies.row_names import OURS, RAW
from studies.scenes import pictures
from studies.scenes import program as command
from studies.scenes.figures import MadeBy, scores_of
from studies.scenes.held_out import (
    SLIP_OF,
    first_slips,
    held_out_streams,
)
from studies.scenes.report import SceneEvidence, demo_report, write_scene_report
from studies.scenes.study import (
    Candidate,
    RateStudy,
    evaluated_on_others,
    learning_curve,
    objects_held_out,
    read_trained,
    study_rate,
    styles_left_out,
    ways,
)
from tools.doc_tables import write_between
from tools.harness import start

FEW = ForestPlan(n_estimators=10, min_samples_leaf=8, max_features=0.3)
SHARP = ForestPlan(n_estimators=10)
SMALL = ways(
    plan=TrainingPlan(folds=2, situation=FEW),
    raw=replace(RAW_BASELINE, folds=2, situation=FEW),
    clock=replace(CLOCK_PLAN, folds=2, situation=FEW),
)


@dataclass(frozen=True)
class Studied:
    """One rate's study, and every message on the way."""

    rate: RateStudy
    messages: list[str]


@dataclass(frozen=True)
class Commanded:
    """What the whole command left."""

    out: Path
    figures: dict[str, Any]
    page: str


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixty trials of the thesis and twelve of an apple at 50 Hz, without other styles. Read
    only."""
    made = tmp_path_factory.mktemp("scenes")
    for name, trials in (("thesis", 60), ("apple", 12)):
        card = replace(read_scene_file(name, rate_hz=50.0), step_s=0.01)
        write_set(Scene(card, 0), made / "50hz" / name, trials)
    return made


@pytest.fixture(scope="module")
def data(folder: Path) -> DataSet:
    return read_trained(folder / "50hz", 0)


@pytest.fixture(scope="module")
def studied(folder: Path) -> Studied:
    messages: list[str] = []
    return Studied(study_rate(folder / "50hz", SMALL, 0, messages.append), messages)


@pytest.fixture(scope="module")
def commanded(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Commanded:
    """The command as typed, with the small plans in the place of the usual ones."""
    out = tmp_path_factory.mktemp("out")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(command, "ways", lambda: SMALL)
        words = ["scenes", "--sets", str(folder), "--out", str(out)]
        assert start("studies", PROGRAMS, words) == 0
    text = (out / "scenes.json").read_text(encoding="utf-8")
    figures = json.loads(
        text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON")
    )
    return Commanded(out, figures, (out / "report.html").read_text(encoding="utf-8"))


def one_hot(answer: npt.NDArray[np.integer[Any]]) -> IntArray:
    return 100 * np.eye(len(CLASSES), dtype=np.int64)[answer]


def of_rows(data: DataSet, label: npt.NDArray[np.int64]) -> DataSet:
    """The same windows with other labels."""
    return replace(data, tasks={"classes": replace(data.tasks["classes"], label=label)})


def a_set(samples: FloatArray, rows: list[int], rate_hz: float = 100.0) -> DataSet:
    """One recording with windows that end at these rows, on everything else that the fixture's sets
    have."""
    task = LabelledRows(
        np.zeros(len(rows), np.int64),
        np.array(rows),
        np.zeros(len(rows), np.int64),
        CLASSES,
    )
    trial = Recording(
        "a/pull/trial_1",
        "a",
        samples,
        np.ones((len(samples), 1), dtype=bool),
        rate_hz,
        "N",
    )
    preparation: Any = None
    return DataSet(
        "made",
        [trial],
        {"classes": task},
        rate_hz,
        "N",
        preparation,
        "made up",
        True,
        "",
    )


def shear(*summed_n: float) -> FloatArray:
    """[T, 6]: two sensors whose summed shear is as given, one along -x and the other along y;
    normals wander."""
    samples = np.zeros((len(summed_n), 6))
    samples[:, 0], samples[:, 4] = -np.array(summed_n) / 2, np.array(summed_n) / 2
    samples[:, 2] = 3.0 * np.arange(len(summed_n))
    return samples


# Levels


@pytest.mark.parametrize(
    ("votes", "eight", "seven", "four"),
    [
        ([3, 3, 5, 0, 0, 0, 0, 0], 2, 0, NOTHING),
        ([0, 0, 4, 3, 0, 0, 0, 6], 7, 6, GRASP),
        ([1, 0, 0, 0, 4, 4, 5, 2], 6, 5, SAFE_SLIP),
        # ties go to the riskier class
        ([5, 0, 0, 0, 5, 0, 0, 0], 4, 3, SAFE_SLIP),
        ([0, 0, 0, 0, 3, 2, 1, 4], 7, 6, RISKY_SLIP),
    ],
)
def test_votes_of_merged_classes_are_added_before_the_largest_wins(
    votes: list[int], eight: int, seven: int, four: int
) -> None:
    answers = [
        answers_at(np.array([votes]), level) for level in ("eight", "seven", "four")
    ]
    assert answers == [eight, seven, four]


def test_votes_that_know_everything_score_one_and_of_the_wrong_weight_only_situations_are_right(
    data: DataSet,
) -> None:
    label = data.tasks["classes"].label
    right, wrong_weight = scores(data, one_hot(label)), scores(data, one_hot(label ^ 1))
    levels = (right.eight, right.seven, right.four)
    assert [level.accuracy for level in levels] == [1.0, 1.0, 1.0]
    assert [level.present for level in levels] == [8, 7, 4]
    levels = (wrong_weight.eight, wrong_weight.seven, wrong_weight.four)
    assert [level.accuracy for level in levels] == [0.0, 0.25, 1.0]
    assert (right.n_windows, right.n_trials) == (
        len(label),
        len(set(data.group_of("classes"))),
    )


def test_calls_are_the_share_of_each_situation_that_is_called_risky(
    data: DataSet,
) -> None:
    situation = data.tasks["classes"].label // 2
    called = (situation == RISKY_SLIP) | (situation == SAFE_SLIP)
    safe = np.flatnonzero(situation == SAFE_SLIP)
    called[safe[::4]] = False
    shares = calls(data, called)
    assert shares.risky.share == 1.0
    assert shares.safe.share == pytest.approx(1.0 - len(safe[::4]) / len(safe))
    assert shares.grasp.share == shares.nothing.share == 0.0


# The leak of a weight that nothing shows


def test_votes_that_know_the_weight_within_nothing_are_called_a_leak(
    data: DataSet,
) -> None:
    label = data.tasks["classes"].label
    leaks = leak_check(data, one_hot(label))
    assert leaks.leak
    assert leaks.eight_class_accuracy == leaks.weight_within_nothing == 1.0


def test_the_weight_within_nothing_is_a_leak_however_bad_the_rest_is(
    data: DataSet,
) -> None:
    label = data.tasks["classes"].label
    bad = leak_check(data, one_hot(np.where(label < 2, label, (label + 2) % 8)))
    assert bad.leak
    assert bad.eight_class_accuracy == 0.25
    outvoted = one_hot(np.where(label < 2, 5, label))
    # the answer is safe slip, and yet the votes know the weight
    outvoted[label < 2, label[label < 2]] = 1
    assert leak_check(data, outvoted).leak


def test_honest_coin_votes_are_no_leak_though_they_know_all_that_can_be_known(
    data: DataSet,
) -> None:
    label = data.tasks["classes"].label
    coin = np.random.default_rng(0).integers(0, 2, len(label))
    leaks = leak_check(data, one_hot(np.where(label < 2, coin, label)))
    assert not leaks.leak
    assert leaks.balanced
    low, high = leaks.weight_within_nothing_ci99 or (1.0, 0.0)
    assert low < 0.5 < high
    low, high = leaks.eight_class_accuracy_ci99 or (1.0, 0.0)
    assert low < CEILING < high


# What stands beside ours


def test_a_window_stepped_alone_has_the_features_of_the_stream(data: DataSet) -> None:
    assert all(recording.valid.all() for recording in data.recordings)
    streamed = features_of(data, spec_for(data, RAW_GROUPS))["classes"]
    np.testing.assert_array_equal(raw_windows(data), streamed)


def test_a_window_alone_sees_its_first_row_and_nothing_before_it(data: DataSet) -> None:
    n = window_samples(data.rate_hz)
    one = replace(data, tasks={"classes": data.tasks["classes"].take(np.array([40]))})
    task = one.tasks["classes"]
    trial, first = int(task.trial[0]), int(task.row[0]) + 1 - n

    def with_raised(rows: slice) -> DataSet:
        recordings = list(one.recordings)
        samples = recordings[trial].samples.copy()
        samples[rows] += 7.0
        recordings[trial] = replace(recordings[trial], samples=samples)
        return replace(one, recordings=recordings)

    assert first > 0
    np.testing.assert_array_equal(
        raw_windows(with_raised(slice(0, first))), raw_windows(one)
    )
    np.testing.assert_array_equal(
        raw_windows(with_raised(slice(first + n, None))), raw_windows(one)
    )
    assert (raw_windows(with_raised(slice(first, first + 1))) != raw_windows(one)).any()


def test_the_shear_rate_threshold_finds_a_jump_over_half_a_newton_within_two_samples() -> (
    None
):
    assert (BACK_SAMPLES, JUMP_N) == (2, 0.5)
    up = shear_rate_fires(shear(1.0, 1.0, 1.0, 1.75, 1.75, 1.75, 1.75))
    assert up.tolist() == [False, False, False, True, True, False, False]
    down_in_two_steps = shear_rate_fires(shear(2.0, 2.0, 2.0, 1.625, 1.25, 1.25, 1.25))
    assert down_in_two_steps.tolist() == [
        False,
        False,
        False,
        False,
        True,
        False,
        False,
    ]


def test_the_shear_rate_threshold_is_silent_at_half_a_newton_on_a_slow_ramp_and_about_normals() -> (
    None
):
    assert not shear_rate_fires(shear(1.0, 1.0, 1.5, 1.5, 1.5)).any()
    assert not shear_rate_fires(shear(*(0.25 * np.arange(40)))).any()
    assert shear_rate_fires(shear(*(0.2578125 * np.arange(40))))[2:].all()


def test_the_shear_rate_threshold_is_causal(data: DataSet) -> None:
    samples = max(
        (recording.samples for recording in data.recordings),
        key=lambda one: shear_rate_fires(one).sum(),
    )
    messages = shear_rate_fires(samples)
    assert messages.any()
    for row in (2, len(samples) // 2, len(samples) - 1):
        changed = samples.copy()
        changed[row:] += 50.0 * np.random.default_rng(row).standard_normal(
            changed[row:].shape
        )
        np.testing.assert_array_equal(shear_rate_fires(changed)[:row], messages[:row])
        assert shear_rate_fires(changed)[row]


def test_the_shear_rate_threshold_is_read_at_a_windows_last_sample_or_anywhere_in_its_reach() -> (
    None
):
    # says slip at rows 3 and 4
    made = a_set(shear(0, 0, 0, 1, 1, 1, 1, 1, 1, 1), [2, 3, 4, 5, 6, 7])
    assert shear_rate_at(made).tolist() == [False, True, True, False, False, False]
    assert shear_rate_at(made, 3).tolist() == [False, True, True, True, True, False]
    assert shear_rate_at(made, 100).tolist() == [False, True, True, True, True, True]


def test_the_clock_tells_seconds_since_the_last_contact_and_the_summed_force() -> None:
    samples = np.zeros((60, 6))
    samples[10:30, [2, 5]] = 1.5, 0.5
    samples[40:, [2, 5]] = 2.0, 2.0
    samples[:, [0, 1, 3, 4]] = 9.0  # shear is no contact
    made = a_set(samples, [5, 10, 25, 35, 40, 50], rate_hz=100.0)
    expected = [
        [-0.01, 0.0],
        [0.0, 2.0],
        [0.15, 2.0],
        [0.25, 0.0],
        [0.0, 4.0],
        [0.10, 4.0],
    ]
    np.testing.assert_allclose(clock_features(made), expected, rtol=1e-6)


# Never met


def test_no_window_of_a_held_out_object_is_trained_on(data: DataSet) -> None:
    """Labels that only say which object it is cannot be learned from other objects; with a leak
    they would be."""
    names = np.array([recording.object_name or "" for recording in data.recordings])[
        data.tasks["classes"].trial
    ]
    objects = sorted(set(names.tolist()) - {""})
    number = np.unique(names, return_inverse=True)[1].astype(np.int64)
    features = np.eye(len(CLASSES), dtype=np.float32)[number]
    way = Candidate(TrainingPlan(situation=SHARP), lambda data: features)
    figures = objects_held_out(of_rows(data, number), features, way, 0)
    assert sorted(figures) == objects
    assert len(objects) == 5
    for name, one in figures.items():
        assert one.n_windows == (names == name).sum()
        assert one.eight.accuracy == 0.0
    everything = way.votes(
        of_rows(data, number), features, np.arange(len(number)), features, 0
    )
    np.testing.assert_array_equal(answers_at(everything, "eight"), number)


def halves(data: DataSet) -> dict[str, DataSet]:
    """The trials dealt to two styles, each named after its own."""
    names = sorted(one.trial_id for one in data.recordings)
    parts = {
        "even": data.of_groups(frozenset(names[::2])),
        "odd": data.of_groups(frozenset(names[1::2])),
    }
    return {style: replace(part, name=style) for style, part in parts.items()}


def test_no_trial_of_a_style_that_is_left_out_is_trained_on(data: DataSet) -> None:
    sets, fitted = halves(data), []

    class Watched(Candidate):
        def votes(self, data: DataSet, *rest: Any) -> IntArray:
            fitted.append({one.trial_id for one in data.recordings})
            return super().votes(data, *rest)

    ours = SMALL[OURS]
    left_out = styles_left_out(
        sets, {OURS: Watched(ours.plan, ours.features)}, 0, lambda line: None
    )
    for met, (style, figures) in zip(fitted, left_out.items(), strict=True):
        other = sets["odd" if style == "even" else "even"]
        assert met == {one.trial_id for one in other.recordings}
        assert figures.trained_on_trials == len(met)
        assert figures.rows[OURS].n_windows == len(sets[style].tasks["classes"])


def test_a_learning_curve_asks_for_no_more_trials_than_there_are(data: DataSet) -> None:
    features = {
        OURS: features_of(data, spec_for(data, SMALL[OURS].plan.groups))["classes"]
    }
    few, all_of_them = learning_curve(
        data, features, {OURS: SMALL[OURS]}, 0, (30, 60, 1000)
    )
    assert (few.trials, all_of_them.trials) == (30, 60)
    assert few.windows < all_of_them.windows == len(data.tasks["classes"])
    assert (all_of_them.rows[OURS].eight.macro_f1 or 0.0) > 0.3


def test_trials_of_the_streams_are_met_by_no_forest_that_answers_them(
    folder: Path, data: DataSet
) -> None:
    """Risky slip exists in the shown trials only: a forest that met none of them cannot say it."""
    drawn, task = first_slips(data), data.tasks["classes"]
    assert [data.recordings[k].action for k in drawn] == list(SLIP_OF)
    theirs = np.isin(task.trial, drawn)
    risky = task.label // 2 == RISKY_SLIP
    made = of_rows(data, np.where(risky & ~theirs, 4, task.label))
    plan = TrainingPlan(situation=SHARP)
    features = SMALL[OURS].features(made)
    pictures = held_out_streams(folder / "50hz" / "thesis", made, features, plan, 0)
    assert len(pictures) == 3
    assert not any((picture.answer == RISKY_SLIP).any() for picture in pictures)
    honest = held_out_streams(folder / "50hz" / "thesis", data, features, plan, 0)
    assert any((picture.answer == RISKY_SLIP).any() for picture in honest)


def test_streams_answer_every_sample_after_settling_and_bear_the_truth(
    studied: Studied,
) -> None:
    for picture in studied.rate.streams:
        length = len(picture.recording.samples)
        assert len(picture.answer) == len(picture.acts) == length
        assert (picture.answer[:25] == UNKNOWN).all()
        assert (picture.answer[25:] != UNKNOWN).all()
        assert (picture.phases[0].first, picture.phases[-1].stop) == (0, length)
        assert all(0.0 < at_s < length / 50.0 for at_s in picture.events.values())


def test_a_set_of_another_rate_is_refused(folder: Path, data: DataSet) -> None:
    faster = replace(data, rate_hz=100.0)
    with pytest.raises(RateError, match="at 50 Hz"):
        evaluated_on_others(folder / "50hz", faster, {}, {}, 0, lambda line: None)


def test_a_thesis_in_another_unit_is_refused(folder: Path, tmp_path: Path) -> None:
    copied = shutil.copytree(folder / "50hz" / "thesis", tmp_path / "50hz" / "thesis")
    meta = json.loads((copied / "meta.json").read_text())
    (copied / "meta.json").write_text(json.dumps(meta | {"unit": "uT"}))
    with pytest.raises(UnitError):
        read_trained(tmp_path / "50hz", 0)


# Retrainings


def test_the_first_retraining_is_the_one_of_the_table(studied: Studied) -> None:
    for name in (OURS, RAW):
        first = np.array(studied.rate.figures.retrainings[name].confusion[0])
        row = studied.rate.figures.rows[name]
        assert isinstance(row, ClassScores)
        accuracy = row.eight.accuracy
        assert np.trace(first) / first.sum() == pytest.approx(accuracy)


def test_the_spread_is_the_largest_recall_minus_the_smallest_of_each_class_there_is() -> (
    None
):
    one = np.diag([10, 10, 8, 4, 4, 4, 4, 0])
    other = one.copy()
    other[2, 2], other[2, 3] = 6, 2
    other[0, 0], other[0, 1] = 9, 1
    spreads = spread_of([one, other])
    assert spreads.recall["grasp_light"] == [1.0, 0.75]
    assert spreads.spread["grasp_light"] == spreads.largest_spread == 0.25
    assert spreads.spread["nothing_light"] == pytest.approx(0.1)
    assert spreads.spread["grasp_heavy"] == 0.0
    assert (
        spreads.spread["risky_slip_heavy"] is spreads.recall["risky_slip_heavy"] is None
    )
    assert not spreads.within_10_percent
    other[2, 2], other[2, 3] = 8, 0
    assert spread_of([one, other]).within_10_percent


# The command and its page


def test_the_command_leaves_json_that_says_it_is_simulated_and_with_what_it_was_made(
    commanded: Commanded,
) -> None:
    figures = commanded.figures
    assert figures["kind"] == "simulated"
    assert figures["headline_hz"] == "50"
    assert figures["caveat"].startswith("Simulated")
    assert figures["leak"] is False
    assert figures["rates"]["50"]["window_samples"] == 6
    assert figures["versions"]


def test_the_command_and_the_study_in_it_give_the_same_figures(
    commanded: Commanded, studied: Studied
) -> None:
    assert commanded.figures["rates"]["50"] == json.loads(
        json.dumps(studied.rate.figures.to_json())
    )


def test_the_page_says_simulated_beside_its_tables_and_its_pictures(
    commanded: Commanded,
) -> None:
    heads = re.findall(r"<table class=\"\">\s*<tr>(.*?)<tr", commanded.page, re.DOTALL)
    assert len(heads) == 3
    assert all("simulated" in head for head in heads)
    titles = re.findall(r"<h2>.*?</h2>", commanded.page)
    # advice shows no figure
    titles.remove("<h2>What to do next</h2>")
    assert all("(simulated)" in title for title in titles)
    for before, picture in re.findall(
        r"(.{0,120})(<svg.*?</svg>)", commanded.page, re.DOTALL
    ):
        assert "simulated" in before + picture
    assert commanded.figures["caveat"] in html.unescape(commanded.page)


def test_the_page_loads_nothing_else_and_shows_the_figures_of_the_json(
    commanded: Commanded,
) -> None:
    assert (
        re.findall(r"""(?:src|href)=["']?(?!#|data:)[^"'#> ]+""", commanded.page) == []
    )
    best = commanded.figures["rates"]["50"]["rows"][OURS]
    for figure in (
        best["four"]["macro_f1"],
        best["seven"]["accuracy"],
        best["calls"]["risky"]["share"],
    ):
        assert f"<b>{figure:.3f}</b>" in commanded.page


def test_a_second_rate_has_a_section_and_a_leak_stands_on_top(
    studied: Studied, tmp_path: Path
) -> None:
    quiet = studied.rate.figures
    assert quiet.leak is not None
    leaking = replace(quiet, leak=replace(quiet.leak, leak=True), rate_hz=100.0)
    figures = command.gathered([studied.rate, replace(studied.rate, figures=leaking)])
    assert (figures.leak, figures.headline_hz) == (True, "100")
    lines = command.leak_lines(figures)
    assert len(lines) == 1
    assert lines[0].startswith("LEAK at 100 Hz")
    rate = studied.rate
    page = write_scene_report(
        tmp_path / "r.html",
        SceneEvidence(figures, MadeBy(), rate.data, rate.held_out, []),
    ).read_text()
    assert "<h2>LEAK: the weight is known where no signal carries it" in page
    assert '<h2>Rates <em class="note">(simulated)</em></h2>' in page
    assert "<h3>" not in page


def test_the_demo_makes_the_same_page_from_one_set_and_leaves_out_what_is_not_there(
    studied: Studied, tmp_path: Path
) -> None:
    rate = studied.rate
    demo = replace(rate.data, kind="made <up>")
    held_out = HeldOut({"classes": rate.held_out.votes["classes"]})
    page = demo_report(
        tmp_path / "demo.html", demo, held_out, MadeBy(), rate.streams[:1]
    ).read_text()
    ours = rate.figures.rows[OURS]
    assert isinstance(ours, ClassScores)
    assert f"<b>{ours.four.macro_f1:.3f}</b>" in page
    assert "Confusion of classes" in page
    assert "Unseen objects" not in page
    assert "made &lt;up&gt;" in page
    assert "<up>" not in page
    assert page.count("<svg") == 4


def studied_in(sets: Path, out: Path) -> None:
    command.run(argparse.Namespace(sets=sets, out=out, seed=0))


def test_a_missing_thesis_says_which_command_makes_it(tmp_path: Path) -> None:
    (tmp_path / "50hz" / "apple").mkdir(parents=True)
    with pytest.raises(DataNotFound) as caught:
        studied_in(tmp_path, tmp_path / "out")
    thesis = tmp_path / "50hz" / "thesis"
    assert (
        caught.value.next_step == f"holdfast simulate thesis --rate 50 --out {thesis}"
    )


def test_a_folder_without_rates_says_which_command_makes_one(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "out").mkdir()
    for place in (tmp_path / "empty", tmp_path / "nowhere"):
        with pytest.raises(DataNotFound) as caught:
            studied_in(place, tmp_path / "out")
        assert (
            caught.value.next_step
            == f"holdfast simulate thesis --rate 150 --out {place / '150hz' / 'thesis'}"
        )


def test_rates_are_studied_slowest_first_by_number(tmp_path: Path) -> None:
    for name in ("150hz", "50hz", "62.5hz", "study", "hz", "50hz.old"):
        (tmp_path / name).mkdir()
    assert [path.name for path in command.rate_folders(tmp_path)] == [
        "50hz",
        "62.5hz",
        "150hz",
    ]


# Colours, and pages that stand between markers


def test_every_finger_has_its_own_colour_and_none_has_that_of_a_situation() -> None:
    assert not set(FINGER_COLOURS) & set(SITUATION_COLOURS)
    assert len(set(FINGER_COLOURS)) == len(FINGER_LINES) == 6


def test_only_what_stands_between_the_markers_is_replaced(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    kept = "<!-- other: by x -->\nkeep\n<!-- /other -->\nafter\n"
    page.write_text(
        f"before\n<!-- real: by make real -->\nstale\nlines\n<!-- /real -->\n{kept}",
        encoding="utf-8",
    )
    fresh = "µT \\1 \\g<0> 10 %\n"
    for _ in range(2):
        write_between(page, "real", fresh)
        text = page.read_text(encoding="utf-8")
        assert (
            text
            == f"before\n<!-- real: by make real -->\n{fresh}<!-- /real -->\n{kept}"
        )


def test_a_page_without_its_markers_is_refused_and_left_as_it_is(
    tmp_path: Path,
) -> None:
    page = tmp_path / "page.md"
    for text in (
        "nothing here\n",
        "<!-- real: by make -->\nno end\n",
        "no start\n<!-- /real -->\n",
    ):
        page.write_text(text)
        with pytest.raises(DataNotFound, match="no markers <!-- real: -->"):
            write_between(page, "real", "fresh\n")
        assert page.read_text() == text


def test_an_object_of_one_trial_alone_has_no_interval_and_is_drawn_all_the_same(
    studied: Studied,
) -> None:
    rate = studied.rate.figures
    scores = scores_of(rate.rows, OURS)
    alone = replace(scores, four=replace(scores.four, macro_f1=0.5, macro_f1_ci=None))
    assert "<svg" in pictures.objects_left_out({"ours": {"a": alone}}, "simulated")
    apple = replace(rate.others["apple"], rows={"ours": alone})
    one = replace(rate, rows={"ours": alone}, others={"apple": apple})
    assert "<svg" in pictures.rates({"50": one, "100": one}, "simulated")
