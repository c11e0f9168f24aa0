"""Reader of proactive_slip_uskin: an arm carries a box between two uSkin pads; the box may slip.

K. Nazari, W. Mandil, A. Ghalamzan E., "Proactive slip control by learned slip model and trajectory
adaptation", CoRL 2022, arXiv:2209.06019, MIT. Seven trials, three of which slip: for a replay and a
lead-time picture, never for an accuracy.

The unit is raw counts. Pressing raises z: when the box is lost (the trial marked as dropped), all
32 normals fall, by 370 to 1170 counts (mean of its second half); so no sign is turned. Row 0, from
which the bias is taken, is already in the grip: prepared normals are changes from the grip, and
"nothing" does not occur.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from holdfast.core.contract import (
    GRASP,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    BoolArray,
    IntArray,
)
from holdfast.core.errors import ColumnError, DataNotFound
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.datasets.public_files import (
    COPY_AGAIN,
    UNLABELLED,
    TrialRows,
    join_trials,
    offered_channels,
    read_table,
)
from holdfast.training.recording import DataSet, Recording, finite_sensors

PADS = ("xela_sensor1.csv", "xela_sensor2.csv")
LABELS, META = "slip_label.csv", "meta_data.csv"
PREPARATION = Preparation(bias_rows=1)
THREE_TAXELS = (4, 14, 16)
"""Of either pad, counted from 1: the three whose normals fall most when the box is lost, mean of
both pads and both failing trials (769, 763 and 754 counts; the next are 726 and 653)."""
FIRST_ROW = 30
"""Half a second for filters to settle before the first window."""
CAVEAT = (
    "Seven trials, only three of which slip: a demonstration, which cannot support any accuracy "
    "claim."
)


def load(root: Path, *, channels: int = 18) -> DataSet:
    """Read the set, 18 channels (three taxels of either pad) or all 96, unit count.

    Task "situations": every row from row 30 on. A slip run that recovers is safe_slip; one that
    ends in failure, and failure itself, risky_slip; the rest grasp. Every trial is a group of its
    own. Raises DataNotFound, ColumnError, NotANumber, EmptyRecording or ChannelError.
    """
    three = [taxel - 1 for taxel in THREE_TAXELS]
    offered = {18: [*three, *(16 + taxel for taxel in three)], 96: range(32)}
    columns = offered_channels("proactive_slip_uskin", channels, offered)
    # The trials lie below the set, or below its data_set as it is published.
    pads = [*root.glob(f"*/{PADS[0]}"), *root.glob(f"data_set/*/{PADS[0]}")]
    folders = sorted(path.parent for path in pads)
    if not folders:
        raise DataNotFound("no trials", where=root, next_step=COPY_AGAIN)

    recordings = []
    windows = []
    for folder in folders:
        recording = _recording(folder, columns)
        recordings.append(recording)
        windows.append(_windows(folder, len(recording.samples)))

    # A model has one rate, so the set is served at the median of its trials.
    rates_hz = [recording.rate_hz for recording in recordings]
    return DataSet(
        name="proactive_slip_uskin",
        recordings=recordings,
        tasks={"situations": join_trials(windows, SITUATIONS)},
        rate_hz=float(np.median(rates_hz)),
        unit="count",
        preparation=PREPARATION,
        kind="real, recorded by others: a robot arm carrying a box",
        forces_verified=False,
        redistributable=True,
        caveat=CAVEAT,
    )


def situations(slip: BoolArray, fail: BoolArray) -> IntArray:
    """[T] slip and fail -> [T] situation; UNLABELLED for a slip that the recording's end cuts off.

    >>> situations(np.array([0, 1, 0, 1, 0], bool), np.array([0, 0, 0, 0, 1], bool)).tolist()
    [1, 2, 1, 3, 3]
    """
    label = np.where(fail, RISKY_SLIP, GRASP)
    # Framed by rows that do not slip, so that runs at the ends have two edges as well.
    slipping = np.concatenate([[False], slip & ~fail, [False]])

    # Edges come in pairs, the first row of a run and the first row after it.
    edges = np.flatnonzero(slipping[1:] != slipping[:-1])
    for start, stop in edges.reshape(-1, 2):
        label[start:stop] = _outcome(fail, stop)
    return label.astype(np.int64)


def _outcome(fail: BoolArray, stop: int) -> int:
    """What a slip run turned into, by the row after it."""
    # A slip that the recording cuts off may have recovered or not, so it gets no label.
    if stop == len(fail):
        return UNLABELLED
    return RISKY_SLIP if fail[stop] else SAFE_SLIP


def _recording(folder: Path, columns: list[int]) -> Recording:
    """The trial of a folder; the second pad's columns follow those of the first."""
    names = [f"txl{taxel}_{axis}" for taxel in range(1, 17) for axis in "xyz"]
    pads = []
    for name in PADS:
        table = read_table(folder / name, dict.fromkeys(names, float))
        pads.append(table[names].to_numpy())
    if len(pads[0]) != len(pads[1]):
        raise ColumnError(
            "the two pads differ in length", where=folder, next_step=COPY_AGAIN
        )

    raw = np.hstack(pads)[:, columns]
    rate = read_table(folder / META, {"frequency_hz": float})["frequency_hz"]
    return Recording(
        trial_id=folder.name,
        group=folder.name,
        samples=PREPARATION.apply(raw),
        valid=finite_sensors(raw),
        rate_hz=float(rate[0]),
        unit="count",
        object_name="box",
    )


def _windows(folder: Path, n_rows: int) -> TrialRows:
    """The labelled rows of a trial from row 30 on. Raises ColumnError."""
    table = read_table(folder / LABELS, {"slip": float, "fail": float})
    slip, fail = (table[["slip", "fail"]].to_numpy() > 0.5).T
    if len(slip) != n_rows:
        raise ColumnError(
            f"{len(slip)} labels for {n_rows} rows", where=folder, next_step=COPY_AGAIN
        )

    label = situations(slip, fail)
    row = np.arange(FIRST_ROW, n_rows)
    row = row[label[row] != UNLABELLED]
    return row, label[row]
