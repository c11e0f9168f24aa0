"""Reader of eflesh_slip: a gripper holds an object, and in some trials a person tugs at it.

V. Pattabiraman et al., "eFlesh: Highly customizable Magnetic Touch Sensing using Cut-Cell
Microstructures", arXiv:2506.09994 (2025), MIT. An easy set: one threshold on the amplitude does as
well as a forest. It shows that the pipeline runs on licensed real Hall data, and how late it
answers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from holdfast.core.contract import GRASP, RISKY_SLIP, SITUATIONS
from holdfast.core.hand_card import read_hand_card
from holdfast.data.datasets.public_files import channels_of, join_trials, read_arrays
from holdfast.data.datasets.trials import require_offered
from holdfast.data.recording import DataSet, Recording, finite_sensors
from holdfast.edge_runtime.preparation import Preparation

ARRAYS = "eflesh_slip.npz"
RATE_HZ = 100.0
"""Nominal: the collection loop sleeps to 10 ms, no time stamps are stored."""
PREPARATION = Preparation(bias_rows=50, statistic="median")
SIX_MAGNETOMETERS = (0, 2, 4, 5, 7, 9)
"""The 18-channel case, counted from 0, of the set's ten magnetometers."""
SIX_MAGNETOMETERS_CARD = "eflesh-gripper"
"""The hand card with these magnetometers."""
TRIAL_ROWS, WINDOW_ROWS = 300, 6
"""Rows of each trial, 3 s, and of a window."""
LAST_SECOND = slice(TRIAL_ROWS - 100, TRIAL_ROWS)
BLOCK_TRIALS = 6
"""Object ids are not published; neighbouring trials are likely of one object and stay together."""
# trial_086 is labelled as held, but shows a large event.
CAVEAT = (
    "Tug against steady hold, one label a trial and no onset; an easy set: one threshold on the "
    "amplitude is right in 0.993 of the trials, so a forest cannot show an advantage here."
)


def is_ours(root: Path) -> bool:
    """Whether its file is there."""
    return (root / ARRAYS).is_file()


def load(root: Path, *, channels: int = 18) -> DataSet:
    """Read the set, 18 channels (six magnetometers) or all 30, unit uT.

    Task "situations": windows of 6 rows side by side in the last second, grasp (held) or risky_slip
    (tugged). A group is a block of six neighbouring trials.
    Raises ChannelError.
    """
    offered = {18: SIX_MAGNETOMETERS, 30: range(10)}
    require_offered(root, channels, offered)
    columns = channels_of(offered[channels])
    field, tugged = read_arrays(root / ARRAYS, "X", "y")
    raw = field[:, :, columns].astype(np.float64)
    row = np.arange(LAST_SECOND.start + WINDOW_ROWS - 1, LAST_SECOND.stop, WINDOW_ROWS)

    # One label stands for a whole trial, since the set stores no onset.
    recordings, windows = [], []
    for number, tug in enumerate(tugged):
        recording = Recording(
            trial_id=f"trial_{number:03d}",
            group=f"block_{number // BLOCK_TRIALS:02d}",
            samples=PREPARATION.apply(raw[number]),
            valid=finite_sensors(raw[number]),
            rate_hz=RATE_HZ,
            unit="uT",
            action="tug" if tug else "hold",
        )
        recordings.append(recording)
        windows.append((row, np.full(len(row), RISKY_SLIP if tug else GRASP)))

    return DataSet(
        name="eflesh_slip",
        recordings=recordings,
        tasks={"situations": join_trials(windows, SITUATIONS)},
        rate_hz=RATE_HZ,
        unit="uT",
        preparation=PREPARATION,
        kind="real, recorded by others: a gripper, tugged or not",
        redistributable=True,
        caveat=CAVEAT,
        group_kind="block",
        hand=read_hand_card(SIX_MAGNETOMETERS_CARD) if channels == 18 else None,
    )
