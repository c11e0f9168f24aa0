"""A trial as every other format gets it: times, values, validity, labels, and what is known of it.

Lost samples stay rows, invalid and without a value. Nothing is resampled or filled.

What happens in a trial, by time: labels that change, marks, fingers lost and back.
"""

from __future__ import annotations

from calendar import timegm
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from time import strptime

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NOTHING, SITUATIONS, BoolArray, FloatArray, Unit
from holdfast.core.errors import DataNotFound
from holdfast.core.reading import Json
from holdfast.core.trial_file import read_trial
from holdfast.core.trial_layout import EVENTS, META, TACTILE, read_events, read_json
from holdfast.training.datasets import LAYOUTS, find, layout_of, reader_of
from holdfast.training.datasets.thesis import preparation
from holdfast.training.datasets.trials import TrialReader
from holdfast.training.recording import Recording
from holdfast.training.windows import TimedTrial

UNLABELLED = "unlabelled"
NO_LABEL = -1
START_KEY = "started_utc"


@dataclass(frozen=True)
class Mark:
    """A moment of a trial and its name, such as `load_onset`; t_s from the first sample."""

    t_s: float
    text: str
    provenance: str


@dataclass(frozen=True)
class CarriedTrial:
    """One trial.

    recording: unit, rate and validity; a sensor is valid where it was and has all three values.
    t_s [T] from the first sample; values [T, C] in the recording's unit, nan where a sample was
    lost. label [T]: index into SITUATIONS, or NO_LABEL. start_ns: of the first sample since 1970,
    to the second; 0 where the trial does not say. about: what is known of the trial, and how the
    values were prepared, for the metadata of a format.
    """

    recording: Recording
    t_s: FloatArray
    values: FloatArray
    label: npt.NDArray[np.int8]
    marks: tuple[Mark, ...]
    start_ns: int
    about: Json

    @property
    def name(self) -> str:
        """The trial's path in the set, with /."""
        return self.recording.trial_id

    @property
    def valid(self) -> BoolArray:
        """[T, S]."""
        return self.recording.valid

    @property
    def unit(self) -> Unit:
        """Of the values."""
        return self.recording.unit

    @property
    def n_sensors(self) -> int:
        """S, 3-axis sensors."""
        return self.recording.n_sensors

    @property
    def t_ns(self) -> npt.NDArray[np.int64]:
        """[T] the stamps that formats with absolute times get: start_ns + t_s."""
        stamps: npt.NDArray[np.int64] = self.start_ns + np.round(self.t_s * 1e9).astype(
            np.int64
        )
        return stamps

    def situations(self) -> list[str]:
        """[T] names of the labels."""
        return [label_name(code) for code in self.label.tolist()]

    def phases(self) -> list[tuple[int, int, str]]:
        """(first row, row after the last, situation) of runs of equal labels, in their order."""
        first = [
            *np.flatnonzero(np.diff(self.label, prepend=-2)).tolist(),
            len(self.label),
        ]
        names = [label_name(int(self.label[row])) for row in first[:-1]]
        return list(zip(first[:-1], first[1:], names, strict=True))


def label_name(code: int) -> str:
    """The situation of a label, or UNLABELLED."""
    return UNLABELLED if code == NO_LABEL else SITUATIONS[code]


def carried_trials(
    source: Path, only: str = "*", *, raw: bool = False
) -> list[CarriedTrial]:
    """The trials of a folder whose names match a pattern.

    raw: values as recorded; else without bias and with reversed magnets turned, as a model sees
    them. Raises DataNotFound, or the DataError of the first trial that cannot be used.
    """
    root = find(source)
    layout = layout_of(root)
    if layout not in LAYOUTS:
        raise DataNotFound(
            "no trials of the layout in this folder",
            where=root,
            cause="a public set, a level too high or too low, or an empty copy",
            next_step="give a folder that holdfast check reads",
        )
    readers: list[TrialReader] = reader_of(layout).readers(root)
    chosen = [reader for reader in readers if fnmatch(_name(reader, root), only)]
    if not chosen:
        names = ", ".join(_name(reader, root) for reader in readers[:3])
        raise DataNotFound(
            f"no trial matches {only!r}",
            where=root,
            next_step=f"its trials are {names}, ..",
        )
    return [_carried(reader.place.path, reader.read(), raw) for reader in chosen]


def _name(reader: TrialReader, root: Path) -> str:
    """As trial_id will be, before the trial is read."""
    path = reader.place.path
    place = path.parent if path.name == TACTILE else path.with_suffix("")
    return place.relative_to(root).as_posix() if place != root else root.name


def _carried(path: Path, timed: TimedTrial, raw: bool) -> CarriedTrial:
    trial, recording = read_trial(path), timed.recording
    meta = read_json(path.with_name(META)) if path.name == TACTILE else {}
    label = np.full(len(trial.t_s), NO_LABEL, dtype=np.int8)
    for phase in timed.recording.phases:
        label[phase.first : phase.stop] = phase.situation
    return CarriedTrial(
        recording,
        trial.t_s,
        trial.raw if raw else recording.samples,
        label,
        tuple(_marks(path)),
        _start_ns(meta),
        _about(timed, trial.raw, raw) | {START_KEY: meta.get(START_KEY)},
    )


def _about(timed: TimedTrial, recorded: FloatArray, raw: bool) -> Json:
    recording = timed.recording
    sign, bias = preparation(recording.unit).learn(recorded)
    return {
        "trial": recording.trial_id,
        "person": recording.person,
        "object": recording.object_name,
        "action": recording.action or SITUATIONS[NOTHING],
        "mass_g": timed.mass.mass_g if timed.mass else None,
        "unit": recording.unit,
        "rate_hz": recording.rate_hz,
        "values": "as recorded" if raw else "recorded * sign - bias",
        "sign": sign.tolist(),
        "bias": bias.tolist(),
        "labels_by": timed.labels_by,
    }


def _start_ns(meta: Json) -> int:
    """Of the recorder's meta.json; 0 without."""
    try:
        return (
            timegm(strptime(str(meta[START_KEY]), "%Y-%m-%dT%H:%M:%SZ")) * 1_000_000_000
        )
    except (KeyError, ValueError):
        return 0


def _marks(path: Path) -> Iterator[Mark]:
    """The marks of a recorder's events.jsonl."""
    for event in read_events(path.with_name(EVENTS)) if path.name == TACTILE else []:
        if "mark" in event and isinstance(event.get("t_s"), int | float):
            yield Mark(
                float(event["t_s"]), str(event["mark"]), str(event.get("provenance"))
            )


@dataclass(frozen=True)
class Happening:
    """One line of a log. is_loss: a finger is not valid from here on."""

    t_ns: int
    text: str
    is_loss: bool = False


def happenings(trial: CarriedTrial) -> list[Happening]:
    """All of a trial."""
    stamps = trial.t_ns.tolist()
    labels = [
        Happening(stamps[first], f"label: {name} ({trial.about['labels_by']})")
        for first, _, name in trial.phases()
    ]
    marks = [
        Happening(
            trial.start_ns + round(1e9 * one.t_s),
            f"mark: {one.text} ({one.provenance})",
        )
        for one in trial.marks
    ]
    return sorted(labels + marks + _losses(trial, stamps), key=lambda one: one.t_ns)


def _losses(trial: CarriedTrial, stamps: list[int]) -> list[Happening]:
    """Where a finger is lost, also from the start, and where it is back."""
    there = trial.valid
    before = np.vstack([np.ones((1, there.shape[1]), dtype=np.bool_), there[:-1]])
    return [
        Happening(
            stamps[row],
            f"finger {sensor + 1} {'is back' if there[row, sensor] else 'is lost'}",
            is_loss=not there[row, sensor],
        )
        for row, sensor in np.argwhere(there != before).tolist()
    ]
