"""What accuracy costs: which points, what is found of one, other hands, and a run that goes on."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from page_tables import filled

from benchmarks.cost import recordings, surface
from benchmarks.cost.hands import DIES_S, HANDS, UNCHANGED, on_hand
from benchmarks.cost.measure import look_backs_s, seen
from benchmarks.cost.picture import figure
from benchmarks.cost.point import (
    GROUPS,
    ON_HANDS,
    POINTS,
    POOLED,
    README_POINTS,
    SHIPPED,
    TINY,
    Point,
)
from benchmarks.cost.surface import cost
from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import UsageError
from holdfast.core.trial_file import read_trial
from holdfast.data.recording import DataSet
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.evaluation.jobs import Workers
from holdfast.simulation.scenes.scene_file import SceneFile, read_scene_file
from holdfast.step.features import feature_count
from holdfast.step.spec import StepSpec

SMALL = {"train": ("thesis", 10, 0), "choose": ("daily", 2, 1), "ask": ("daily", 4, 2)}
CHOSEN = (Point(), Point(debounce=2), Point(look_back_s=0.05), Point(groups=POOLED))
THUMB: BoolArray = np.arange(6) < 2
TIMES = ("hot_us", "step_us")
Rows = dict[str, dict[str, Any]]


@pytest.fixture(scope="module", autouse=True)
def in_long_steps() -> Iterator[None]:
    """Trials are simulated in steps of a sample, and at no faster rate than they are read; a step
    is timed for a second."""

    def card(name: str, rate_hz: float) -> SceneFile:
        return replace(read_scene_file(name, rate_hz=rate_hz), step_s=1 / rate_hz)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(recordings, "read_scene_file", card)
        patched.setattr(recordings, "FASTEST_HZ", 150.0)
        timed = "time_deployed"
        patched.setattr(surface, timed, partial(surface.time_deployed, seconds=1.0))
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cost")


@pytest.fixture(scope="module")
def measured(folder: Path) -> Rows:
    found = cost(folder, CHOSEN, workers=Workers(), parts=SMALL)
    assert found["took"]["new_points"] == len(CHOSEN)
    return {row["what"]: row for row in found["rows"]}


@pytest.fixture(scope="module")
def asked(measured: Rows, folder: Path) -> DataSet:
    return recordings.read(folder, Point(), "ask")


def sensors(data: DataSet) -> list[FloatArray]:
    return [one.samples.reshape(len(one.samples), -1, 3) for one in data.recordings]


def test_every_point_has_a_name_of_its_own_and_the_pages_show_measured_ones() -> None:
    assert len({one.name for one in POINTS}) == len(POINTS)
    assert {*README_POINTS, *ON_HANDS} <= set(POINTS)
    assert TINY.what == "committee, 8 trees, depth 10, pooled"
    assert SHIPPED.what == "committee, pooled"


@pytest.mark.parametrize("name", GROUPS)
def test_every_feature_says_how_far_back_it_looks(name: str) -> None:
    spec = StepSpec(6, 150.0, "N", GROUPS[name])
    looks = look_backs_s(spec)
    assert len(looks) == feature_count(spec)
    assert looks.max() <= 0.5
    rows = np.ones((2, len(looks)), dtype=np.float32)
    assert (seen(rows, spec, 0.1) == (looks <= 0.1)).all()


def test_a_slower_reading_is_every_nth_sample_of_the_same_hand(tmp_path: Path) -> None:
    parts = {"ask": ("daily", 2, 2)}
    recordings.simulate(tmp_path, "ask", [75.0], parts)
    fast, slow = (
        recordings.read(tmp_path, Point(rate_hz=hz), "ask") for hz in (150.0, 75.0)
    )
    for one, other in zip(fast.recordings, slow.recordings, strict=True):
        assert [event.onset_s for event in other.events] == [
            event.onset_s for event in one.events
        ]
    every, second = (
        read_trial(tmp_path / f"{hz}hz-ask/soft-ball/daily/trial_1.csv")
        for hz in (150, 75)
    )
    np.testing.assert_array_equal(second.t_s, every.t_s[::2])
    np.testing.assert_array_equal(second.raw, every.raw[::2])
    assert not list(tmp_path.glob("*.half"))
    with pytest.raises(UsageError, match=r"150 Hz over 2\.5"):
        recordings.simulate(tmp_path, "ask", [60.0], parts)


@pytest.mark.parametrize("name", ["turned", "mirrored"])
def test_a_hand_held_another_way_feels_the_same_forces_elsewhere(
    asked: DataSet, name: str
) -> None:
    other = on_hand(asked, name, THUMB)
    for before, after in zip(sensors(asked), sensors(other), strict=True):
        assert not np.allclose(before, after)
        np.testing.assert_array_equal(before[..., 2], after[..., 2])
        lengths = [np.linalg.norm(one[..., :2], axis=2) for one in (before, after)]
        np.testing.assert_allclose(*lengths)


def test_a_dead_sensor_stands_still_and_is_marked_from_then_on(asked: DataSet) -> None:
    other = on_hand(asked, "one dead", THUMB)
    for one, values in zip(other.recordings, sensors(other), strict=True):
        dies = round(DIES_S * one.rate_hz)
        assert one.valid[:dies].all()
        assert (one.valid[dies:].sum(axis=1) == 5).all()
        still = np.ptp(values[dies:], axis=0)
        assert (still.max(axis=1) == 0.0).sum() == 1


def test_a_row_tells_what_was_chosen_what_was_found_and_what_it_costs(
    measured: Rows,
) -> None:
    for row in measured.values():
        assert row["events"] > 0
        assert row["minutes"] > 0.5
        assert 0.0 < row["macro_f1"] <= 1.0
        assert min(row[name] for name in TIMES) > 0.0
    one, two = measured["reference"], measured["debounce 2"]
    # the same learner, asked twice before it acts
    assert [one[name] for name in TIMES] == [two[name] for name in TIMES]
    assert one["macro_f1"] == two["macro_f1"]
    assert one["delay_ms"] != two["delay_ms"]


def test_pooled_features_answer_alike_on_a_hand_held_another_way(
    measured: Rows,
) -> None:
    for what in ("reference", "pooled"):
        hands = measured[what]["hands"]
        assert list(hands) == [UNCHANGED, *HANDS]
        assert hands[UNCHANGED]["recall"] == measured[what]["recall"]
    pooled = measured["pooled"]["hands"]
    assert pooled["turned"] == pooled[UNCHANGED] == pooled["mirrored"]
    assert measured["debounce 2"]["hands"] is None
    dead = {
        what: measured[what]["hands"]["one dead"] for what in ("reference", "pooled")
    }
    assert dead["pooled"]["recall"] > 0.0 == dead["reference"]["recall"]


def test_a_run_goes_on_where_it_was(measured: Rows, folder: Path) -> None:
    """What stands on disk is not measured again, and what is missing is."""
    path = folder / "points" / f"{Point().name}.json"
    other = folder / "points" / f"{CHOSEN[1].name}.json"
    before = path.read_text("utf-8"), other.read_text("utf-8")
    marked = {**json.loads(before[0]), "recall": 0.125}
    path.write_text(json.dumps(marked), encoding="utf-8")
    other.unlink()
    resumed = cost(folder, CHOSEN[:2], workers=Workers(), parts=SMALL)
    path.write_text(before[0], encoding="utf-8")
    assert resumed["took"]["new_points"] == 1
    assert resumed["rows"][0]["recall"] == 0.125
    assert other.read_text("utf-8") == before[1]


def test_pages_and_picture_show_every_point_and_hand(
    measured: Rows, tmp_path: Path
) -> None:
    rows = [{**measured["pooled"], "what": one.what, "of": one.of} for one in POINTS]
    made = {"cost": {"rows": rows}, "on_hands": {"rows": rows}}
    text = filled("docs/what-accuracy-costs.md", made, tmp_path)
    for point in POINTS:
        data = "people, real" if point.of == "human" else "scenes"
        assert f"| {data} | {point.what} |" in text
    dead = measured["pooled"]["hands"]["one dead"]
    low, high = dead["in_time_ci"]
    assert f"{dead['in_time']:.3g} ({low:.2f} to {high:.2f})" in text
    steps = [
        {"what": f"step in {engine}", "p50_us": 301.0, "hot_p50_us": 71.0}
        for engine in ("onnxruntime", "C")
    ]
    live = {"cost": made["cost"], "latency": {"rows": steps}}
    readme = filled("README.md", live, tmp_path)
    assert "\n| committee, pooled |" in readme
    assert readme.count("301 us<!-- = -->") == 2
    drawn = figure(rows)
    for words in ("simulated", "shipped", "50 Hz", "debounce 2"):
        assert words in drawn


class Schedule(VirtualClock):
    """Notes what it is asked to wait for."""

    waits_ns: ClassVar[list[int]] = []

    def wait_until(self, t_ns: int) -> None:
        self.waits_ns.append(t_ns)
        super().wait_until(t_ns)


def test_as_deployed_calls_come_once_a_period_and_take_turns_by_the_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(surface, "RunClock", Schedule)
    came: list[str] = []
    calls: surface.Calls = {
        name: partial(came.append, name) for name in ("one", "other")
    }
    times = surface.time_deployed(calls, rate_hz=20.0, seconds=2.0)
    assert came == (["one"] * 20 + ["other"] * 20) * 2
    sizes = {name: len(values) for name, values in times.items()}
    assert sizes == dict.fromkeys(calls, 40)
    # asleep in between, for a period
    assert set(np.diff(Schedule.waits_ns)) == {50_000_000}
