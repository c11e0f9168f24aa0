"""What accuracy costs: which points, their front, what is kept, and the same answer wherever it is
run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from page_tables import filled

from benchmarks.cost import recordings
from benchmarks.cost.features import columns, look_backs_s, some, whole_of
from benchmarks.cost.measure import first_trees
from benchmarks.cost.picture import figure
from benchmarks.cost.point import (
    BANDS,
    GROUPS,
    README_POINTS,
    RECOMMENDED,
    REFERENCE,
    Point,
    points,
)
from benchmarks.cost.surface import cost, pareto
from holdfast.core.contract import FloatArray
from holdfast.core.errors import DataError, UsageError
from holdfast.core.trial_file import read_trial
from holdfast.edge_runtime.graph import open_session, run_recordings
from holdfast.evaluation.jobs import Workers
from holdfast.export.features import feature_count, feature_graph
from holdfast.export.learner import reference_votes
from holdfast.export.spec import StepSpec
from holdfast.simulation.scene_file import SceneFile, read_scene_file
from holdfast.training.datasets import load
from holdfast.training.featurise import FloatRows
from holdfast.training.plan import ForestPlan
from tools.doc_tables import tables_of

SMALL = {"train": ("thesis", 10, 0), "choose": ("daily", 3, 1), "ask": ("daily", 8, 2)}
TINY = Point(rate_hz=50.0, trees=5, depth=6, debounce=2)
TIMES = ("learner_us", "hot_us", "step_us")


@pytest.fixture(scope="module", autouse=True)
def in_long_steps() -> Iterator[None]:
    """Trials are simulated at 100 Hz in steps of a sample: nothing here depends on the millisecond
    of a slip."""

    def card(name: str, rate_hz: float) -> SceneFile:
        return replace(read_scene_file(name, rate_hz=rate_hz), step_s=1 / rate_hz)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(recordings, "read_scene_file", card)
        patched.setattr(recordings, "FASTEST_HZ", 100.0)
        yield


# -- the points


def test_every_line_of_the_readme_is_a_point_that_is_measured():
    assert set(README_POINTS) <= set(points())


@pytest.mark.parametrize("name", GROUPS)
def test_every_feature_says_how_far_back_it_looks(name):
    spec = StepSpec(6, 150.0, "N", GROUPS[name])
    looks = look_backs_s(spec)
    assert len(looks) == feature_count(spec)
    assert looks.max() <= 0.5


@pytest.mark.parametrize(
    "point",
    [
        Point(groups="now"),
        Point(groups="without activity"),
        Point(groups="now and bands", bands="30 to 55 Hz"),
        Point(groups="raw window", window_s=0.05),
        Point(rate_hz=50.0, groups="now and bands"),
    ],
)
def test_the_columns_a_point_takes_are_the_features_its_own_step_would_make(point):
    spec = StepSpec(
        6,
        point.rate_hz,
        "N",
        GROUPS[point.groups],
        window_s=point.window_s,
        bands_hz=BANDS[point.bands],
    )
    drawn = np.random.default_rng(0).normal(3.0, 1.0, (80, 18))
    own, whole = (every_feature(result, drawn) for result in (spec, whole_of(spec)))
    np.testing.assert_array_equal(whole[:, columns(spec)], own)


def every_feature(spec: StepSpec, samples: FloatArray) -> FloatRows:
    session = open_session(feature_graph(spec).SerializeToString())
    rows = np.arange(len(samples))
    result = run_recordings(
        session, [samples], [np.ones((len(samples), 6), np.bool_)], ["features"], [rows]
    )
    features: FloatRows = result[0]["features"]
    return features


# -- the front


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=30)
)
def test_nothing_on_the_front_is_beaten_and_everything_else_is(pairs):
    rows = [{"us": us, "found": found} for us, found in pairs]
    front = pareto(rows, "us", "found")

    def beats(a: dict[str, int], b: dict[str, int]) -> bool:
        better = a["us"] < b["us"] or a["found"] > b["found"]
        return a["us"] <= b["us"] and a["found"] >= b["found"] and better

    assert not any(beats(row, kept) for row in rows for kept in front)
    assert all(any(beats(kept, row) or kept == row for kept in front) for row in rows)


def test_what_is_only_decided_otherwise_has_the_forest_of_the_default():
    for of in ("scenes", "human"):
        assert (
            Point(of, debounce=3).fitted
            == Point(of, confidence="calibrated").fitted
            == Point(of)
        )
    assert Point(trees=20, depth=16).fitted == Point()
    assert Point("human", trees=20, depth=0).fitted == Point("human")


# -- what is made once for many points


@pytest.mark.parametrize("kind", ["extra", "random"])
@pytest.mark.parametrize("n_trees", [1, 3, 7])
def test_the_first_trees_of_a_large_forest_are_the_small_one_fitted_alone(
    kind, n_trees
):
    drawn = np.random.default_rng(3)
    rows, label = (
        drawn.normal(size=(200, 6)).astype(np.float32),
        drawn.integers(0, 4, 200),
    )
    alone = ForestPlan(kind, n_estimators=n_trees).build(0).fit(rows, label)
    first = first_trees(
        ForestPlan(kind, n_estimators=7).build(0).fit(rows, label), n_trees
    )
    np.testing.assert_array_equal(
        reference_votes(first, rows, 4), reference_votes(alone, rows, 4)
    )


def test_a_slower_reading_is_every_nth_sample_of_the_same_hand(tmp_path):
    parts = {"ask": ("daily", 3, 2)}
    recordings.simulate(tmp_path, "ask", [100.0, 50.0], parts)
    fast, slow = (
        load(tmp_path / f"{rate}hz-ask", windows="natural") for rate in (100, 50)
    )
    assert (fast.rate_hz, slow.rate_hz) == (pytest.approx(100.0), pytest.approx(50.0))
    for one, other in zip(fast.recordings, slow.recordings, strict=True):
        assert [event.onset_s for event in other.events] == [
            event.onset_s for event in one.events
        ]
    every, second = (
        read_trial(tmp_path / f"{rate}hz-ask/soft-ball/daily/trial_1.csv")
        for rate in (100, 50)
    )
    np.testing.assert_array_equal(second.t_s, every.t_s[::2])
    np.testing.assert_array_equal(second.raw, every.raw[::2])
    with pytest.raises(UsageError, match=r"100 Hz over 2\.5"):
        recordings.simulate(tmp_path, "ask", [40.0], parts)


def test_half_a_simulation_is_begun_anew_and_a_whole_one_is_kept(tmp_path):
    (tmp_path / "100hz-ask.half").mkdir()
    (tmp_path / "100hz-ask.half" / "card.toml").write_text("torn")
    parts = {"ask": ("daily", 2, 2)}
    recordings.simulate(tmp_path, "ask", [100.0], parts)
    written = sorted(
        (path.name, path.stat().st_mtime_ns) for path in tmp_path.rglob("*.csv")
    )
    recordings.simulate(tmp_path, "ask", [100.0], parts)
    assert written == sorted(
        (path.name, path.stat().st_mtime_ns) for path in tmp_path.rglob("*.csv")
    )
    assert not list(tmp_path.glob("*.half"))


def test_a_folder_of_other_recordings_is_refused_and_left_as_it_is(tmp_path):
    recordings.require_parts(tmp_path, SMALL)
    recordings.require_parts(tmp_path, SMALL)
    with pytest.raises(DataError, match="other recordings"):
        recordings.require_parts(tmp_path, recordings.PARTS)


# -- a small surface


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("cost")
    chosen = [
        TINY,
        replace(TINY, debounce=1),
        replace(TINY, look_back_s=0.05),
        replace(TINY, confidence="calibrated"),
        replace(TINY, learner="committee"),
    ]
    return folder, cost(folder, chosen, workers=Workers(), parts=SMALL)


def without_times(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        {key: value for key, value in row.items() if key not in TIMES} for row in rows
    ]


def test_a_row_tells_what_was_chosen_what_was_found_and_what_it_costs(measured):
    _, result = measured
    for row in result["rows"]:
        assert row["events"] > 0
        assert row["minutes"] > 1.0
        assert 0.0 < row["macro_f1"] <= 1.0
        assert 0.0 < row["learner_us"] < row["hot_us"]
        assert row["bytes"] > 1000
    for good, names in result["fronts"]["scenes"].items():
        best = max(row[good] for row in result["rows"])
        assert best in [row[good] for row in result["rows"] if row["what"] in names]
    json.dumps(result, allow_nan=False)


def test_a_run_goes_on_where_it_was(measured):
    """What stands on disk is not measured again, and what is missing is."""
    folder, content = measured
    path = folder / "points" / f"{TINY.name}.json"
    marked = json.loads(path.read_text("utf-8")) | {"recall": 0.125}
    other = folder / "points" / f"{replace(TINY, debounce=1).name}.json"
    before = other.read_text("utf-8")
    path.write_text(json.dumps(marked), encoding="utf-8")
    other.unlink()
    again = [TINY, replace(TINY, debounce=1)]
    resumed = cost(folder, again, workers=Workers(), parts=SMALL)
    rows = resumed["rows"]
    assert (content["took"]["new_points"], resumed["took"]["new_points"]) == (5, 1)
    path.write_text(
        json.dumps(marked | {"recall": content["rows"][0]["recall"]}), encoding="utf-8"
    )
    assert rows[0]["recall"] == 0.125
    assert json.loads(other.read_text("utf-8")) == json.loads(before)


def test_features_that_look_further_back_are_constant_for_a_forest_that_may_not(
    measured,
):
    folder, _ = measured
    short = replace(TINY, look_back_s=0.05)
    rows = some(folder, short, "ask", 50)
    beyond = (
        look_backs_s(short.spec(recordings.read(folder, "scenes", 50.0, "ask"))) > 0.051
    )
    assert beyond.any()
    assert not rows[:, beyond].any()
    np.testing.assert_array_equal(
        rows[:, ~beyond], some(folder, TINY, "ask", 50)[:, ~beyond]
    )


def test_a_dask_cluster_gives_the_same_rows(measured, cluster):
    folder, result = measured
    for path in (folder / "points").glob("*.json"):
        path.unlink()
    chosen = [TINY, replace(TINY, debounce=1)]
    assert without_times(
        cost(folder, chosen, workers=Workers(dask=cluster), parts=SMALL)["rows"]
    ) == without_times(result["rows"][:2])


# -- the page


def rows_of(measured: tuple[Path, dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        dict(measured[1]["rows"][0], of=point.of, what=point.what)
        for point in dict.fromkeys([*README_POINTS, *RECOMMENDED.values()])
    ]


def test_the_readme_gets_lines_that_say_what_they_were_measured_on(measured):
    figures = {"cost": {"rows": rows_of(measured)}}
    written = tables_of("README.md", figures)["cost"]
    assert written.startswith("| data |")
    assert len(written.splitlines()) == 2 + len(README_POINTS)
    assert written.count("simulated |") + written.count("real |") == len(README_POINTS)


@pytest.mark.parametrize(("kept", "says_how_long"), [(0, True), (1, False)])
def test_the_page_and_its_figure_hold_what_was_measured(
    measured, kept, says_how_long, tmp_path
):
    rows = [*rows_of(measured), dict(rows_of(measured)[0], what=REFERENCE, of="scenes")]
    fronts = {
        of: {key: [REFERENCE] for key in ("recall", "in_time", "macro_f1")}
        for of in ("scenes", "human")
    }
    latency = {
        "rows": [{"what": "step in C", "p50_us": 61.25, "hot_p50_us": 9.5}],
        "way": [{"engine": "C", "stage": "emit", "p50_us": 33.0, "p99_us": 44.0}],
        "budgets": [{"budget": "grip_over_step", "value": 0.25, "at_most": 0.5}],
    }
    took = {"wall_s": 90.0, "cores": 2, "new_points": len(rows) - kept}
    made = {
        "cost": {"rows": rows, "fronts": fronts, "took": took},
        "latency": latency,
        "training": {"rows": [{"trials": 50}]},
        "instructions": {"rows": [{"what": "whole step", "instructions": 7.0}]},
    }
    text = filled("docs/what-accuracy-costs.md", made, tmp_path)
    assert "| step in C | 61.2 | - | 9.5 | - |" in text
    assert "| C | emit | 33 | 44 |" in text
    assert "| grip over step | 0.25 | 0.5 |" in text
    assert (f"{len(rows)} points, min | 1.5 on 2 cores |" in text) == says_how_long, (
        "only of a run that made every point"
    )
    drawn = figure(rows)
    assert drawn.startswith("<svg")
    assert "simulated" in drawn
