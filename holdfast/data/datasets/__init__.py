"""Data sets by name or folder: `load` finds the folder, recognises its format and reads it.

A format is recognised by the files in the folder, whatever the folder is called. joining.py makes
one set of several.

A reader is a module of this package, and is found there. It has `is_ours(folder)` and, for trials
with phases, `about(folder)`, a PublicSet, and `trials(folder, rate_hz)`, TimedTrials at that rate;
`load` makes the windows, as of trials of users. A set that brings windows and rate of its own has
`load(folder, channels)` in their place. Folders that users fill with trials are LAYOUTS.
"""

from __future__ import annotations

import os
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from holdfast.core.contract import RATE_TOLERANCE
from holdfast.core.errors import ChannelError, DataNotFound, RateError, command
from holdfast.core.hand_card import read_hand_card
from holdfast.core.trial_layout import (
    HAND_FILE,
    META,
    has_logs,
    import_command,
    read_json,
)
from holdfast.data.datasets.trials import require_offered
from holdfast.data.recording import DataSet, HoldOut, regrouped
from holdfast.data.windows import Choice

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

    channels: one of the channel counts a set offers, None for its usual one. rate_hz: trials at a
    whole multiple of it are averaged down to it. seed: of every random choice. windows: those to
    train on (balanced), the thesis' undersampled ones, every one that is natural, to score on
    (data/windows.py), or none: recordings alone, which are read sooner; a set with windows of its
    own gives these. hold_out: what a group is; None for people where there are two.

    Raises DataNotFound, ChannelError, RateError for a set that cannot be had at rate_hz, or a
    DataError of the reader.
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
            if hasattr(reader, "trials"):
                data = _of_trials(reader, root, channels, rate_hz, windows, seed)
            else:
                # It brings its own windows and rate, and has a usual number of channels.
                data = reader.load(root, channels=channels or USUAL_CHANNELS)
                _require_rate(data, rate_hz)
    return data if hold_out is None else regrouped(data, hold_out)


def _of_trials(
    reader: Any,
    root: Path,
    channels: int | None,
    rate_hz: float | None,
    windows: Choice,
    seed: int,
) -> DataSet:
    """The set of a reader's trials, with what it says of them."""
    from holdfast.data.datasets.thesis import common_rate, of_trials

    about = reader.about(root)
    require_offered(root, channels or about.channels[0], about.channels)
    trials = reader.trials(root, rate_hz)
    rate = common_rate([trial.recording for trial in trials])
    data = of_trials(trials, about.meta, rate, windows, seed)
    _require_rate(data, rate_hz)
    return replace(
        data,
        preparation=about.preparation,
        hand=read_hand_card(about.hand) if about.hand else None,
        licence=about.licence,
        source=about.source,
    )


def _require_rate(data: DataSet, rate_hz: float | None) -> None:
    """Raise RateError where a set cannot be had at a rate that was asked for."""
    if rate_hz and abs(data.rate_hz / rate_hz - 1.0) > RATE_TOLERANCE:
        raise RateError(
            f"{data.name} is at {data.rate_hz:.4g} Hz, and cannot be had at {rate_hz:.4g} Hz",
            next_step=f"use a model for {data.rate_hz:.4g} Hz, or another set",
        )


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
    is_public = _is_public(str(name_or_path))
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
    next_step = f"give a folder, or one of {', '.join(public_sets())}"
    if path.is_file() and has_logs(path):
        next_step = f"{next_step}; of a log: {import_command(path)}"
    raise DataNotFound(
        "a file, not a folder" if path.exists() else "no such data set or folder",
        where=path,
        cause="a name misspelt, or a path from another folder",
        next_step=next_step,
    )


def layout_of(root: Path) -> str | None:
    """The name of the reader for a folder: one of LAYOUTS or a public set, or None."""
    # those of users first: most folders are, and no other reader is then loaded
    for name in LAYOUTS:
        if reader_of(name).is_ours(root):
            return name
    return next((one for one in public_sets() if reader_of(one).is_ours(root)), None)


def public_sets() -> list[str]:
    """The sets that `load` finds by name in the data folder: those with a reader here."""
    return [one.name for one in iter_modules(__path__) if _is_public(one.name)]


def _is_public(name: str) -> bool:
    """Whether a name is that of a set with a reader in this package."""
    if name in LAYOUTS or name not in {one.name for one in iter_modules(__path__)}:
        return False
    return hasattr(reader_of(name), "is_ours")


def reader_of(layout: str) -> Any:
    """The module that reads a layout or a public set; one of LAYOUTS has `readers`."""
    return import_module(f"holdfast.data.datasets.{layout}")
