"""Reader of human_slip_uskin: people pinch a book-shaped object between uSkin and move it fast.

K. Nazari et al., "Bioinspired trajectory modulation for effective slip control in robot
manipulation", Nature Machine Intelligence (2025), doi 10.1038/s42256-025-01062-2. No licence is
stated: evaluate locally, redistribute nothing. Any folder with the same two files can be read, also
of other people.

The labels are situations from the rotation of the object, no model input. Per trial, with x the 48
channels, e the middle angle of the object quaternion's xyx decomposition in degrees (the authors'
own measure of slip), s and t the rows where the move starts and ends::

    bias       xb = x - median(x[0:60])
    contact    z = sum of the 16 normals of xb, z >= 1 N
    reference  r = median(e[max(0, s-30) : s-3])
    rotation   d = |e - r|
    situation  z < 1 nothing; d < 5 grasp; 5 <= d < 15 safe_slip; d >= 15 risky_slip

Contact always uses all 16 normals, so the labels do not depend on the channels a model gets.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    GRASP,
    NORMAL_AXIS,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    FloatArray,
    IntArray,
)
from holdfast.core.errors import EmptyRecording
from holdfast.core.hand_card import read_hand_card
from holdfast.data.datasets.public_files import (
    UNLABELLED,
    TrialRows,
    channels_of,
    join_trials,
    read_arrays,
)
from holdfast.data.datasets.trials import require_offered
from holdfast.data.recording import DataSet, Recording, finite_sensors
from holdfast.data.timeline import Phase, Phases, RiskyEvent, RiskyEvents
from holdfast.edge_runtime.preparation import Preparation

SIGNALS, TRIALS = "signals.npz", "trials.csv"
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
PREPARATION = Preparation(bias_rows=BIAS_ROWS, statistic="median")
COLUMNS = {
    "subject": str,
    "stage": str,
    "sample": str,
    "n": int,
    "frequency_hz": float,
    "start_index": int,
    "end_index": int,
    "offset": int,
}
"""Of trials.csv; others are ignored."""
N_TAXELS = 16
"""3-axis taxels of the set's uSkin, hence 48 channels; counted from 1, row by row."""
SPREAD_TAXELS = (2, 5, 8, 11, 13, 16)
"""Six that lie apart, no two of them neighbours: the farthest-point spread of the 4 x 4 pad from
taxel 2 on, a rule that sees no reading (T. F. Gonzalez, "Clustering to minimize the maximum
intercluster distance", 1985). On people they are the best of what was tried."""
MOST_LOADED_TAXELS = (5, 9, 10, 11, 12, 13)
HAND_CARDS: dict[tuple[int, ...], str] = {
    SPREAD_TAXELS: "pinch-pad-spread",
    MOST_LOADED_TAXELS: "pinch-pad",
}
"""The hand card with these taxels; all 16 have none, because a card holds 12 sensors at most."""
CAVEAT = (
    "The label is the rotation of the object, about half of it the wrist's (R2 0.53 with hand "
    "tilt); 'safe slip' here is an involuntary rotation of 5-15 deg, not a voluntary release; the "
    "set is scripted: timing only (frames since contact and summed force) does better than a raw "
    "forest."
)


def is_ours(root: Path) -> bool:
    """Whether one of its two files is there."""
    return (root / SIGNALS).is_file() or (root / TRIALS).is_file()


def load(
    root: Path, *, channels: int = 18, six: tuple[int, ...] = SPREAD_TAXELS
) -> DataSet:
    """Read and label a folder in this format, 18 channels (six taxels) or all 48, unit N.

    Tasks: "situations" (0..3) and "predict_250ms" (0/1: over 15 deg within 0.25 s, from grasp
    rows). Unusable trials (not 60 < start < end <= n) are left out and counted in notes. Columns of
    trials.csv beyond the set's own are ignored: they describe trials and are read by name.

    Raises ChannelError or EmptyRecording.
    """
    import pandas as pd  # a third of a second, which sets in other formats do not need

    offered = {18: [taxel - 1 for taxel in six], 48: range(N_TAXELS)}
    require_offered(root, channels, offered)
    columns = channels_of(offered[channels])
    xela, imu = read_arrays(root / SIGNALS, "xela", "object_imu")
    # As texts first, since pandas' own reader rounds some decimals differently in the last bit.
    texts = pd.read_csv(root / TRIALS, dtype=str)
    table = texts[list(COLUMNS)].astype(COLUMNS)

    angle_deg = middle_angle_deg(imu[:, :4])
    recordings, windows, predictions = [], [], []
    for move in table.itertuples():
        start, end = move.start_index, move.end_index
        # The hold before the move and after it must be recorded.
        if not BIAS_ROWS < start < end <= move.n:
            continue
        rows = slice(move.offset, move.offset + move.n)
        raw = xela[rows].astype(np.float64)
        prepared = PREPARATION.apply(raw)
        # Contact is judged on all 48 channels, so that labels do not depend on the taxels.
        force_n = contact_force_n(prepared)
        turned_deg = rotation_from_start_deg(angle_deg[rows], start)
        found = phases(force_n, turned_deg, end)
        recording = Recording(
            trial_id=f"{move.subject}/{move.stage}/{move.sample}",
            group=move.subject,
            samples=prepared[:, columns],
            valid=finite_sensors(raw[:, columns]),
            rate_hz=move.frequency_hz,
            unit="N",
            object_name="book",
            action=move.stage,
            phases=found,
            events=events(found, move.frequency_hz),
            person=move.subject,
        )
        recordings.append(recording)
        windows.append(situation_windows(force_n, turned_deg, end))
        ahead = prediction_windows(force_n, turned_deg, start, end)
        predictions.append(ahead)
    if not recordings:
        what = "no trial with 60 < start_index < end_index <= n: no usable trial"
        raise EmptyRecording(what, where=root, next_step="check these in trials.csv")

    return DataSet(
        name="human_slip_uskin",
        recordings=recordings,
        tasks={
            "situations": join_trials(windows, SITUATIONS),
            "predict_250ms": join_trials(predictions, ("no", "yes")),
        },
        rate_hz=float(np.median([recording.rate_hz for recording in recordings])),
        unit="N",
        preparation=PREPARATION,
        kind="real, recorded by others: people pinch-holding one object",
        forces_verified=False,
        redistributable=False,
        caveat=CAVEAT,
        group_kind="person",
        hand=read_hand_card(HAND_CARDS[six]) if channels == 18 else None,
        notes={"unusable_trials": len(table) - len(recordings)},
    )


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
    label = GRASP + np.digitize(rotation_deg, [SAFE_DEG, RISKY_DEG])
    label = np.where(np.isnan(rotation_deg), UNLABELLED, label)

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
    slips = [phase for phase in found if phase.situation in (SAFE_SLIP, RISKY_SLIP)]
    # Rows without a label between two phases end a slip, as rows of another situation do.
    runs: list[list[Phase]] = []
    for phase in slips:
        if runs and runs[-1][-1].stop == phase.first:
            runs[-1].append(phase)
        else:
            runs.append([phase])

    result = []
    for run in runs:
        risky = [phase for phase in run if phase.situation == RISKY_SLIP]
        if risky:
            rows = np.array([run[0].first, risky[0].first, run[-1].stop])
            result.append(RiskyEvent(*(rows / rate_hz).tolist()))
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
