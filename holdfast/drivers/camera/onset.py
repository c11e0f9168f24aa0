"""When an object began to slip in the hand, from its motion in a camera's frames (motion.py).

The result is a time on which no tactile sample had an influence. There are three times:

    start  where a line, a parabola or a cubic through the first frames that moved leaves the level
           of rest (with its standard deviation, which counts how far they differ)
    seen   the first of three frames in a row beyond max(5 sigma, 0.15 px). It is late by
           sqrt(2 threshold / acceleration), 20 to 100 ms; lead times would look too long with it
    gross  a fixed distance in mm, larger than what soft pads give without any slip

A soft pad lets the object move before anything slips. So a motion counts only if it reaches the
gross distance, which lies above what the pads give. Where a tag is hidden, the track has a gap, and
nothing in the gap has a time. The camera cannot see parts of the contact slide (incipient slip).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, IntArray
from holdfast.core.errors import LabelError, TagError

# How an object moves in the hand, from the corners of two printed tags in a camera's frames.
#
# One tag is on the object and one on the hand. The object's place is given in the axes of the
# hand's tag, in mm of the printed side. So a hand that moves, turns or comes nearer changes
# nothing. Numpy only.

SIGMAS = 5.0
FLOOR_PX = 0.15
REST_S = 0.3
REST_FRAMES = 5
"""An object rests when all frames of this time, and at least this many, stay within the threshold.

The threshold is around their median.
"""
DIFFER = 0.05
"""Tags of one size, in one plane and facing the camera, have sides that differ by less."""


@dataclass(frozen=True)
class Motion:
    """The object in the hand: t_s [K], place_mm [K, 2] (nan where a tag is hidden), and the scale.

    mm_per_px is the scale at the hand's tag.
    """

    t_s: FloatArray
    place_mm: FloatArray
    mm_per_px: float

    @cached_property
    def seen_rows(self) -> IntArray:
        """The frames that show both tags."""
        return np.flatnonzero(np.isfinite(self.place_mm).all(axis=1))

    @cached_property
    def sigma_mm(self) -> float:
        """Noise of one axis, from the median step between frames.

        A slip of a few frames does not change it.
        """
        steps = np.diff(self.place_mm[self.seen_rows], axis=0)
        # 1.4826 makes the median deviation of a normal distribution its sigma
        deviation = np.median(np.abs(steps)) if len(steps) else 0.0
        return float(1.4826 * deviation / np.sqrt(2.0))

    @property
    def threshold_mm(self) -> float:
        """An object that is further from rest than this has moved."""
        return max(SIGMAS * self.sigma_mm, FLOOR_PX * self.mm_per_px)

    def until(self, until_s: float) -> Motion:
        """The part up to until_s."""
        part = self.t_s <= until_s
        return Motion(self.t_s[part], self.place_mm[part], self.mm_per_px)


def motion(
    t_s: FloatArray,
    object_px: FloatArray,
    hand_px: FloatArray,
    tag_mm: float,
) -> Motion:
    """The object's motion in the hand's axes, from the corners of both tags.

    object_px, hand_px: [K, 4, 2] (column, row; clockwise from top left), nan if hidden. tag_mm: the
    printed side without its margin, the same for both tags. Raises TagError where the tags
    contradict each other, LabelError where both tags are never seen together.
    """
    seen = np.isfinite(object_px) & np.isfinite(hand_px)
    both: BoolArray = np.logical_and.reduce(seen, axis=(1, 2))
    if both.sum() < REST_FRAMES:
        raise LabelError(
            f"both tags are seen in {both.sum()} of {len(both)} frames",
            cause="a tag is out of the picture, covered, out of focus or without its white margin",
            next_step="look at the video; use tags 0 (object) and 1 (hand) of the family 36h11",
        )
    _require_one_size(object_px[both], hand_px[both], tag_mm)
    # corners of a square around its centre, as complex numbers: a turn is a product
    square = tag_mm * np.array([-0.5 - 0.5j, 0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j])
    hand, thing = (
        corners[both, :, 0] + 1j * corners[both, :, 1]
        for corners in (hand_px, object_px)
    )
    about = hand - hand.mean(axis=1, keepdims=True)
    # least squares: the one turn and scale that maps the hand's corners onto its square
    turn = (about.conj() * square).sum(axis=1) / (np.abs(about) ** 2).sum(axis=1)
    place = turn * (thing.mean(axis=1) - hand.mean(axis=1))
    place_mm = np.full((len(t_s), 2), np.nan)
    place_mm[both] = np.stack([place.real, place.imag], axis=1)
    return Motion(t_s, place_mm, float(np.median(np.abs(turn))))


def sides_px(corners_px: FloatArray) -> FloatArray:
    """Median (width, height) of a tag [K, 4, 2] in px."""
    sides = np.linalg.norm(np.roll(corners_px, -1, axis=1) - corners_px, axis=2)
    return np.array([np.median(sides[:, ::2]), np.median(sides[:, 1::2])])


def _require_one_size(
    object_px: FloatArray, hand_px: FloatArray, tag_mm: float
) -> None:
    thing = sides_px(object_px)
    hand = sides_px(hand_px)
    for name, side in (("object", thing), ("hand", hand)):
        if abs(side[0] / side[1] - 1.0) > DIFFER:
            raise TagError(
                f"the {name}'s tag is {side[0]:.1f} px wide and {side[1]:.1f} px high, not square",
                cause="the tag does not face the camera, or the printer scaled it one way",
                next_step="turn the tag to the camera, and measure both sides",
            )

    share = float(thing.mean() / hand.mean())
    if abs(share - 1.0) > DIFFER:
        raise TagError(
            f"if the hand's tag is {tag_mm:g} mm, the object's is {tag_mm * share:.2f} mm",
            cause="the tags have two sizes, or one is nearer to the camera",
            next_step="measure both printed sides, and put both tags in one plane",
        )


LONGEST_STEP = 2.5
"""Seen frames that are further apart than this many periods have a gap between them."""
EXPONENTS = (1.0, 1.5, 2.0, 2.5, 3.0)
"""A motion begins as a power of time: 1 at constant speed, 2 at constant acceleration, 3 where the
acceleration grows. Which one it is, the first frames do not tell for sure."""
FIT_FRAMES = 3
FIT_THRESHOLDS = 20.0
"""The fit covers the rest, this many moving frames, and later ones up to this many thresholds away,
as long as one of the motions fits them: a pad that has given way ends the motion of the start."""
DIFFERS = 0.1
"""A motion differs from a power of time by this share of its distance."""
WITHIN, BEYOND = 2.0, 4.0
"""A frame within so many sigmas is at rest as far as is seen. No start counts with which the last
such frame would have been beyond so many."""
STEPS = 600
"""Points of the grid on which the start is searched."""


@dataclass(frozen=True)
class Slip:
    """One slip, times in s as in the frames.

    uncertainty_s: standard deviation of the start: that of the fit, and that of a frame period.
    """

    start_s: float
    uncertainty_s: float
    seen_s: float
    gross_s: float
    end_s: float


@dataclass(frozen=True)
class HiddenMotion:
    """The object moved while a tag was hidden.

    The time of the slip, if there was one, is unknown.
    """

    from_s: float
    to_s: float


def find_slip(moved: Motion, gross_mm: float) -> Slip | HiddenMotion | None:
    """The first motion from rest that reaches gross_mm; None without one. Raises LabelError.

    LabelError: the object never rests.
    """
    track = _Track(moved)
    rest = track.rest(0)
    if rest is None:
        raise LabelError(
            f"the object never rests in the hand for {REST_S:g} s",
            cause="hidden tags, or an object that moves all the time",
            next_step="hold still before the action, or choose a part with --until",
        )
    level_mm, after = rest
    # every motion away from a rest is measured from the rest before it
    while rest and (first := track.departs(after, level_mm)) is not None:
        rest = track.rest(first)
        stop = rest[1] if rest else len(track.t_s)
        away_mm = track.away_mm(first, level_mm)[: stop - first]
        if away_mm.max() >= gross_mm:
            gross = first + int(np.argmax(away_mm >= gross_mm))
            gap = track.first_gap(first - 1, gross + 1)
            if gap is not None:
                return HiddenMotion(float(track.t_s[gap]), float(track.t_s[gap + 1]))
            return _slip(track, Departure(level_mm, first, gross, stop), gross_mm)
        if rest:
            level_mm, after = rest

    return track.hidden_at_the_end(level_mm)


@dataclass(frozen=True)
class Departure:
    """A motion away from a rest: level_mm [2] of that rest, and rows of the track.

    first: the first of three frames away. gross: the first beyond the gross distance. stop: the
    first frame after the next rest began, or the track's end.
    """

    level_mm: FloatArray
    first: int
    gross: int
    stop: int


class _Track:
    """The frames that show both tags: t_s [N], place_mm [N, 2]."""

    def __init__(self, moved: Motion) -> None:
        self.moved = moved
        self.t_s = moved.t_s[moved.seen_rows]
        self.place_mm = moved.place_mm[moved.seen_rows]

    def away_mm(self, first: int, level_mm: FloatArray) -> FloatArray:
        """Distance from a rest, from this frame on."""
        away_mm: FloatArray = np.linalg.norm(self.place_mm[first:] - level_mm, axis=1)
        return away_mm

    def is_away(self, first: int, level_mm: FloatArray) -> BoolArray:
        """Whether the object has moved from a rest, from this frame on."""
        away: BoolArray = self.away_mm(first, level_mm) > self.moved.threshold_mm
        return away

    def rest(self, first: int) -> tuple[FloatArray, int] | None:
        """Level [2] of the first rest from this frame on, and the first frame after it."""
        for start in range(first, len(self.t_s)):
            end_s = self.t_s[start] + REST_S
            rested = int(np.searchsorted(self.t_s, end_s)) + 1
            stop = max(rested, start + REST_FRAMES)
            if stop > len(self.t_s):
                return None
            level_mm = np.median(self.place_mm[start:stop], axis=0)
            if not self.is_away(start, level_mm)[: stop - start].any():
                return level_mm, stop

        return None

    def departs(self, first: int, level_mm: FloatArray) -> int | None:
        """The first frame of three in a row that are away from this level."""
        away = self.is_away(first, level_mm)
        in_a_row = away[:-2] & away[1:-1] & away[2:]
        return first + int(np.argmax(in_a_row)) if in_a_row.any() else None

    def is_gap(self, step_s: FloatArray) -> BoolArray:
        """Whether tags were hidden between seen frames that are so far apart."""
        return step_s > LONGEST_STEP * np.median(np.diff(self.moved.t_s))

    def first_gap(self, first: int, stop: int) -> int | None:
        """The first of these frames that a gap follows."""
        gaps = np.flatnonzero(self.is_gap(np.diff(self.t_s[first:stop])))
        return first + int(gaps[0]) if gaps.size else None

    def hidden_at_the_end(self, level_mm: FloatArray) -> HiddenMotion | None:
        """The gap at the end of what is seen, if the object was away from its rest then."""
        ends_s = np.array([self.t_s[-1], self.moved.t_s[-1]])
        last = len(self.t_s) - 1
        if self.is_gap(np.diff(ends_s)).any() and self.is_away(last, level_mm).any():
            return HiddenMotion(*ends_s.tolist())
        return None


def _slip(track: _Track, departure: Departure, gross_mm: float) -> Slip:
    """The times of a slip."""
    t_s, first, gross = track.t_s, departure.first, departure.gross
    offset_mm = track.place_mm - departure.level_mm
    along_mm = offset_mm @ (offset_mm[gross] / np.linalg.norm(offset_mm[gross]))
    start_s, start_sd_s = fitted_start(t_s, along_mm, first, track.moved)
    around = slice(gross - 1, gross + 1)
    # a constant acceleration: the root of the distance grows linearly with time
    roots = np.sqrt(np.linalg.norm(offset_mm[around], axis=1))
    gross_s = float(np.interp(np.sqrt(gross_mm), roots, t_s[around]))
    gap = track.first_gap(gross, departure.stop)
    end_s = float(t_s[departure.stop - 1 if gap is None else gap])
    if gap is None and departure.stop < len(t_s):
        # the next rest was recognised only at its end
        end_s = max(gross_s, end_s - REST_S)
    longest_s = np.diff(t_s[first - 1 : gross + 1]).max()
    uncertainty_s = float(np.hypot(start_sd_s, longest_s / np.sqrt(12.0)))
    return Slip(start_s, uncertainty_s, float(t_s[first]), gross_s, end_s)


def fitted_start(
    t_s: FloatArray, along_mm: FloatArray, first: int, moved: Motion
) -> tuple[float, float]:
    """Start of c + k (t - start)^p, 0 before it, and its standard deviation, s.

    first: the first frame beyond the threshold. Starts on a grid and EXPONENTS are compared by
    their likelihood, in a fit of c and k to the rest and to the first moving frames. The start is
    the mean over all: where a line and a parabola fit alike, its standard deviation is large. All
    is done twice, with all frames that one of the motions fits, and with half of the moving ones.
    """
    begin, stop = _frames_to_fit(t_s, along_mm, first, moved.threshold_mm)
    t, d = t_s[begin:stop], along_mm[begin:stop]
    # the noise of a tag that moves is larger than that of one at rest
    sigma_mm = moved.threshold_mm / SIGMAS
    distance = np.abs(d)
    distance[: first - begin] = 0.0
    weights = 1.0 / (1.0 + (DIFFERS * distance / sigma_mm) ** 2)
    starts_s = np.linspace(t[0], t_s[first], STEPS)
    after_s = np.maximum(t - starts_s[:, None], 0.0)

    # [P, G, N]: for each exponent, start and number of frames
    fits = [_fits(after_s**power, d, weights) for power in EXPONENTS]
    misfit = np.array([one for one, _ in fits]) / sigma_mm**2
    slope = np.array([one for _, one in fits])
    frames = np.arange(1, len(t) + 1)
    fit = misfit.min(axis=(0, 1)) <= frames + 3.0 * np.sqrt(2.0 * frames)
    still = first - begin
    fit[: still + FIT_FRAMES] = True
    # the first number of frames that no motion fits, or all of them
    most = int(np.argmin(fit)) or len(t)

    near = np.flatnonzero(np.abs(d[:still]) <= WITHIN * sigma_mm)
    last = int(near[-1]) if near.size else 0
    # [P, G]: how far each motion would have come at the last frame at rest, for a slope of 1
    came = np.array([after_s[:, last] ** power for power in EXPONENTS])
    share = np.zeros(STEPS)
    # half of the moving frames may say something else: the motion changed meanwhile
    for used in {most, min(most, still + max(FIT_FRAMES, (most - still) // 2))}:
        # a start after that frame is always possible
        is_possible = slope[..., used - 1] * came <= BEYOND * sigma_mm
        here = np.where(is_possible, misfit[..., used - 1], np.inf)
        least = float(here.min())
        # c, k and the start were fitted
        excess = (here - least) / max(1.0, least / max(used - 3, 1))
        likely = np.exp(-0.5 * excess).sum(axis=0)
        share += likely / likely.sum()
    share /= share.sum()
    start_s = float(share @ starts_s)
    return start_s, float(np.sqrt(share @ (starts_s - start_s) ** 2))


def _frames_to_fit(
    t_s: FloatArray, along_mm: FloatArray, first: int, threshold_mm: float
) -> tuple[int, int]:
    """First and last + 1 of the frames of the fit."""
    begin = int(np.searchsorted(t_s, t_s[first] - REST_S))
    is_near = along_mm <= FIT_THRESHOLDS * threshold_mm
    is_near &= t_s - t_s[first] < REST_S
    is_near[: first + FIT_FRAMES] = True
    # the first frame that is not, or the end
    stop = int(np.argmin(is_near)) or len(t_s)
    return begin, stop


def _fits(
    x: FloatArray, y: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """[G, N] weighted squared residual, and slope, of the best line in x [G, N].

    Column n is of the frames up to n. Sums of the past give all of them at once.
    """
    total = np.cumsum(weights)
    of_x, of_y = np.cumsum(weights * x, axis=1), np.cumsum(weights * y)
    square = np.cumsum(weights * x * x, axis=1) - of_x**2 / total
    both = np.cumsum(weights * x * y, axis=1) - of_x * of_y / total
    # a motion back towards the rest explains nothing
    slope = np.maximum(both, 0.0) / np.maximum(square, 1e-300)
    rest = np.cumsum(weights * y * y) - of_y**2 / total
    misfit: FloatArray = rest - slope * np.maximum(both, 0.0)
    return misfit, slope
