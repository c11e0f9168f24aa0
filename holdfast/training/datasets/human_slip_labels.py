"""The labels of human_slip_uskin: situations from the rotation of the object, no model input.

Per trial, with x the 48 channels, e the middle angle of the object quaternion's xyx decomposition
in degrees (the authors' own measure of slip), s and t the rows where the move starts and ends::

    bias       xb = x - median(x[0:60])
    contact    z = sum of the 16 normals of xb, z >= 1 N
    reference  r = median(e[max(0, s-30) : s-3])
    rotation   d = |e - r|
    situation  z < 1 nothing; d < 5 grasp; 5 <= d < 15 safe_slip; d >= 15 risky_slip

Contact always uses all 16 normals, so the labels do not depend on the channels a model gets.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    GRASP,
    NORMAL_AXIS,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    FloatArray,
    IntArray,
)
from holdfast.training.datasets.public_files import UNLABELLED, TrialRows
from holdfast.training.timeline import Phase, Phases, RiskyEvent, RiskyEvents

BIAS_ROWS = 60
"""Rows of the tare at the start of a trial, about one second."""
CONTACT_N = 1.0
"""Sum of all normal forces from which the hand touches, N."""
SAFE_DEG = 5.0
"""Rotation from which the object slips."""
RISKY_DEG = 15.0
"""Rotation from which the slip is risky."""
WINDOW_ROWS = 6
"""0.10 s at the set's 58.9 Hz."""
SITUATION_STEP_ROWS = 6
PREDICTION_STEP_ROWS = 3
AROUND_MOVE_ROWS = 60
"""Situations go on for this long after the move; predictions start this long before it."""
HORIZON_ROWS = 15
"""0.25 s at the set's 58.9 Hz."""


def contact_force_n(prepared: FloatArray) -> FloatArray:
    """[T, 48] prepared -> z [T], the summed normal force in N."""
    # inf - inf: not finite, hence no label, and no reason to warn
    with np.errstate(invalid="ignore"):
        return prepared[:, NORMAL_AXIS::3].sum(axis=1)


def middle_angle_deg(quaternion: npt.NDArray[np.floating]) -> FloatArray:
    """[T, 4] quaternions (w, x, y, z) -> [T] middle angle of the xyx Euler decomposition, degrees.

    The closed form of scipy's `Rotation.from_quat([x, y, z, w]).as_euler("xyx")[1]`: R_xx =
    cos(angle), hence angle = 2 atan2(|(y, z)|, |(w, x)|). It needs no unit norm and has no gimbal
    lock; a zero or non-finite quaternion is no rotation and gives nan.

    >>> middle_angle_deg(np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]]))
    array([  0., 180.,  nan])
    """
    w, x, y, z = quaternion.astype(np.float64).T
    across = np.hypot(y, z)
    along = np.hypot(w, x)
    angle_deg = np.degrees(2.0 * np.arctan2(across, along))

    # atan2(0, 0) is 0, which would pass for "not turned".
    norm = np.hypot(along, across)
    is_rotation = np.isfinite(norm) & (norm > 0.0)
    return np.where(is_rotation, angle_deg, np.nan)


def rotation_from_start_deg(angle_deg: FloatArray, start: int) -> FloatArray:
    """d [T]: rotation away from the angle just before the move; nan where the IMU gave none."""
    # Three rows before the move are left out, and rows without an angle cannot be a reference.
    before = angle_deg[max(0, start - 30) : start - 3]
    known = before[np.isfinite(before)]
    reference = np.median(known) if known.size else np.nan
    return np.abs(angle_deg - reference)


def situations(force_n: FloatArray, rotation_deg: FloatArray) -> IntArray:
    """[T] situation at every row, UNLABELLED where force or rotation is not finite."""
    # The first condition that holds counts; a rotation of nan fulfils none.
    conditions = [
        rotation_deg < SAFE_DEG,
        rotation_deg < RISKY_DEG,
        rotation_deg >= RISKY_DEG,
    ]
    label = np.select(conditions, [GRASP, SAFE_SLIP, RISKY_SLIP], default=UNLABELLED)

    # Without contact there is no slip, whatever the object does.
    label = np.where(force_n < CONTACT_N, NOTHING, label)
    return np.where(np.isfinite(force_n), label, UNLABELLED)


def phases(force_n: FloatArray, rotation_deg: FloatArray, end: int) -> Phases:
    """Runs of one situation, from the tare to 60 rows after the move.

    Rows without a label are in none.
    """
    # Up to where situation_windows go.
    label = situations(force_n, rotation_deg)[: end + AROUND_MOVE_ROWS]
    label[:BIAS_ROWS] = UNLABELLED

    edges = np.flatnonzero(np.diff(label)) + 1
    rows = [0, *edges.tolist(), len(label)]

    runs = []
    for first, stop in pairwise(rows):
        if label[first] != UNLABELLED:
            runs.append(Phase(first, stop, int(label[first])))
    return tuple(runs)


def events(found: Phases, rate_hz: float) -> RiskyEvents:
    """Slips that become risky: onset at 5 deg, gross slip at 15 deg, end below 5 deg.

    Load onset was not recorded; the onset here is the object's, which is later.
    """
    result = []
    onset = gross = None
    for phase, following in zip(found, (*found[1:], None), strict=True):
        if phase.situation not in (SAFE_SLIP, RISKY_SLIP):
            continue
        if onset is None:
            onset = phase.first
        if gross is None and phase.situation == RISKY_SLIP:
            gross = phase.first

        # Rows without a label between two phases end the slip too.
        slips_on = (
            following is not None
            and following.first == phase.stop
            and following.situation in (SAFE_SLIP, RISKY_SLIP)
        )
        if not slips_on:
            if gross is not None:
                stop_s = phase.stop / rate_hz
                result.append(RiskyEvent(onset / rate_hz, gross / rate_hz, stop_s))
            onset = gross = None
    return tuple(result)


def situation_windows(
    force_n: FloatArray, rotation_deg: FloatArray, end: int
) -> TrialRows:
    """Adjacent windows of 6 rows, labelled by their last row, up to 60 rows after the move."""
    stop = min(len(force_n), end + AROUND_MOVE_ROWS)
    row = _last_rows(BIAS_ROWS, stop, SITUATION_STEP_ROWS)
    label = situations(force_n, rotation_deg)[row]
    is_labelled = label != UNLABELLED
    return row[is_labelled], label[is_labelled]


def prediction_windows(
    force_n: FloatArray, rotation_deg: FloatArray, start: int, end: int
) -> TrialRows:
    """Grasp rows around the move: 1 where the rotation exceeds 15 deg within the next 15 rows."""
    n = len(force_n)
    first = max(BIAS_ROWS, start - AROUND_MOVE_ROWS)
    row = _last_rows(first, min(end, n), PREDICTION_STEP_ROWS)

    # Only a hand that holds and does not slip yet can be warned; the future must be recorded.
    touches = force_n[row] >= CONTACT_N
    holds = touches & (rotation_deg[row] < SAFE_DEG)
    has_future = row + 1 < n
    row = row[has_future & holds]

    # Rows over 15 deg so far: more at the end of the horizon than at its start means a slip.
    is_over = rotation_deg > RISKY_DEG
    over = np.concatenate([[0], np.cumsum(is_over)])
    horizon = np.minimum(row + 1 + HORIZON_ROWS, n)
    return row, over[horizon] > over[row + 1]


def _last_rows(first: int, stop: int, step: int) -> IntArray:
    """Last rows of the windows that begin at first, first + step, .. and end before stop."""
    begins = np.arange(first, stop - WINDOW_ROWS + 1, step, dtype=np.int64)
    return begins + WINDOW_ROWS - 1
