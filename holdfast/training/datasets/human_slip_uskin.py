"""Reader of human_slip_uskin: people pinch a book-shaped object between uSkin and move it fast.

K. Nazari et al., "Bioinspired trajectory modulation for effective slip control in robot
manipulation", Nature Machine Intelligence (2025), doi 10.1038/s42256-025-01062-2. No licence is
stated: evaluate locally, redistribute nothing. Any folder with the same two files can be read, also
of other people.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.core.contract import SITUATIONS, FloatArray, IntArray
from holdfast.core.errors import ChannelError, ColumnError, EmptyRecording, NotANumber
from holdfast.core.hand_card import HandCard, read_hand_card
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.datasets import human_slip_labels as labels
from holdfast.training.datasets.public_files import (
    COPY_AGAIN,
    Arrays,
    Shape,
    Table,
    channels_of,
    join_trials,
    read_arrays,
    read_table,
)
from holdfast.training.datasets.trials import ChannelsNotOffered
from holdfast.training.recording import DataSet, LabelledRows, Recording, finite_sensors

SIGNALS, TRIALS = "signals.npz", "trials.csv"
PREPARATION = Preparation(bias_rows=labels.BIAS_ROWS, statistic="median")
COLUMNS = (
    "subject",
    "stage",
    "sample",
    "n",
    "frequency_hz",
    "start_index",
    "end_index",
    "offset",
)
"""Of trials.csv; others are ignored."""
N_TAXELS, PAD_COLUMNS = 16, 4
"""3-axis taxels of the set's uSkin, hence 48 channels; they are counted row by row."""
SIX_TAXELS = (5, 9, 10, 11, 12, 13)
"""The 18-channel case, counted from 1 as the set's own column names do: the most loaded."""
SIX_TAXELS_CARD = "pinch-pad"
"""The hand card with these taxels."""
FIRST_SPREAD_TAXEL = 2
"""Where the spread begins: any taxel of the upper edge but a corner (docs/wiring.md)."""
SPREAD_TAXELS_CARD = "pinch-pad-spread"
"""The hand card with six taxels that `spread_taxels` gives, whatever they bear."""
CAVEAT = (
    "The label is the rotation of the object, about half of it the wrist's (R2 0.53 with hand "
    "tilt); 'safe slip' here is an involuntary rotation of 5-15 deg, not a voluntary release; the "
    "set is scripted: timing only (frames since contact and summed force) does better than a raw "
    "forest."
)


@dataclass(frozen=True)
class _Move:
    """One row of trials.csv: rows of the signals, and start and end of the movement within them."""

    name: str
    subject: str
    stage: str
    rows: slice
    rate_hz: float
    start: int
    end: int

    @property
    def usable(self) -> bool:
        """A tare before the move, a move after it, and all of it recorded."""
        n_rows = self.rows.stop - self.rows.start
        return labels.BIAS_ROWS < self.start < self.end <= n_rows


def spread_taxels(count: int) -> tuple[int, ...]:
    """So many taxels of the 4 x 4 pad, counted from 1, spread by a rule that sees no reading.

    The rule is the farthest-point spread (T. F. Gonzalez, "Clustering to minimize the maximum
    intercluster distance", 1985): begin with one taxel, then always add the one that is farthest
    from all that are chosen. Of equally far ones it adds the last.

    >>> spread_taxels(6)
    (2, 5, 8, 11, 13, 16)
    """
    row, column = np.divmod(np.arange(N_TAXELS), PAD_COLUMNS)
    chosen = [FIRST_SPREAD_TAXEL - 1]

    while len(chosen) < count:
        # squares of whole numbers, so that equal distances compare as equal
        down = row[:, None] - row[chosen]
        right = column[:, None] - column[chosen]
        squares = down**2 + right**2

        # a taxel is as far as the nearest chosen one; those that are chosen have 0
        nearest = squares.min(axis=1)
        farthest = np.flatnonzero(nearest == nearest.max())
        chosen.append(int(farthest[-1]))

    return tuple(taxel + 1 for taxel in sorted(chosen))


def load(
    root: Path, *, channels: int = 18, in_hand: bool = False, spread: bool = False
) -> DataSet:
    """Read and label a folder in this format, 18 channels (six taxels) or all 48, unit N.

    spread: of 18 channels, six taxels spread over the pad instead of the six most loaded. in_hand:
    label by the object's rotation in the hand (both IMUs), without the wrist's part. The set's
    usual measure is the rotation of the object alone.

    Tasks: "situations" (0..3) and "predict_250ms" (0/1: over 15 deg within 0.25 s, from grasp
    rows). Unusable trials (not 60 < start < end <= n) are left out and counted in notes. Columns of
    trials.csv beyond the set's own are ignored: they describe trials and are read by name.

    Raises DataNotFound, ColumnError, NotANumber, ChannelError or EmptyRecording.
    """
    columns = _columns(channels, spread)
    wanted: dict[str, Shape] = {
        "xela": (None, 48),
        "object_imu": (None, 7),
        "offset": (None,),
    }
    if in_hand:
        wanted["hand_imu"] = (None, 7)
    arrays = read_arrays(root / SIGNALS, wanted)
    moves = list(_moves(read_table(root / TRIALS), arrays))
    usable = _usable(moves, root)

    orientation = arrays["object_imu"][:, :4]
    if in_hand:
        orientation = labels.in_hand(orientation, arrays["hand_imu"][:, :4])
    angle_deg = labels.middle_angle_deg(orientation)
    recordings, situations, predictions = [], [], []
    for move in usable:
        raw = arrays["xela"][move.rows].astype(np.float64)
        force_n = labels.contact_force_n(PREPARATION.apply(raw))
        rotation_deg = labels.rotation_from_start_deg(angle_deg[move.rows], move.start)

        # Contact is judged on all 48 channels, so that labels are the same for 18 channels and for
        # 48.
        phases = labels.phases(force_n, rotation_deg, move.end)
        events = labels.events(phases, move.rate_hz)
        recording = _recording(move, raw, columns)
        recordings.append(replace(recording, phases=phases, events=events))
        situations.append(labels.situation_windows(force_n, rotation_deg, move.end))
        predictions.append(
            labels.prediction_windows(force_n, rotation_deg, move.start, move.end)
        )
    return DataSet(
        name="human_slip_uskin",
        recordings=recordings,
        tasks={
            "situations": join_trials(situations, SITUATIONS),
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
        hand=_hand(channels, spread),
        notes={"unusable_trials": len(moves) - len(usable)},
    )


def _usable(moves: list[_Move], root: Path) -> list[_Move]:
    """The moves with a hold before and after them. Raises EmptyRecording where there is none."""
    usable = [move for move in moves if move.usable]
    if not usable:
        raise EmptyRecording(
            "no usable trial",
            where=root,
            cause="no trial with 60 < start_index < end_index <= n",
            next_step="check start_index and end_index in trials.csv",
        )
    return usable


def clock_features(data: DataSet, rows: LabelledRows) -> FloatArray:
    """[M, 2]: frames since contact and normal force z in N, at each window.

    Contact: the last rise of z through 1 N; -1 before any.

    Input of the timing-only baseline, of no model. `data` must hold all 48 channels, because z
    sums all 16 normals; `rows` may come from the 18-channel set, whose windows are the same. Raises
    ChannelError.
    """
    if data.n_sensors != N_TAXELS:
        raise ChannelError(
            f"the timing-only baseline needs all {3 * N_TAXELS} channels, not {3 * data.n_sensors}",
            next_step=f"load the set with channels={3 * N_TAXELS}",
        )

    features = np.empty((len(rows), 2))
    for trial in np.unique(rows.trial):
        here = rows.trial == trial
        force_n = labels.contact_force_n(data.recordings[trial].samples)

        both = np.column_stack([labels.frames_since_contact(force_n), force_n])
        features[here] = both[rows.row[here]]
    return features


def _hand(channels: int, spread: bool) -> HandCard | None:
    """The card of the six taxels; all 16 have none, because a card holds 12 sensors at most."""
    if channels != 3 * len(SIX_TAXELS):
        return None
    return read_hand_card(SPREAD_TAXELS_CARD if spread else SIX_TAXELS_CARD)


def _columns(channels: int, spread: bool) -> list[int]:
    """The columns of the signals for 18 or 48 channels. Raises ChannelsNotOffered."""
    six = spread_taxels(len(SIX_TAXELS)) if spread else SIX_TAXELS
    taxels = {18: six, 48: tuple(range(1, N_TAXELS + 1))}
    if channels not in taxels:
        raise ChannelsNotOffered("human_slip_uskin", channels, taxels)
    return channels_of([taxel - 1 for taxel in taxels[channels]])


def _moves(table: Table, arrays: Arrays) -> Iterator[_Move]:
    """The rows of trials.csv, once they and the signals are seen to agree."""
    table.require(COLUMNS)
    bounds = _bounds(table, arrays)

    rate_hz = table.numbers("frequency_hz")
    if np.any(rate_hz <= 0.0):
        raise NotANumber(
            "frequency_hz must be positive",
            where=table.path,
            next_step="correct that line",
        )

    subject, stage = table.text("subject"), table.text("stage")
    sample = table.text("sample")
    start, end = table.whole_numbers("start_index"), table.whole_numbers("end_index")

    for k in range(len(table)):
        yield _Move(
            name=f"{subject[k]}/{stage[k]}/{sample[k]}",
            subject=subject[k],
            stage=stage[k],
            rows=slice(int(bounds[k]), int(bounds[k + 1])),
            rate_hz=float(rate_hz[k]),
            start=int(start[k]),
            end=int(end[k]),
        )


def _bounds(table: Table, arrays: Arrays) -> IntArray:
    """[trials + 1] row where each trial starts; table and signals must agree."""
    n_rows = len(arrays["xela"])
    bounds = np.append(table.whole_numbers("offset"), n_rows)

    # The offsets stand in both files, so files of two versions show themselves.
    agree = (
        bounds[0] == 0
        and np.array_equal(bounds, arrays["offset"])
        and np.array_equal(np.diff(bounds), table.whole_numbers("n"))
        and len(arrays["object_imu"]) == n_rows
    )
    if not agree:
        raise ColumnError(
            f"{len(table)} trials do not cover the {n_rows} rows of {SIGNALS}",
            where=table.path,
            cause="signals and trials of different versions",
            next_step=COPY_AGAIN,
        )
    return bounds


def _recording(move: _Move, raw: FloatArray, columns: list[int]) -> Recording:
    """The trial of a move with the chosen columns of its raw samples [T, 48]."""
    return Recording(
        trial_id=move.name,
        group=move.subject,
        samples=PREPARATION.apply(raw)[:, columns],
        valid=finite_sensors(raw[:, columns]),
        rate_hz=move.rate_hz,
        unit="N",
        object_name="book",
        action=move.stage,
        person=move.subject,
    )
