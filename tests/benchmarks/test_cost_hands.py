"""What robustness costs: the same streams on a hand turned, mirrored, or without one sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_tables import filled

from benchmarks.cost import recordings
from benchmarks.cost.features import whole_rows
from benchmarks.cost.hands import DIES_S, HANDS, UNCHANGED, on_hand
from benchmarks.cost.picture import on_hands
from benchmarks.cost.point import FAMILIES, GROUPS, ON_HANDS, POOLED, Point, points
from benchmarks.cost.surface import cost
from holdfast.core.contract import BoolArray, FloatArray
from holdfast.evaluation.jobs import Workers
from holdfast.simulation.scene_file import SceneFile, read_scene_file
from holdfast.training.recording import DataSet

SMALL = {"train": ("thesis", 10, 0), "choose": ("daily", 3, 1), "ask": ("daily", 6, 2)}
THUMB: BoolArray = np.arange(6) < 2
FIXED = Point()
ASKED = (FIXED, Point(groups=POOLED), Point(groups=POOLED, degraded=False))


@pytest.fixture(scope="module", autouse=True)
def in_long_steps() -> Iterator[None]:
    """Trials are simulated in steps of a sample, and at no faster rate than they are read."""

    def card(name: str, rate_hz: float) -> SceneFile:
        return replace(read_scene_file(name, rate_hz=rate_hz), step_s=1 / rate_hz)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(recordings, "read_scene_file", card)
        patched.setattr(recordings, "FASTEST_HZ", 150.0)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cost")


@pytest.fixture(scope="module")
def rows(folder: Path) -> dict[str, dict[str, Any]]:
    made = cost(folder, ASKED, workers=Workers(), parts=SMALL)["rows"]
    return {row["what"]: row for row in made}


@pytest.fixture(scope="module")
def asked(rows: dict[str, dict[str, Any]], folder: Path) -> DataSet:
    return recordings.read(folder, "scenes", 150.0, "ask")


def sensors(data: DataSet) -> list[FloatArray]:
    return [one.samples.reshape(len(one.samples), -1, 3) for one in data.recordings]


def test_every_family_is_left_out_once_and_all_are_measured() -> None:
    left = [set(GROUPS[POOLED]) - set(groups) for groups in FAMILIES.values()]
    assert [one for one in left if one] == [{name} for name in GROUPS[POOLED]]
    assert set(ON_HANDS) <= set(points())


@pytest.mark.parametrize("name", ["turned", "mirrored"])
def test_a_hand_held_another_way_feels_the_same_forces_elsewhere(
    asked: DataSet, name: str
) -> None:
    other = on_hand(asked, name, THUMB)
    for before, after in zip(sensors(asked), sensors(other), strict=True):
        assert not np.allclose(before, after)
        np.testing.assert_array_equal(before[..., 2], after[..., 2])
        np.testing.assert_allclose(
            np.hypot(*np.moveaxis(before[..., :2], -1, 0)),
            np.hypot(*np.moveaxis(after[..., :2], -1, 0)),
        )


def test_a_dead_sensor_stands_still_and_is_marked_from_then_on(asked: DataSet) -> None:
    other = on_hand(asked, "one dead", THUMB)
    for one in other.recordings:
        dies = round(DIES_S * one.rate_hz)
        assert one.valid[:dies].all()
        assert (one.valid[dies:].sum(axis=1) == 5).all()
        still = np.ptp(one.samples.reshape(len(one.samples), -1, 3)[dies:], axis=0)
        assert (still.max(axis=1) == 0.0).sum() == 1


def test_pooled_features_are_those_of_the_hand_that_is_not_turned(
    rows: dict[str, dict[str, Any]], folder: Path
) -> None:
    for name in ("turned", "mirrored"):
        parts = ("ask", f"ask, {name}")
        pooled, turned = (whole_rows(folder, ASKED[1], part) for part in parts)
        np.testing.assert_allclose(pooled, turned, rtol=1e-4, atol=1e-4)
        fixed, other = (whole_rows(folder, FIXED, part) for part in parts)
        assert not np.allclose(fixed, other, rtol=1e-2, atol=1e-2)


def test_a_point_says_what_became_of_the_slips_on_every_hand(
    rows: dict[str, dict[str, Any]],
) -> None:
    for row in rows.values():
        assert list(row["hands"]) == [UNCHANGED, *HANDS]
        assert row["hands"][UNCHANGED]["recall"] == row["recall"]
        assert row["hands"][UNCHANGED]["in_time"] == row["in_time"]
    pooled = rows["pooled"]["hands"]
    assert pooled["turned"] == pooled[UNCHANGED] == pooled["mirrored"]


def test_without_all_sensors_only_degraded_answers_find_a_slip(
    rows: dict[str, dict[str, Any]],
) -> None:
    found = {what: row["hands"]["one dead"]["recall"] for what, row in rows.items()}
    assert found["pooled"] > 0.0
    assert found["reference"] == found["pooled, no degraded answers"] == 0.0


def test_the_page_and_its_figure_show_every_hand(
    rows: dict[str, dict[str, Any]], tmp_path: Path
) -> None:
    made = {"on_hands": {"rows": list(rows.values())}}
    text = filled("docs/what-accuracy-costs.md", made, tmp_path)
    dead = rows["pooled"]["hands"]["one dead"]
    low, high = dead["in_time_ci"]
    assert f"{dead['in_time']:.3g} ({low:.2f} to {high:.2f})" in text
    assert "| pooled, no degraded answers |" in text
    every = [{**rows["pooled"], "what": point.what} for point in ON_HANDS]
    drawn = on_hands(every)
    for name in ("held one way", *HANDS):
        assert name in drawn
