"""Critical points by the friction cone, what each is, and the samples around it.

OFFLINE: a point looks ahead and uses the whole recording. Two cones find them, and the first of any
0.5 s is kept:

the thesis'  first principal component over the sensors of x, of y and of z, each standardised over
             the trial; a mark where x/z or y/z jumps by more than 1 and that component moves by
             more than 2 within 0.3 s, or jumps by more than 5 and z moves by more than 2 within 0.2
             s; the largest of any 0.5 s (chapter 3.1.1 and its listing, whose 15 and 10 samples are
             at 50 Hz). z standardised crosses zero, so it is a lottery: it finds changes of grip
             because the quotient has a pole there
ours         data.critical_points.friction_rows, sensor by sensor, without a pole

What a point is comes from the set's truth and never from the sensors: the riskiest situation within
the 7 samples around it. Of those in a grasp, the ones up to 1.5 s after contact are "grasp"; later
ones are "not slipping under disturbances", for in a hold that nothing disturbs no force jumps.
Points that touch no contact are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    GRASP,
    NORMAL_AXIS,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    BoolArray,
    FloatArray,
)
from holdfast.data.critical_points import EDGE_S, friction_rows
from holdfast.data.recording import DataSet, Recording

KINDS = ("grasp", "not slipping under disturbances", "safe slip", "slipping")
HELD = 1
SLIPPING = 3
KIND_OF = {GRASP: 0, SAFE_SLIP: 2, RISKY_SLIP: SLIPPING}
"""By the riskiest situation around a point; a grasp that lasts is HELD instead."""
REACH = 3
"""Samples to either side of a point that its label looks at, as the window of the first case
does."""
GRASPING_S = 1.5
APART_S = 0.5
JUMP = 1.0
JUMP_BY_NORMAL = 5.0
MOVED = 2.0
SHEAR_AHEAD_S = 0.3
NORMAL_AHEAD_S = 0.2
UNKNOWN = -1
Rows = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Points:
    """trial [M] index into the recordings; row [M]; kind [M] index into KINDS; group [M]: never on
    both sides.

    since_onset [M]: rows from the onset of the event that a slip belongs to, nan where there is
    none.
    """

    trial: Rows
    row: Rows
    kind: Rows
    group: npt.NDArray[np.str_]
    since_onset: FloatArray

    def __len__(self) -> int:
        return len(self.row)


def points_of(data: DataSet) -> Points:
    """Every labelled point of a set, trial by trial."""
    trials, rows, kinds, groups, since = [], [], [], [], []
    for trial, recording in enumerate(data.recordings):
        for row, kind in labelled(recording):
            trials.append(trial)
            rows.append(row)
            kinds.append(kind)
            groups.append(recording.group)
            slipping = kind == SLIPPING
            since.append(_since_onset(recording, row) if slipping else np.nan)
    return Points(
        np.array(trials, dtype=np.int64),
        np.array(rows, dtype=np.int64),
        np.array(kinds, dtype=np.int64),
        np.array(groups, dtype=np.str_),
        np.array(since, dtype=np.float64),
    )


def windows(data: DataSet, points: Points, first: int, last: int) -> FloatArray:
    """[M, last - first + 1, C] samples first .. last, counted from each point (negative: before
    it)."""
    span = np.arange(first, last + 1)
    return np.stack(
        [
            data.recordings[t].samples[r + span]
            for t, r in zip(points.trial, points.row, strict=True)
        ]
    )


def labelled(recording: Recording) -> list[tuple[int, int]]:
    """(row, kind) of a recording's points."""
    situation = np.full(len(recording.samples), UNKNOWN)
    for phase in recording.phases:
        situation[phase.first : phase.stop] = phase.situation
    grasped = int(GRASPING_S * recording.rate_hz)
    found = []
    for row in cone_rows(recording.samples, recording.rate_hz).tolist():
        riskiest = situation[row - REACH : row + REACH + 1].max()
        if riskiest > NOTHING:
            kind = KIND_OF[int(riskiest)]
            before = situation[max(row - grasped, 0) : row + 1]
            if riskiest == GRASP and (before > NOTHING).all():
                kind = HELD
            found.append((row, kind))
    return found


def cone_rows(samples: FloatArray, rate_hz: float) -> Rows:
    """Rows of both cones in samples [T, C]: the first of any 0.5 s, none within 1 s of an end."""
    both = np.union1d(
        thesis_cone_rows(samples, rate_hz), friction_rows(samples, rate_hz)
    )
    return _apart(both, round(APART_S * rate_hz))


def thesis_cone_rows(samples: FloatArray, rate_hz: float) -> Rows:
    """Rows of the thesis' cone, ascending."""
    edge = round(EDGE_S * rate_hz)
    if len(samples) <= 2 * edge:
        return np.empty(0, dtype=np.int64)
    component = np.stack(
        [first_component(samples[:, axis::3]) for axis in range(3)], axis=1
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = component[:, :NORMAL_AXIS] / component[:, NORMAL_AXIS:]
        jump = np.abs(np.diff(ratio, axis=0, prepend=ratio[:1]))
    shear_moves = _moves(component[:, :NORMAL_AXIS], round(SHEAR_AHEAD_S * rate_hz))
    normal_moves = _moves(component[:, NORMAL_AXIS:], round(NORMAL_AHEAD_S * rate_hz))
    marked = (jump > JUMP) & shear_moves | (jump > JUMP_BY_NORMAL) & normal_moves
    size = np.where(marked, jump, 0.0).max(axis=1)
    rows = np.flatnonzero(size)
    rows = rows[(rows >= edge) & (rows < len(samples) - edge)]
    return np.sort(
        _apart(rows[np.argsort(-size[rows], kind="stable")], round(APART_S * rate_hz))
    )


def first_component(channels: FloatArray) -> FloatArray:
    """[T, S] -> [T] score on the first principal component of channels standardised over the trial.

    Positive where the channels are, on the whole; a channel that never changes takes no part.
    """
    spread = channels.std(axis=0)
    standard = (channels - channels.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    weights = np.linalg.svd(standard, full_matrices=False)[2][0]
    score: FloatArray = standard @ (weights * np.where(weights.sum() < 0.0, -1.0, 1.0))
    return score


def _moves(component: FloatArray, ahead: int) -> BoolArray:
    """[T, A] whether a component is elsewhere so many rows later; the last rows look at the end."""
    later = np.minimum(np.arange(len(component)) + ahead, len(component) - 1)
    return np.abs(component[later] - component) > MOVED


def _apart(rows: Rows, apart: int) -> Rows:
    """Rows kept in the order given, none so near to one that is kept already."""
    kept: list[int] = []
    for row in rows.tolist():
        if all(abs(row - other) > apart for other in kept):
            kept.append(row)
    return np.array(kept, dtype=np.int64)


def _since_onset(recording: Recording, row: int) -> float:
    """Rows since the onset of the last event before the label's reach ended; nan without one."""
    onsets = [event.onset_s * recording.rate_hz for event in recording.events]
    before = [onset for onset in onsets if onset <= row + REACH]
    return row - max(before) if before else np.nan
