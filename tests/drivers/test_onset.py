"""When an object began to slip, from tag corners alone: no camera, no depthai."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.contract import FloatArray
from holdfast.core.errors import LabelError, TagError
from holdfast.drivers.camera.onset import HiddenMotion, Motion, Slip, find_slip, motion

TAG_MM = 10.0
GROSS_MM = 2.0
MM_PER_PX = 0.25
SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
NOISE_MM = 0.004


def tag(
    centre_px: FloatArray,
    side_px: FloatArray | float = 40.0,
    turned: FloatArray | float = 0.0,
) -> FloatArray:
    """[K, 4, 2] corners of a square tag at centre_px [K, 2]."""
    angle = np.broadcast_to(turned, len(centre_px))
    side = np.broadcast_to(side_px, len(centre_px))
    corners = SQUARE @ turn_of(angle).transpose(0, 2, 1)
    return centre_px[:, None, :] + side[:, None, None] * corners


def turn_of(angle: FloatArray) -> FloatArray:
    """[K, 2, 2] turns by angle [K]."""
    rows = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return np.array(rows).transpose(2, 0, 1)


def slid(
    acceleration_mm_s2: float,
    start_s: float,
    *,
    seed: int = 0,
    lasts_s: float = 1.5,
) -> Motion:
    """At rest, then a constant acceleration."""
    t_s = np.arange(1, int(60 * (start_s + lasts_s))) / 60
    place_mm = np.random.default_rng(seed).normal(0.0, NOISE_MM, (len(t_s), 2))
    place_mm[:, 1] += 0.5 * acceleration_mm_s2 * np.maximum(t_s - start_s, 0.0) ** 2
    return Motion(t_s, place_mm, MM_PER_PX)


def pressed(peak_mm: float, *, stays: bool = False) -> Motion:
    """Loaded from 1 s to 2 s: the pads give by peak_mm and come back, or stay there."""
    t_s = np.arange(1, 240) / 60.0
    place_mm = np.random.default_rng(1).normal(0.0, NOISE_MM, (len(t_s), 2))
    load = np.clip(t_s - 1.0, 0.0, 0.2) - (0.0 if stays else 1.0) * np.clip(
        t_s - 2.0, 0.0, 0.2
    )
    place_mm[:, 0] += 5.0 * peak_mm * load
    return Motion(t_s, place_mm, MM_PER_PX)


def hiding(moved: Motion, first: int, stop: int) -> Motion:
    place_mm = moved.place_mm.copy()
    place_mm[first:stop] = np.nan
    return Motion(moved.t_s, place_mm, moved.mm_per_px)


def found(moved: Motion, gross_mm: float = GROSS_MM) -> Slip:
    slip = find_slip(moved, gross_mm)
    assert isinstance(slip, Slip)
    return slip


# -- the object in the hand


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.floats(20, 80))
def test_a_hand_that_moves_turns_and_comes_nearer_moves_nothing(seed, side_px):
    rng = np.random.default_rng(seed)
    away_mm = rng.uniform(-30, 30, 2)
    angle = rng.uniform(-1, 1, 20)
    side = side_px * rng.uniform(0.8, 1.25, 20)
    hand = rng.uniform(100, 300, (20, 2))
    thing = hand + (turn_of(angle) @ away_mm) * side[:, None] / TAG_MM
    moved = motion(
        np.arange(20.0), tag(thing, side, angle + 0.3), tag(hand, side, angle), TAG_MM
    )
    np.testing.assert_allclose(moved.place_mm, np.tile(away_mm, (20, 1)), atol=1e-9)


def test_a_hidden_tag_gives_a_gap_and_never_a_number():
    hand = tag(np.full((20, 2), 100.0))
    thing = tag(np.full((20, 2), [180.0, 100.0]))
    hand[3] = np.nan
    thing[7, 2] = np.nan
    moved = motion(np.arange(20.0), thing, hand, TAG_MM)
    assert np.flatnonzero(np.isnan(moved.place_mm[:, 0])).tolist() == [3, 7]
    assert len(moved.seen_rows) == 18


def test_tags_never_seen_together_are_an_error():
    hand = tag(np.full((20, 2), 100.0))
    thing = tag(np.full((20, 2), [180.0, 100.0]))
    hand[::2] = np.nan
    thing[1::2] = np.nan
    with pytest.raises(LabelError, match=r"0 of 20 frames.*36h11"):
        motion(np.arange(20.0), thing, hand, TAG_MM)


def test_tags_printed_in_two_sizes_are_refused_with_the_size_the_other_has():
    places = np.tile([100.0, 100.0], (20, 1))
    with pytest.raises(
        TagError, match=r"hand's tag is 10 mm, the object's is 12\.00 mm.*two sizes"
    ):
        motion(np.arange(20.0), tag(places + 80.0, 48.0), tag(places, 40.0), TAG_MM)
    motion(np.arange(20.0), tag(places + 80.0, 41.0), tag(places, 40.0), TAG_MM)


def test_a_tag_that_is_no_square_is_refused():
    flat = tag(np.zeros((20, 2))) * [1.0, 0.9] + [180.0, 100.0]
    with pytest.raises(
        TagError, match=r"object's tag is 40\.0 px wide and 36\.0 px high.*face"
    ):
        motion(np.arange(20.0), flat, tag(np.full((20, 2), 100.0)), TAG_MM)


# -- the slip


@settings(max_examples=60)
@given(st.floats(20, 8000), st.floats(1.0, 1.0 + 1 / 60), st.integers(0, 1000))
def test_the_fitted_start_is_the_start_and_the_gross_distance_is_reached_when_it_is(
    acceleration, start_s, seed
):
    slip = found(slid(acceleration, start_s, seed=seed))
    assert slip.start_s == pytest.approx(start_s, abs=40e-3)
    assert abs(slip.start_s - start_s) < 3.0 * slip.uncertainty_s
    lasts_s = np.sqrt(2.0 * GROSS_MM / acceleration)
    assert slip.gross_s == pytest.approx(start_s + lasts_s, abs=4e-3)


def ramp(after_s: FloatArray, elastic_mm: float, lasts_s: float) -> FloatArray:
    """Pads give by so much in so long, then the object slides."""
    slides_s = np.maximum(after_s - lasts_s, 0.0)
    given_mm = elastic_mm * np.minimum(after_s / lasts_s, 1.0)
    return given_mm + 500.0 * slides_s**2


WAYS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "speed of 5 mm/s": lambda after_s: 5.0 * after_s,
    "speed of 60 mm/s": lambda after_s: 60.0 * after_s,
    "ramp of 0.3 mm in 0.1 s": partial(ramp, elastic_mm=0.3, lasts_s=0.1),
    "ramp of 0.8 mm in 0.2 s": partial(ramp, elastic_mm=0.8, lasts_s=0.2),
    "ramp of 0.8 mm in 0.05 s": partial(ramp, elastic_mm=0.8, lasts_s=0.05),
    "cubic, 2 mm in 0.1 s": lambda after_s: 2.0 * (after_s / 0.1) ** 3,
    "cubic, 2 mm in 0.6 s": lambda after_s: 2.0 * (after_s / 0.6) ** 3,
    "acceleration of 20 mm/s2": lambda after_s: 10.0 * after_s**2,
    "acceleration of 8000 mm/s2": lambda after_s: 4000.0 * after_s**2,
}


@pytest.mark.parametrize("fps", [30, 60, 120])
@pytest.mark.parametrize("way", WAYS)
def test_the_start_is_within_its_stated_uncertainty_however_the_motion_begins(
    way: str, fps: int
) -> None:
    late, stated = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        start_s = 1.0 + rng.uniform(0.0, 1.0 / fps)
        t_s = np.arange(1, int(2.2 * fps)) / fps
        place_mm = rng.normal(0.0, NOISE_MM, (len(t_s), 2))
        place_mm[:, 1] += WAYS[way](np.maximum(t_s - start_s, 0.0))
        slip = found(Motion(t_s, place_mm, MM_PER_PX))
        late.append(slip.start_s - start_s)
        stated.append(slip.uncertainty_s)
    errors = np.abs(late) / stated
    assert errors.max() < 3.0
    assert np.median(errors) < 1.3
    # one that says "within a second" would be right too
    assert np.median(stated) < 0.9 / fps + 0.016


def test_where_nothing_moves_there_is_no_onset():
    for seed in range(50):
        assert find_slip(slid(0.0, 1.0, seed=seed, lasts_s=5.0), GROSS_MM) is None


@pytest.mark.parametrize("stays", [False, True])
def test_a_pad_that_gives_is_no_slip(stays):
    for peak_mm in (0.3, 0.8, 1.9):
        assert find_slip(pressed(peak_mm, stays=stays), GROSS_MM) is None


def test_an_object_that_settled_before_is_measured_from_where_it_last_rested():
    moved = slid(300.0, 3.0)
    moved.place_mm[moved.t_s > 1.0] += [1.5, 0.0]
    slip = found(moved)
    assert abs(slip.start_s - 3.0) < 2.0 * slip.uncertainty_s < 0.03
    assert slip.gross_s == pytest.approx(
        3.0 + np.sqrt(2.0 * GROSS_MM / 300.0), abs=5e-3
    )


def test_a_gap_while_the_object_rests_or_already_slides_changes_no_start():
    moved = slid(30.0, 1.5)
    start_s = found(moved).start_s
    for first, stop in ((20, 30), (118, 140)):
        assert found(hiding(moved, first, stop)).start_s == pytest.approx(
            start_s, abs=1e-3
        )


def test_an_object_that_moves_behind_a_gap_has_no_onset():
    hidden = find_slip(hiding(slid(300.0, 1.0), 50, 75), GROSS_MM)
    assert hidden == HiddenMotion(pytest.approx(50 / 60.0), pytest.approx(76 / 60.0))


def test_a_tag_lost_as_the_object_leaves_is_hidden_and_not_no_slip():
    moved = slid(3000.0, 1.0)
    hidden = find_slip(hiding(moved, 61, len(moved.t_s)), GROSS_MM)
    assert isinstance(hidden, HiddenMotion)
    assert hidden == HiddenMotion(moved.t_s[60], moved.t_s[-1])
    assert find_slip(hiding(moved, 58, len(moved.t_s)), GROSS_MM) is None


def test_a_trial_may_end_as_soon_as_the_object_has_rested():
    for frames in (19, 20, 21, 22):
        moved = slid(0.0, 1.0).until(frames / 60)
        assert find_slip(moved, GROSS_MM) is None


def test_an_object_that_never_rests_is_an_error():
    for frames in (0, 1, 100):
        t_s = np.arange(frames) / 60.0
        with pytest.raises(LabelError, match=r"never rests in the hand for 0\.3 s"):
            find_slip(Motion(t_s, np.outer(t_s, [5.0, 0.0]), MM_PER_PX), GROSS_MM)


def test_a_part_of_the_trial_is_looked_at_alone():
    moved = slid(300.0, 2.0)
    assert find_slip(moved.until(1.9), GROSS_MM) is None
    assert found(moved.until(2.4)).start_s == pytest.approx(2.0, abs=5e-3)


# -- limits, exactly


def steps(places_mm, fps=20.0, mm_per_px=1.0):
    """A motion along y at 20 frames a second, without noise; nan where a tag is hidden."""
    place_mm = np.array([[0.0 * one, one] for one in places_mm])
    return Motion(np.arange(len(places_mm)) / fps, place_mm, mm_per_px)


REST = [0.0] * 8


def test_three_frames_in_a_row_beyond_the_threshold_are_a_motion_and_two_are_not():
    def slips(*away_mm):
        return find_slip(steps([*REST, *away_mm, *REST]), 0.15) is not None

    assert not slips(1.0, 1.0)
    assert slips(1.0, 1.0, 1.0)
    assert not slips(0.15, 0.15, 0.15)
    assert slips(0.151, 0.151, 0.151)
    assert not slips(1.0, 1.0, 0.0, 1.0, 1.0)


def test_a_slip_has_these_times_to_the_millisecond():
    """2 mm are reached between two frames, where the root of the distance grows linearly."""
    slip = found(steps([*REST, 0.25, 1.0, 2.25, 4.0, *[4.0] * 9]))
    assert slip.seen_s == pytest.approx(8 / 20)
    assert slip.gross_s == pytest.approx((9 + (np.sqrt(2.0) - 1.0) / 0.5) / 20)
    # a parabola of three frames; a cubic would begin earlier
    assert slip.start_s == pytest.approx(7 / 20, abs=0.015)
    assert slip.start_s == pytest.approx(7 / 20, abs=slip.uncertainty_s)
    # the rest that follows begins with its first frame
    assert slip.end_s == pytest.approx(11 / 20, abs=0.051)
    cut = found(steps([*REST, 0.25, 1.0, 2.25, 4.0]))
    assert cut.end_s == pytest.approx(11 / 20)
    assert find_slip(steps([*REST, 0.25, 1.0, 1.9, 1.99, 1.9]), GROSS_MM) is None
    assert isinstance(
        find_slip(steps([*REST, 0.25, 1.0, 1.9, 2.0, 2.0]), GROSS_MM), Slip
    )
