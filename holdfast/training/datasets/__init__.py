"""Data sets by name or folder: `load` finds the folder, recognises its format and reads it.

A format is recognised by the files in the folder, whatever the folder is called. Only the reader of
that format is imported. `join` makes one set of several.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from holdfast.core.contract import RATE_TOLERANCE
from holdfast.core.errors import (
    ChannelError,
    DataError,
    DataNotFound,
    LabelError,
    RateError,
    UnitError,
    command,
)
from holdfast.core.hand_card import read_hand_card
from holdfast.core.trial_layout import (
    HAND_FILE,
    META,
    TACTILE,
    has_logs,
    import_command,
    read_json,
)
from holdfast.training.datasets.trials import has_thesis_layout, require_offered
from holdfast.training.recording import (
    DataSet,
    HoldOut,
    LabelledRows,
    Recording,
    regrouped,
)
from holdfast.training.windows import Choice

PUBLIC_SETS = ("human_slip_uskin", "eflesh_slip")
"""Sets that `load` finds by name in the data folder."""
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
    that is natural, to score on (training/windows.py), or none: recordings alone, which are read
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
        from holdfast.training.datasets.thesis import assembled

        found = reader.readers(root, rate_hz=rate_hz)
        data = with_hand(assembled(reader.about(root), found, windows, seed), root)
        if channels:
            require_offered(root, channels, [3 * data.n_sensors])
    else:
        from holdfast.training.datasets.public_files import copied_whole

        # A public set brings its own windows, and has a usual number of channels.
        with copied_whole(root):
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
        raise DataNotFound(
            f"data set {name_or_path} not found",
            where=public,
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
    if any(
        "recorder" in read_json(path.with_name(META)) for path in root.rglob(TACTILE)
    ):
        return "recorded"
    return "thesis" if has_thesis_layout(root) else None


def reader_of(layout: str) -> Any:
    """The module that reads a layout: `load`, and for one of LAYOUTS also `readers`."""
    return import_module(f"holdfast.training.datasets.{layout}")


def join(sets: Sequence[DataSet]) -> DataSet:
    """One set of several, each with the windows it has, at the rate of the first.

    Trials and groups get their set's name before theirs, so that people of two sets stay two
    groups. Redistributable only if all are. Where a set has no weights, none is learned. Raises
    RateError, UnitError, ChannelError, LabelError or DataError.
    """
    # Sets that differ in the weight alone have the situations in common.
    if any("situations" in data.tasks for data in sets):
        sets = [data.without_weight() for data in sets]
    first, *others = sets
    for other in others:
        _require_alike(other, first)
    # A set without a card fits any hand, so those with one are compared with each other.
    with_card = [data for data in sets if data.hand is not None]
    for other in with_card[1:]:
        _require_alike(other, with_card[0])

    # The same trials twice would be on both sides of a split, as two groups.
    names = [data.name for data in sets]
    if len(set(names)) < len(names):
        raise DataError(
            f"the same set twice ({', '.join(names)})", next_step="give every set once"
        )
    if not others:
        return first

    recordings: list[Recording] = []
    parts: dict[str, list[LabelledRows]] = {task: [] for task in first.tasks}
    for data in sets:
        # Trials are numbered on where those of the sets before end.
        for task, rows in data.tasks.items():
            parts[task].append(replace(rows, trial=rows.trial + len(recordings)))
        for recording in data.recordings:
            trial_id = f"{data.name}/{recording.trial_id}"
            group = f"{data.name}/{recording.group}"
            recordings.append(replace(recording, trial_id=trial_id, group=group))
    return replace(
        first,
        name=" + ".join(names),
        recordings=recordings,
        tasks={task: LabelledRows.concatenated(rows) for task, rows in parts.items()},
        kind=_each_once(" + ", sets, "kind"),
        redistributable=all(data.redistributable for data in sets),
        caveat=_each_once(" ", sets, "caveat"),
        notes={},
        group_kind=_each_once(" and by ", sets, "group_kind"),
        hand=with_card[0].hand if with_card else None,
        forces_verified=all(data.forces_verified for data in sets),
    )


def _require_alike(other: DataSet, first: DataSet) -> None:
    """Check that one model fits both sets.

    Raises RateError, UnitError, ChannelError, LabelError or DataError.
    """
    # A rate that is near enough counts as the same, and a set without a card fits any hand.
    is_near = abs(other.rate_hz / first.rate_hz - 1.0) <= RATE_TOLERANCE
    rate_hz = first.rate_hz if is_near else other.rate_hz
    ours, theirs = other.hand or first.hand, first.hand or other.hand
    sides = ours and ours.sensor_sides
    silent, silent_before = (hand and hand.unmeasured_names for hand in (ours, theirs))
    must_agree: list[tuple[type[DataError], str, object, object]] = [
        (RateError, "rate in Hz", rate_hz, first.rate_hz),
        (UnitError, "unit", other.unit, first.unit),
        (ChannelError, "sensors", other.n_sensors, first.n_sensors),
        (ChannelError, "sides", sides, theirs and theirs.sensor_sides),
        (ChannelError, "axes that are not measured", silent, silent_before),
        (LabelError, "tasks", sorted(other.tasks), sorted(first.tasks)),
        (DataError, "preparation", other.preparation, first.preparation),
    ]
    for error, name, one, reference in must_agree:
        if one != reference:
            raise error(
                f"{other.name} differs in {name}: {one}, not {reference}",
                where=other.name,
                cause=f"recorded with other settings than {first.name}",
                next_step="use sets that were recorded alike, or one of them alone",
            )


def _each_once(separator: str, sets: Sequence[DataSet], name: str) -> str:
    """The texts of this name, each of them once, in order of the sets."""
    return separator.join(dict.fromkeys(getattr(data, name) for data in sets))
