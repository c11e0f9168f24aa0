"""The whole main job on real recordings, in small: few people, few trees; the taxels that it
takes, and the timing-only baseline."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_tables import filled

from holdfast.data.datasets import human_slip_uskin, load
from holdfast.data.recording import DataSet
from holdfast.evaluation.formats import host
from holdfast.evaluation.jobs import Workers
from holdfast.evaluation.model_outputs import WindowFigures
from holdfast.export.verify import ExportReport
from holdfast.training.crossval import (
    FloatRows,
    HeldOut,
    answer_fold,
    cross_validate,
    features_of,
    spec_for,
    splits_of,
)
from holdfast.training.fitting import versions
from holdfast.training.judging import held_out_figures
from holdfast.training.plan import ForestPlan, TrainingPlan
from studies.folds import leaky_folds
from studies.real import methods
from studies.real.clock import clock_features
from studies.real.figures import FinalModel, RealStudy, StreamedFold
from studies.real.methods import CLOCK_PLAN, Method, cross_validated
from studies.real.report import Evidence, write_real_report
from studies.real.streamed_fold import stream_one_fold
from studies.real.study import leaky
from studies.row_names import CLOCK, OURS_18

pytestmark = pytest.mark.filterwarnings("ignore::holdfast.step.spec.BandsLeftOut")
FEW = ForestPlan(kind="extra", n_estimators=8, min_samples_leaf=10)
PLAN = TrainingPlan(situation=FEW, prediction=FEW, folds=3)
Small = tuple[DataSet, dict[str, FloatRows], HeldOut]


@pytest.fixture(scope="module")
def few_people(
    real_set: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Path]:
    """The set as if it had its first three people alone; by its name it is found there."""
    whole = real_set("human_slip_uskin").resolve()
    folder = tmp_path_factory.mktemp("data") / whole.name
    folder.mkdir()
    (folder / "signals.npz").symlink_to(whole / "signals.npz")
    head, *rows = (whole / "trials.csv").read_text("utf-8").splitlines()
    theirs = [row for row in rows if row[:2] in ("1,", "2,", "3,")]
    (folder / "trials.csv").write_text("\n".join([head, *theirs]), "utf-8")
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("HOLDFAST_DATA", str(folder.parent))
        yield folder
    methods._data.cache_clear()
    methods._features.cache_clear()


@pytest.fixture(scope="module")
def six(few_people: Path) -> DataSet:
    return load(few_people)


@pytest.fixture(scope="module")
def whole(six: DataSet) -> DataSet:
    """All taxels, as the methods keep them."""
    return Method(CLOCK_PLAN, channels=48).data()


@pytest.fixture(scope="module")
def small(six: DataSet) -> Small:
    features = features_of(six, spec_for(six, PLAN.groups))
    folds = [
        answer_fold(six, features, PLAN, split, 0) for split in splits_of(six, PLAN, 0)
    ]
    return six, features, HeldOut.of(six, folds)


def test_every_window_is_answered_by_a_forest_that_never_saw_its_person(
    small: Small,
) -> None:
    """Labels that only say who it is cannot be learned from other people."""
    data, features, _ = small
    people = np.unique(data.group_of("situations"), return_inverse=True)[1]
    rows = data.tasks["situations"]
    tasks = {"situations": replace(rows, label=people)}
    named = replace(data, tasks=tasks)
    two = replace(PLAN, situation=replace(FEW, n_estimators=2))
    given = {"situations": features["situations"]}
    votes = cross_validate(named, given, two).votes["situations"]
    assert not votes[np.arange(len(votes)), people].any()


@pytest.mark.usefixtures("whole")
def test_methods_side_by_side_answer_as_each_would_alone() -> None:
    tiny = ForestPlan(n_estimators=2, max_depth=2)
    timed = replace(CLOCK_PLAN, situation=tiny, prediction=tiny, folds=3)
    both = {
        "three": Method(timed, channels=48),
        "two": Method(replace(timed, folds=2), channels=48),
    }
    said: list[str] = []
    rows = cross_validated(both, 0, Workers(), said.append)
    assert said == [
        *(f"three, fold {fold} of 3" for fold in (1, 2, 3)),
        *(f"two, fold {fold} of 2" for fold in (1, 2)),
    ]
    for name, method in both.items():
        alone = cross_validate(method.data(), method.features(), method.plan)
        for task, votes in alone.votes.items():
            np.testing.assert_array_equal(rows[name].held_out.votes[task], votes)
        assert rows[name].figures == held_out_figures(method.data(), alone)


def test_the_sealed_file_streamed_sample_by_sample_gives_the_tables_labels(
    small: Small, tmp_path: Path
) -> None:
    data, features, held_out = small
    streamed = stream_one_fold(data, features, PLAN, held_out, tmp_path, 0)
    assert streamed.label_mismatches == 0
    heads = streamed.verification.heads.values()
    assert sum(head.label_mismatches + head.vote_mismatches for head in heads) == 0
    assert (
        streamed.windows.trained_on_recordings == streamed.windows.unknown_windows == 0
    )
    assert streamed.rows > 1000


def test_a_leaky_split_flatters(small: Small) -> None:
    data, _, _ = small
    plan = TrainingPlan(groups=("window",), situation=FEW, prediction=FEW, folds=3)
    features = features_of(data, spec_for(data, plan.groups))
    honest = held_out_figures(data, cross_validate(data, features, plan))
    wrong = leaky(data, plan)
    assert (wrong.situations.macro_f1 or 0.0) > (honest.situations.macro_f1 or 1.0)
    assert wrong.predict_250ms is not None
    assert honest.predict_250ms is not None
    assert (wrong.predict_250ms.auc or 0.0) > (honest.predict_250ms.auc or 1.0)


@pytest.fixture(scope="module")
def evidence(small: Small) -> Evidence:
    data, _, held_out = small
    heads = held_out_figures(data, held_out)
    checked = ExportReport(0, {}, 0, 0, 0, bytes=1)
    windows = WindowFigures(heads, "model", data.name, data.kind, 0, 0, data.caveat, 0)
    figures = RealStudy(
        heads=heads,
        data=data.name,
        kind=data.kind,
        channels=18,
        clock_free="nothing old",
        caveat=data.caveat,
        streamed_fold=StreamedFold(checked, windows, rows=1, label_mismatches=0),
        rows={OURS_18: heads, CLOCK: heads},
        model=FinalModel("human/holdfast.onnx", 1, checked),
        seed=0,
        host=host(),
        versions=versions(),
        seconds=1.0,
    )
    return Evidence(data, held_out, figures)


def test_the_report_is_one_file_that_loads_nothing_else_and_says_its_caveat(
    evidence: Evidence, tmp_path: Path
) -> None:
    page = write_real_report(tmp_path / "report.html", evidence).read_text()
    assert re.findall(r"""(?:src|href)=["']?(?!#|data:)[^"'#> ]+""", page) == []
    assert page.count("<svg") == 4
    assert evidence.data.caveat in html.unescape(page)
    assert f"{evidence.figures.heads.situations.macro_f1:.3f}" in page


def test_the_page_s_table_shows_every_method(
    evidence: Evidence, tmp_path: Path
) -> None:
    figures = json.loads(json.dumps(evidence.figures.to_json()))
    text = filled("docs/results.md", {"real": figures}, tmp_path)
    assert f"| {OURS_18} | {figures['situations']['macro_f1']:.3f} (" in text
    assert "| timing-only baseline |" in text


# -- taxels, clock and folds


def test_the_clock_counts_from_the_last_rise_through_one_newton(whole: DataSet) -> None:
    rows = whole.tasks["situations"].take(np.arange(500))
    clock = clock_features(whole, rows)
    for trial, row, (frames, force_n) in zip(rows.trial, rows.row, clock, strict=True):
        z = whole.recordings[trial].samples[:, 2::3].sum(axis=1)
        rises = np.flatnonzero((z[1 : row + 1] >= 1.0) & (z[:row] < 1.0)) + 1
        assert frames == (row - rises[-1] if len(rises) else -1)
        assert force_n == pytest.approx(z[row], abs=1e-12)


def test_the_usual_six_taxels_have_no_neighbours_and_leave_no_gap() -> None:
    places = np.stack(np.divmod(np.arange(16), 4), axis=1)
    steps = np.abs(places[:, None] - places).sum(axis=2)
    chosen = [taxel - 1 for taxel in human_slip_uskin.SPREAD_TAXELS]
    among = steps[np.ix_(chosen, chosen)]
    assert among[~np.eye(6, dtype=np.bool_)].min() == 2
    assert steps[:, chosen].min(axis=1).max() == 1


def test_the_card_has_the_six_taxels_where_the_pad_has_them(
    whole: DataSet, six: DataSet
) -> None:
    first = six.recordings[0].samples
    np.testing.assert_array_equal(first[:, :3], whole.recordings[0].samples[:, 3:6])
    assert six.hand is not None
    sensed = [contact for contact in six.hand.contacts if contact.sensed]
    taxels = human_slip_uskin.SPREAD_TAXELS
    assert [contact.name for contact in sensed] == [f"taxel-{k}" for k in taxels]
    down, right = np.divmod(np.array(taxels) - 1, 4)
    along = np.array([contact.along_mm for contact in sensed])
    across = np.array([contact.across_mm for contact in sensed])
    np.testing.assert_allclose(along, 4.7 * (1.5 - down))
    np.testing.assert_allclose(across, 4.7 * (right - 1.5))


def test_the_leaky_split_tests_every_window_once_and_shares_people() -> None:
    folds = leaky_folds(100, 5, seed=2)
    assert sorted(np.concatenate([test for _, test in folds])) == list(range(100))
    groups = np.arange(100) // 10
    assert all(set(groups[test]) & set(groups[train]) for train, test in folds)
