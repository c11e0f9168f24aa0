"""Examine a folder of recordings: read every trial, go on after a fault, say what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from holdfast.edge_runtime.errors import DataError
from holdfast.edge_runtime.intent_file import read_intent
from holdfast.edge_runtime.trial_layout import intent_path
from holdfast.training.datasets import LAYOUTS, layout_of, load
from holdfast.training.datasets.thesis import common_rate
from holdfast.training.datasets.trial_readers import TrialReader, read_all
from holdfast.training.folder_advice import advice, not_read
from holdfast.training.folder_report import (
    FolderReport,
    Found,
    Missing,
    cell_of,
    cells_of,
    seconds_of_classes,
)
from holdfast.training.hold_out import grouped
from holdfast.training.say import Part, ignored
from holdfast.training.windows import TimedTrial

OF_THE_SET = "labels of the set"


def examine(root: Path, part: Part = ignored) -> FolderReport:
    """What a folder holds, and what is missing. part: receives the share of it that is read.

    Raises a DataError only where not even the layout is recognised.
    """
    layout = layout_of(root)
    if layout is None:
        return FolderReport(str(root), None, None, 0, None, [], [], not_read(root, []))
    if layout not in LAYOUTS:
        return _public(root, layout, part)
    faults: list[DataError] = []
    readers = _readers(root, layout, faults)
    trials = read_all(readers, faults.append, part)
    found = [(cell_of(one.place), trial) for one, trial in zip(readers, trials, strict=True)]
    return _report(root, layout, found, faults, [one.place.path for one in readers])


def _report(
    root: Path, layout: str, found: Sequence[Found], faults: list[DataError], paths: Sequence[Path]
) -> FolderReport:
    trials = [trial for _, trial in found if trial]
    if trials:
        common_rate([trial.recording for trial in trials], faults.append)
    recordings, kind = grouped([trial.recording for trial in trials])
    classes = seconds_of_classes(trials)
    wrong = list(dict.fromkeys(Missing.of(fault) for fault in faults))
    intents, damaged = intents_beside(paths)
    others = not_read(root, paths) if paths else []
    return FolderReport(
        str(root),
        layout,
        kind if trials else None,
        len({one.group for one in recordings}),
        3 * recordings[0].n_sensors if recordings else None,
        cells_of(found),
        classes,
        [*wrong, *advice(root, layout, trials, classes, all_read=not wrong), *damaged, *others],
        intents,
    )


def intents_beside(trials: Sequence[Path]) -> tuple[int, list[Missing]]:
    """How many trials have the wearer's own command beside them; advice on those that are damaged.

    Training does not read these files.
    """
    paths = [path for path in map(intent_path, trials) if path.is_file()]
    damaged = []
    for path in paths:
        try:
            read_intent(path)
        except DataError as error:
            damaged.append(Missing("advice", error.where, error.what, error.next_step))
    return len(paths) - len(damaged), damaged


def _readers(root: Path, layout: str, faults: list[DataError]) -> list[TrialReader]:
    module: Any = import_module(f"holdfast.training.datasets.{layout}")
    try:
        readers: list[TrialReader] = module.readers(root, faults.append)
    except DataError as error:
        faults.append(error)
        return []
    return readers


def _public(root: Path, layout: str, part: Part) -> FolderReport:
    """A public set: its reader refuses what is wrong, and it lacks nothing."""
    data = load(root, part=part)
    found = [
        ((one.person, one.object_name, one.action), TimedTrial(one, (), None, labels_by=OF_THE_SET))
        for one in data.recordings
    ]
    n_groups, channels = len(data.groups()), 3 * data.n_sensors
    cells = cells_of(found)
    return FolderReport(str(root), layout, data.group_kind, n_groups, channels, cells, [], [])
