"""Data sets by name or folder: `load` finds the folder, recognises its format and reads it.

A format is recognised by the files in the folder, whatever the folder is called. Only the reader of
that format is imported. joining.py makes one set of several.
"""

from __future__ import annotations

import os
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from holdfast.core.errors import ChannelError, DataNotFound, command
from holdfast.core.hand_card import read_hand_card
from holdfast.core.trial_layout import (
    HAND_FILE,
    META,
    TACTILE,
    has_logs,
    import_command,
    read_json,
)
from holdfast.data.datasets.trials import has_thesis_layout, require_offered
from holdfast.data.recording import DataSet, HoldOut, regrouped
from holdfast.data.windows import Choice

PUBLIC_SETS = ("human_slip_uskin", "eflesh_slip", "grip_lift_ati")
"""Sets that `load` finds by name in the data folder."""
AT_ANY_RATE = ("grip_lift_ati",)
"""Public sets that are averaged down to a rate, and windowed like the trials of users."""
LAYOUTS = ("recorded", "thesis")
"""Layouts of folders that users fill with trials of their own."""
USUAL_CHANNELS = 18
"""Of a public set, where no number is given."""
FOLDER_VARIABLE = "HOLDFAST_DATA"
"""The environment variable that names the data folder."""
BESIDE_THE_CHECKOUT = Path(__file__).resolve().parents[4] / "shared" / "data"


def load(
    name_or_path: str | Path,
    *,
    channels: int | None = None,
    rate_hz: float | None = None,
    seed: int = 0,
    windows: Choice = "balanced",
    hold_out: HoldOut | None = None,
) -> DataSet:
    """A data set by its name (a folder in HOLDFAST_DATA) or by its path.

    channels: one of the channel counts a set offers, None for its usual 18. rate_hz: folders of
    trials at a whole multiple of it are averaged down to it. seed: of every random choice. windows:
    in the thesis' layout those to train on (balanced), the thesis' undersampled ones, every one
    that is natural, to score on (data/windows.py), or none: recordings alone, which are read
    sooner. hold_out: what a group is; None for people where there are two.

    Raises DataNotFound, ChannelError, or a DataError of the reader.
    """
    root = find(name_or_path)
    layout = layout_of(root)
    if layout is None:
        next_step = command("check", root)
        if has_logs(root):
            next_step = f"logs of another program: {import_command(root)}"
        raise DataNotFound(
            "no known data set in this folder",
            where=root,
            cause="a level too high or too low, or an empty copy",
            next_step=next_step,
        )

    reader = reader_of(layout)
    if layout in LAYOUTS:
        from holdfast.data.datasets.thesis import assembled

        found = reader.readers(root, rate_hz=rate_hz)
        data = with_hand(assembled(reader.about(root), found, windows, seed), root)
        if channels:
            require_offered(root, channels, [3 * data.n_sensors])
    else:
        from holdfast.data.datasets.public_files import copied_whole

        with copied_whole(root):
            if layout in AT_ANY_RATE:
                data = reader.load(
                    root, channels=channels, rate_hz=rate_hz, windows=windows, seed=seed
                )
            else:
                # It brings its own windows and rate, and has a usual number of channels.
                data = reader.load(root, channels=channels or USUAL_CHANNELS)
    return data if hold_out is None else regrouped(data, hold_out)


def with_hand(data: DataSet, root: Path) -> DataSet:
    """The set with the hand card of its folder, where it has one.

    Raises CardError, DataNotFound for a card that meta.json names and that is not there, and
    ChannelError where it is another hand's.
    """
    path = root / HAND_FILE
    named = read_json(root / META).get("hand") or {}
    if not path.is_file():
        if not named:
            return data
        raise DataNotFound(
            f"no {HAND_FILE}, which {META} names",
            where=root,
            next_step="copy the whole set again",
        )

    hand = read_hand_card(path)
    is_changed = named.get("sha256", hand.sha256) != hand.sha256
    if is_changed or hand.n_sensors != data.n_sensors:
        raise ChannelError(
            f"{HAND_FILE} is the card of another hand",
            where=path,
            next_step="put the card back with which the set was recorded",
        )
    return replace(data, hand=hand)


def find(name_or_path: str | Path) -> Path:
    """Folder of a set. Raises DataNotFound with the likely cause."""
    path = Path(name_or_path)
    is_public = str(name_or_path) in PUBLIC_SETS
    # A public name goes first to the data folder, so that a folder of that name here does not hide
    # it.
    public = Path(os.environ.get(FOLDER_VARIABLE) or BESIDE_THE_CHECKOUT, name_or_path)
    if is_public and public.is_dir():
        return public
    if path.is_dir():
        return path
    if is_public:
        source = getattr(reader_of(str(name_or_path)), "SOURCE", "")
        raise DataNotFound(
            f"data set {name_or_path} not found",
            where=public,
            cause=f"it is not part of Holdfast: {source}" if source else "",
            next_step=f"set {FOLDER_VARIABLE} to the folder that holds {name_or_path}/",
        )
    next_step = f"give a folder, or one of {', '.join(PUBLIC_SETS)}"
    if path.is_file() and has_logs(path):
        next_step = f"{next_step}; of a log: {import_command(path)}"
    raise DataNotFound(
        "a file, not a folder" if path.exists() else "no such data set or folder",
        where=path,
        cause="a name misspelt, or a path from another folder",
        next_step=next_step,
    )


def layout_of(root: Path) -> str | None:
    """The name of the reader for a folder: one of PUBLIC_SETS or LAYOUTS, or None."""
    if (root / "signals.npz").is_file() or (root / "trials.csv").is_file():
        return "human_slip_uskin"
    if (root / "eflesh_slip.npz").is_file():
        return "eflesh_slip"
    if (root / "lifts.csv").is_file():
        return "grip_lift_ati"
    if any(
        "recorder" in read_json(path.with_name(META)) for path in root.rglob(TACTILE)
    ):
        return "recorded"
    return "thesis" if has_thesis_layout(root) else None


def reader_of(layout: str) -> Any:
    """The module that reads a layout: `load`, and for one of LAYOUTS also `readers`."""
    return import_module(f"holdfast.data.datasets.{layout}")
