"""When an object began to slip in the hand, from the corners of two printed tags in a camera's
frames: numpy only.

One tag sits on the object, one on the hand. The object is placed in the hand tag's own axes, in mm
of the printed side, so that a hand that moves, turns or comes nearer moves nothing. What is found
is a time that no tactile sample had a say in. Three times are told apart:

start  where a quadratic, fitted to the first frames that moved, leaves the level of rest (with its
standard deviation)
seen   the first of three frames in a row beyond max(5 sigma, 0.15 px). It is late by sqrt(2 threshold / acceleration),
       20 to 100 ms, which would make lead times look longer than they are
gross  a fixed distance in mm, set above what soft pads give without any slip

A soft pad lets the object move before anything slips. So a motion counts only if it reaches the
gross distance, and that distance is measured on trials that load the grip and do not slip
(`gross_distance_mm`). Where a tag is hidden there is a gap, and what happens in it has no time.
Sliding of parts of the contact cannot be seen from outside.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from edge_runtime.contract import FloatArray
from edge_runtime.errors import LabelError, TagError

SIGMAS, FLOOR_PX = 5.0, 0.15
IN_A_ROW = 3
REST_S, REST_FRAMES = 0.3, 5
"""An object rests when all frames of so long, and at least so many, stay within the threshold of
their median."""
LONGEST_STEP = 2.5
"""Seen frames further apart than so many periods have a gap between them."""
FIT_FRAMES, FIT_THRESHOLDS = 4, 20.0
"""The start is fitted to the rest, so many moving frames, and further ones up to so many thresholds
away: after that the acceleration is no longer the first."""
STEPS = 400
DIFFER = 0.05
"""Two tags of one printed size, in one plane and facing the camera, have sides that differ by
less."""
GROSS_MM = 2.0
ABOVE_SHEAR = 1.5
"""Gross slip begins at so many times the largest motion of a grip that held."""


@dataclass(frozen=True)
class Motion:
    """The object in the hand: t_s [K], place_mm [K, 2] (nan where a tag is hidden), and the scale
    at the hand's tag."""

    t_s: FloatArray
    place_mm: FloatArray
    mm_per_px: float

    @property
    def seen(self) -> int:
        """Frames that show both tags."""
        return int(np.isfinite(self.place_mm[:, 0]).sum())

    @property
    def sigma_mm(self) -> float:
        """Noise of one axis: from the median step between frames, which a slip of a few frames does
        not move."""
        steps = np.diff(self.place_mm[np.isfinite(self.place_mm[:, 0])], axis=0)
        return float(1.4826 * np.median(np.abs(steps)) / np.sqrt(2.0)) if len(steps) else 0.0

    @property
    def threshold_mm(self) -> float:
        """Further from rest than this an object has moved."""
        return max(SIGMAS * self.sigma_mm, FLOOR_PX * self.mm_per_px)

    def between(self, from_s: float, until_s: float) -> Motion:
        """The part of it in [from_s, until_s]."""
        part = (self.t_s >= from_s) & (self.t_s <= until_s)
        return Motion(self.t_s[part], self.place_mm[part], self.mm_per_px)


@dataclass(frozen=True)
class Slip:
    """One slip, times in s as the frames have them; start_sd_s of the fit, frame_s the longest step
    beside it."""

    start_s: float
    start_sd_s: float
    seen_s: float
    gross_s: float
    end_s: float
    frame_s: float

    @property
    def uncertainty_s(self) -> float:
        """Standard deviation of the start: the fit's, and that of a frame period."""
        return float(np.hypot(self.start_sd_s, self.frame_s / np.sqrt(12.0)))


@dataclass(frozen=True)
class Hidden:
    """The object moved, and a tag was hidden just then: nobody knows when it slipped, or
    whether."""

    from_s: float
    to_s: float


def motion(
    t_s: FloatArray,
    object_px: FloatArray,
    hand_px: FloatArray,
    tag_mm: float,
    apart_mm: float | None = None,
) -> Motion:
    """Object in the hand's axes; corners [K, 4, 2] of both tags (column, row; clockwise from top
    left), nan if hidden.

    tag_mm: the printed side, margin not counted, the same for both. apart_mm: between the tags'
    centres at the first frames, if somebody measured it. Raises TagError where the tags contradict
    that or each other, LabelError where they are never seen together.
    """
    both = np.isfinite(np.concatenate([object_px, hand_px], axis=1).reshape(len(t_s), -1)).all(
        axis=1
    )
    if both.sum() < REST_FRAMES:
        raise LabelError(
            f"both tags are seen in {both.sum()} of {len(both)} frames",
            cause="out of the picture, covered, out of focus, or without their white margin",
            next_step="look at the video; print tags 0 (object) and 1 (hand) of the family 36h11",
        )
    _require_one_size(object_px[both], hand_px[both], tag_mm)
    square = tag_mm * np.array([-0.5 - 0.5j, 0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j])
    hand, thing = (
        corners[both, :, 0] + 1j * corners[both, :, 1] for corners in (hand_px, object_px)
    )
    about = hand - hand.mean(axis=1, keepdims=True)
    turn = (about.conj() * square).sum(axis=1) / (np.abs(about) ** 2).sum(axis=1)
    place = turn * (thing.mean(axis=1) - hand.mean(axis=1))
    _require_apart(np.abs(place[:REST_FRAMES]), apart_mm, tag_mm)
    place_mm = np.full((len(t_s), 2), np.nan)
    place_mm[both] = np.stack([place.real, place.imag], axis=1)
    return Motion(t_s, place_mm, float(np.median(np.abs(turn))))


def sides_px(corners_px: FloatArray) -> FloatArray:
    """Median (width, height) of a tag [K, 4, 2] in px."""
    sides = np.linalg.norm(np.roll(corners_px, -1, axis=1) - corners_px, axis=2)
    return np.array([np.median(sides[:, ::2]), np.median(sides[:, 1::2])])


def _require_one_size(object_px: FloatArray, hand_px: FloatArray, tag_mm: float) -> None:
    thing, hand = sides_px(object_px), sides_px(hand_px)
    for name, side in (("object", thing), ("hand", hand)):
        if abs(side[0] / side[1] - 1.0) > DIFFER:
            raise TagError(
                f"the {name}'s tag is {side[0]:.1f} px wide and {side[1]:.1f} px high: not a square",
                cause="a tag that does not face the camera, or a printer that scales one way",
                next_step="turn the tag to the camera; measure both its sides",
            )
    share = float(thing.mean() / hand.mean())
    if abs(share - 1.0) > DIFFER:
        raise TagError(
            f"if the hand's tag is {tag_mm:g} mm, the object's is {tag_mm * share:.2f} mm",
            cause="tags printed in two sizes, or one nearer to the camera than the other",
            next_step="measure both printed sides, and put the tags in one plane before the camera",
        )


def _require_apart(distance_mm: FloatArray, apart_mm: float | None, tag_mm: float) -> None:
    found_mm = float(np.median(distance_mm))
    if apart_mm is not None and abs(found_mm / apart_mm - 1.0) > DIFFER:
        raise TagError(
            f"the tags are {apart_mm:g} mm apart, and {found_mm:.2f} mm if their side is {tag_mm:g} mm",
            cause=f"tags printed at {100.0 * apart_mm / found_mm:.0f} % of that size",
            next_step="measure the printed side and give it as --tag-mm",
        )


def find_slip(moved: Motion, gross_mm: float = GROSS_MM) -> Slip | Hidden | None:
    """The first motion from rest that reaches gross_mm; None where nothing slips. Raises LabelError
    without a rest."""
    track = _Track(moved)
    for level_mm, first, stop in track.departures():
        away_mm = np.linalg.norm(track.place_mm[first:stop] - level_mm, axis=1)
        far = np.flatnonzero(away_mm >= gross_mm)
        if not far.size:
            continue
        gross = first + int(far[0])
        before = max(first - 1, 0)
        gaps = before + np.flatnonzero(np.diff(track.t_s[before : gross + 1]) > track.longest_s)
        if gaps.size:
            return Hidden(float(track.t_s[gaps[0]]), track.next_seen_s(int(gaps[0])))
        return _slip(track, level_mm, first, gross, stop, gross_mm)
    return track.hidden_while_away()


def largest_move_mm(moved: Motion) -> float:
    """How far the object ever went from where it last rested: the elastic shear, in a trial that
    loads and holds."""
    track = _Track(moved)
    largest_mm = 0.0
    for level_mm, first, stop in track.departures():
        away_mm = np.linalg.norm(track.place_mm[first:stop] - level_mm, axis=1)
        largest_mm = max(largest_mm, float(away_mm.max(initial=0.0)))
    return largest_mm


def gross_distance_mm(no_slip: Sequence[Motion]) -> float:
    """A gross distance above the elastic shear of trials that were loaded and did not slip, and no
    less than 2 mm."""
    return max(GROSS_MM, ABOVE_SHEAR * max((largest_move_mm(one) for one in no_slip), default=0.0))


class _Track:
    """The frames that show both tags: t_s [N], place_mm [N, 2]; and when the recording ended."""

    def __init__(self, moved: Motion) -> None:
        seen = np.isfinite(moved.place_mm).all(axis=1)
        self.t_s, self.place_mm, self.threshold_mm = (
            moved.t_s[seen],
            moved.place_mm[seen],
            moved.threshold_mm,
        )
        self.sigma_mm, self.end_s = moved.sigma_mm, float(moved.t_s[-1]) if len(moved.t_s) else 0.0
        self.longest_s = (
            LONGEST_STEP * float(np.median(np.diff(moved.t_s))) if len(moved.t_s) > 1 else 0.0
        )

    def rest(self, first: int) -> tuple[FloatArray, int] | None:
        """Level [2] of the first rest from a frame on, and the first frame after it."""
        for start in range(first, len(self.t_s)):
            stop = max(
                int(np.searchsorted(self.t_s, self.t_s[start] + REST_S)) + 1, start + REST_FRAMES
            )
            if stop > len(self.t_s):
                return None
            level_mm = np.median(self.place_mm[start:stop], axis=0)
            if not self._away(start, level_mm)[: stop - start].any():
                return level_mm, stop
        return None

    def no_rest(self) -> tuple[FloatArray, int]:
        """Say that the object never rests."""
        raise LabelError(
            f"object and hand never rest beside each other for {REST_S:g} s",
            cause="tags hidden, or the object moves from end to end",
            next_step="hold still before the action; --from and --until choose a part of the trial",
        )

    def departures(self) -> Iterator[tuple[FloatArray, int, int]]:
        """(level, first frame away for three in a row, first frame after the next rest began or the
        end)."""
        level_mm, after = self.rest(0) or self.no_rest()
        while (first := self._departs(after, level_mm)) is not None:
            again = self.rest(first)
            if again is None:
                yield level_mm, first, len(self.t_s)
                return
            yield level_mm, first, again[1]
            level_mm, after = again

    def _away(self, first: int, level_mm: FloatArray) -> FloatArray:
        away: FloatArray = (
            np.linalg.norm(self.place_mm[first:] - level_mm, axis=1) > self.threshold_mm
        )
        return away

    def _departs(self, first: int, level_mm: FloatArray) -> int | None:
        away = self._away(first, level_mm)
        rows = len(away) - IN_A_ROW + 1
        found = (
            np.flatnonzero(np.all([away[k : k + rows] for k in range(IN_A_ROW)], axis=0))
            if rows > 0
            else away[:0]
        )
        return first + int(found[0]) if found.size else None

    def lost_after(self, row: int) -> bool:
        """Whether a gap, or the end of what is seen, follows a frame."""
        return self.next_seen_s(row) - float(self.t_s[row]) > self.longest_s

    def next_seen_s(self, row: int) -> float:
        """When both tags are seen again after a frame; the recording's end, if never."""
        return float(self.t_s[row + 1]) if row + 1 < len(self.t_s) else self.end_s

    def hidden_while_away(self) -> Hidden | None:
        """The gap at the end of what is seen, if the object was leaving its rest then."""
        level_mm, after = self.rest(0) or self.no_rest()
        while (again := self.rest(after)) is not None:
            level_mm, after = again
        last = len(self.t_s) - 1
        if self.lost_after(last) and self._away(last, level_mm)[0]:
            return Hidden(float(self.t_s[last]), self.end_s)
        return None


def _slip(
    track: _Track, level_mm: FloatArray, first: int, gross: int, stop: int, gross_mm: float
) -> Slip:
    t_s, offset_mm = track.t_s, track.place_mm - level_mm
    along_mm = offset_mm @ (offset_mm[gross] / np.linalg.norm(offset_mm[gross]))
    start_s, start_sd_s = fitted_start(t_s, along_mm, first, track.threshold_mm, track.sigma_mm)
    away_mm = np.linalg.norm(offset_mm[gross - 1 : gross + 1], axis=1)
    gross_s = float(np.interp(np.sqrt(gross_mm), np.sqrt(away_mm), t_s[gross - 1 : gross + 1]))
    gaps = gross + np.flatnonzero(np.diff(t_s[gross:stop]) > track.longest_s)
    end_s = float(t_s[gaps[0]] if gaps.size else t_s[stop - 1])
    if not gaps.size and stop < len(t_s):
        end_s = max(gross_s, end_s - REST_S)
    return Slip(
        start_s=start_s,
        start_sd_s=start_sd_s,
        seen_s=float(t_s[first]),
        gross_s=gross_s,
        end_s=end_s,
        frame_s=float(np.diff(t_s[max(first - 1, 0) : gross + 1]).max()),
    )


def fitted_start(
    t_s: FloatArray, along_mm: FloatArray, first: int, threshold_mm: float, sigma_mm: float
) -> tuple[float, float]:
    """Start of c + k (t - start)^2, 0 before it, by least squares, and its standard deviation, s.

    first: the first frame beyond the threshold; the fit runs over the rest before it and the first
    frames after. The start is searched on a grid, finer round the best, because the model has a
    corner there; its deviation comes from the model's slopes and the larger of residuals and noise.
    """
    stop = min(first + FIT_FRAMES, len(t_s))
    while (
        stop < len(t_s)
        and along_mm[stop] <= FIT_THRESHOLDS * threshold_mm
        and t_s[stop] - t_s[first] < REST_S
    ):
        stop += 1
    begin = int(np.searchsorted(t_s, t_s[first] - REST_S))
    t, d = t_s[begin:stop], along_mm[begin:stop]
    low, high = t_s[begin], t_s[first]
    for _ in range(2):
        grid = np.linspace(low, high, STEPS)
        best = int(np.argmin(_misfit(t, d, grid)))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, STEPS - 1)]
    start_s = float(grid[best])
    since = np.maximum(t - start_s, 0.0)
    known = np.stack([np.ones_like(since), since**2], axis=1)
    solved = np.linalg.lstsq(known, d, rcond=None)[0]
    left = d - known @ solved
    slopes = np.column_stack([known, -2.0 * solved[1] * since])
    noise_mm = max(sigma_mm, float(np.sqrt(left @ left / max(len(t) - 3, 1))))
    spread = np.linalg.pinv(slopes.T @ slopes)
    return start_s, noise_mm * float(np.sqrt(max(spread[2, 2], 0.0)))


def _misfit(t: FloatArray, d: FloatArray, starts: FloatArray) -> FloatArray:
    """[G] squares left over by the best line in (t - start)^2, for every start."""
    x = np.maximum(t - starts[:, None], 0.0) ** 2
    x -= x.mean(axis=1, keepdims=True)
    y = d - d.mean()
    bent, square = x @ y, (x * x).sum(axis=1)
    misfit: FloatArray = y @ y - np.where(
        (bent > 0.0) & (square > 0.0), bent, 0.0
    ) ** 2 / np.maximum(square, 1e-300)
    return misfit
