"""Reader of human_slip_uskin: people pinch a book-shaped object between uSkin and move it fast.

K. Nazari et al., "Bioinspired trajectory modulation for effective slip control in robot
manipulation", Nature Machine Intelligence (2025), doi 10.1038/s42256-025-01062-2. No licence is
stated: evaluate locally, redistribute nothing. Any folder with the same two files can be read, also
of other people.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS
from holdfast.core.errors import ColumnError, EmptyRecording, NotANumber
from holdfast.core.hand_card import read_hand_card
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.datasets import human_slip_labels as labels
from holdfast.training.datasets.public_files import (
    COPY_AGAIN,
    Shape,
    join_trials,
    offered_channels,
    read_arrays,
    read_table,
)
from holdfast.training.recording import DataSet, Recording, finite_sensors

SIGNALS, TRIALS = "signals.npz", "trials.csv"
PREPARATION = Preparation(bias_rows=labels.BIAS_ROWS, statistic="median")
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
SHAPES: dict[str, Shape] = {
    "xela": (None, 48),
    "object_imu": (None, 7),
    "offset": (None,),
}
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


def load(
    root: Path, *, channels: int = 18, six: tuple[int, ...] = SPREAD_TAXELS
) -> DataSet:
    """Read and label a folder in this format, 18 channels (six taxels) or all 48, unit N.

    Tasks: "situations" (0..3) and "predict_250ms" (0/1: over 15 deg within 0.25 s, from grasp
    rows). Unusable trials (not 60 < start < end <= n) are left out and counted in notes. Columns of
    trials.csv beyond the set's own are ignored: they describe trials and are read by name.

    Raises DataNotFound, ColumnError, NotANumber, ChannelError or EmptyRecording.
    """
    offered = {18: [taxel - 1 for taxel in six], 48: range(N_TAXELS)}
    columns = offered_channels("human_slip_uskin", channels, offered)
    arrays = read_arrays(root / SIGNALS, SHAPES)
    table = read_table(root / TRIALS, COLUMNS)
    _require_one_version(table, arrays, root / TRIALS)

    angle_deg = labels.middle_angle_deg(arrays["object_imu"][:, :4])
    recordings, situations, predictions = [], [], []
    for move in table.itertuples():
        start, end = move.start_index, move.end_index
        # The hold before the move and after it must be recorded.
        if not labels.BIAS_ROWS < start < end <= move.n:
            continue
        rows = slice(move.offset, move.offset + move.n)
        raw = arrays["xela"][rows].astype(np.float64)
        prepared = PREPARATION.apply(raw)
        # Contact is judged on all 48 channels, so that labels do not depend on the taxels.
        force_n = labels.contact_force_n(prepared)
        turned_deg = labels.rotation_from_start_deg(angle_deg[rows], start)
        phases = labels.phases(force_n, turned_deg, end)
        recording = Recording(
            trial_id=f"{move.subject}/{move.stage}/{move.sample}",
            group=move.subject,
            samples=prepared[:, columns],
            valid=finite_sensors(raw[:, columns]),
            rate_hz=move.frequency_hz,
            unit="N",
            object_name="book",
            action=move.stage,
            phases=phases,
            events=labels.events(phases, move.frequency_hz),
            person=move.subject,
        )
        recordings.append(recording)
        situations.append(labels.situation_windows(force_n, turned_deg, end))
        ahead = labels.prediction_windows(force_n, turned_deg, start, end)
        predictions.append(ahead)
    if not recordings:
        what = "no trial with 60 < start_index < end_index <= n: no usable trial"
        raise EmptyRecording(what, where=root, next_step="check these in trials.csv")

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
        hand=read_hand_card(HAND_CARDS[six]) if channels == 18 else None,
        notes={"unusable_trials": len(table) - len(recordings)},
    )


def _require_one_version(
    table: Any, arrays: dict[str, npt.NDArray[Any]], where: Path
) -> None:
    """Raise ColumnError where signals and trials disagree, NotANumber for a rate that is none."""
    n_rows = len(arrays["xela"])
    bounds = np.append(table["offset"], n_rows)
    # The offsets stand in both files, so files of two versions show themselves.
    agree = (
        bounds[0] == 0
        and np.array_equal(bounds, arrays["offset"])
        and np.array_equal(np.diff(bounds), table["n"])
        and len(arrays["object_imu"]) == n_rows
    )
    if not agree:
        raise ColumnError(
            f"{len(table)} trials do not cover the {n_rows} rows of {SIGNALS}",
            where=where,
            cause="signals and trials of different versions",
            next_step=COPY_AGAIN,
        )
    if not (table["frequency_hz"] > 0.0).all():
        step = "correct that line"
        raise NotANumber("frequency_hz must be positive", where=where, next_step=step)
