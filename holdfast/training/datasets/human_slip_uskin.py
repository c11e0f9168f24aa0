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
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS, FloatArray
from holdfast.core.errors import ChannelError, ColumnError, EmptyRecording, NotANumber
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.datasets import human_slip_labels as labels
from holdfast.training.datasets.reading import (
    COPY_AGAIN,
    ChannelsNotOffered,
    Table,
    TrialRows,
    finite_sensors,
    join_trials,
    read_arrays,
    read_table,
)
from holdfast.training.recording import DataSet, LabelledRows, Recording

SIGNALS, TRIALS = "signals.npz", "trials.csv"
PREPARATION = Preparation(bias_rows=labels.BIAS_ROWS, statistic="median")
N_TAXELS = 16
SIX_TAXELS = (5, 9, 10, 11, 12, 13)
"""The 18-channel case, counted from 1 as the set's own column names do."""
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
        return (
            labels.BIAS_ROWS < self.start < self.end <= self.rows.stop - self.rows.start
        )


def recognises(root: Path) -> bool:
    """Whether a folder is in this format: one of its two files is there."""
    return (root / SIGNALS).is_file() or (root / TRIALS).is_file()


def load(root: Path, *, channels: int = 18, in_hand: bool = False) -> DataSet:
    """Read and label a folder in this format, 18 channels (six taxels) or all 48, unit N.

    in_hand: label by the object's rotation in the hand (both IMUs), without the wrist's part. The
    set's usual measure is the rotation of the object alone.

    Tasks: "situations" (0..3) and "predict_250ms" (0/1: over 15 deg within 0.25 s, from grasp
    rows). Unusable trials (not 60 < start < end <= n) are left out and counted in notes. Columns of
    trials.csv beyond the set's own are ignored: they describe trials and are read by name.

    Raises DataNotFound, ColumnError, NotANumber, ChannelError or EmptyRecording.
    """
    columns = _columns(channels)
    arrays = _arrays(root, in_hand)
    moves = list(_moves(read_table(root / TRIALS), arrays))
    usable = _usable(moves, root)
    angle_deg = labels.middle_angle_deg(_orientation(arrays, in_hand))
    trials = [_trial(move, arrays["xela"], angle_deg, columns) for move in usable]
    recordings, situations, predictions = map(list, zip(*trials, strict=True))
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
        redistributable=False,
        caveat=CAVEAT,
        group_kind="person",
        notes={"unusable_trials": len(moves) - len(usable)},
    )


def _arrays(root: Path, in_hand: bool) -> dict[str, npt.NDArray[Any]]:
    wanted: dict[str, tuple[int | None, ...]] = {
        "xela": (None, 48),
        "object_imu": (None, 7),
        "offset": (None,),
    }
    return read_arrays(
        root / SIGNALS, wanted | ({"hand_imu": (None, 7)} if in_hand else {})
    )


def _usable(moves: list[_Move], root: Path) -> list[_Move]:
    usable = [move for move in moves if move.usable]
    if not usable:
        raise EmptyRecording(
            "no usable trial",
            where=root,
            cause="no trial with 60 < start_index < end_index <= n",
            next_step="check start_index and end_index in trials.csv",
        )
    return usable


def _orientation(
    arrays: dict[str, npt.NDArray[Any]], in_hand: bool
) -> npt.NDArray[np.floating]:
    """[T, 4] quaternions of the object, or of the object in the hand."""
    object_q = arrays["object_imu"][:, :4]
    return labels.in_hand(object_q, arrays["hand_imu"][:, :4]) if in_hand else object_q


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


def _columns(channels: int) -> list[int]:
    taxels = {18: SIX_TAXELS, 48: tuple(range(1, N_TAXELS + 1))}
    if channels not in taxels:
        raise ChannelsNotOffered("human_slip_uskin", channels, taxels)
    return [3 * (taxel - 1) + axis for taxel in taxels[channels] for axis in range(3)]


def _moves(table: Table, arrays: dict[str, npt.NDArray[Any]]) -> Iterator[_Move]:
    """The rows of trials.csv, once they and the signals are seen to agree."""
    table.require(
        [
            "subject",
            "stage",
            "sample",
            "n",
            "frequency_hz",
            "start_index",
            "end_index",
            "offset",
        ]
    )
    bounds = _bounds(table, arrays)
    rate_hz = table.numbers("frequency_hz")
    if np.any(rate_hz <= 0.0):
        raise NotANumber(
            "frequency_hz must be positive",
            where=table.path,
            next_step="correct that line",
        )
    start, end = table.whole_numbers("start_index"), table.whole_numbers("end_index")
    identity = zip(
        table.text("subject"), table.text("stage"), table.text("sample"), strict=True
    )
    for k, (subject, stage, sample) in enumerate(identity):
        rows = slice(int(bounds[k]), int(bounds[k + 1]))
        name = f"{subject}/{stage}/{sample}"
        yield _Move(
            name, subject, stage, rows, float(rate_hz[k]), int(start[k]), int(end[k])
        )


def _bounds(table: Table, arrays: dict[str, npt.NDArray[Any]]) -> npt.NDArray[np.int64]:
    """[trials + 1] row where each trial starts; table and signals must agree."""
    n_rows = len(arrays["xela"])
    bounds = np.append(table.whole_numbers("offset"), n_rows)
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


def _trial(
    move: _Move,
    xela: npt.NDArray[np.floating],
    angle_deg: FloatArray,
    columns: list[int],
) -> tuple[Recording, TrialRows, TrialRows]:
    """One trial with its windows of both tasks."""
    raw = xela[move.rows].astype(np.float64)
    prepared = PREPARATION.apply(raw)
    recording = Recording(
        trial_id=move.name,
        group=move.subject,
        samples=prepared[:, columns],
        valid=finite_sensors(raw[:, columns]),
        rate_hz=move.rate_hz,
        unit="N",
        object_name="book",
        action=move.stage,
        person=move.subject,
    )
    force_n = labels.contact_force_n(prepared)
    rotation_deg = labels.rotation_from_start_deg(angle_deg[move.rows], move.start)
    phases = labels.phases(force_n, rotation_deg, move.end)
    events = labels.events(phases, move.rate_hz)
    return (
        replace(recording, phases=phases, events=events),
        labels.situation_windows(force_n, rotation_deg, move.end),
        labels.prediction_windows(force_n, rotation_deg, move.start, move.end),
    )
