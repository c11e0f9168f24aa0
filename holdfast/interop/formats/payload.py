"""A trial as every other format gets it: times, values, validity, labels, and its metadata.

Lost samples stay rows, invalid and without a value. Nothing is resampled or filled.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from fnmatch import fnmatch
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    NOTHING,
    SITUATIONS,
    BoolArray,
    FloatArray,
    IntArray,
    Json,
)
from holdfast.core.errors import DataNotFound, listed
from holdfast.core.hand_card import hand_card_near
from holdfast.core.trial_file import read_trial
from holdfast.core.trial_layout import META, TACTILE, read_json
from holdfast.data.datasets import LAYOUTS, find, layout_of, reader_of
from holdfast.data.datasets.thesis import preparation
from holdfast.data.recording import Recording
from holdfast.data.windows import TimedTrial

UNLABELLED = "unlabelled"
"""The name of a row without a label, in formats that store names."""
NO_LABEL = -1
"""The number of a row without a label, in formats that store numbers."""
LABEL_OF = {NO_LABEL: UNLABELLED, **dict(enumerate(SITUATIONS))}
"""The number of a label -> its name."""
START_KEY = "started_utc"
"""In a recorder's meta.json: the start of the trial, to the second."""


@dataclass(frozen=True)
class TrialPayload:
    """One trial.

    recording: unit, rate and validity; a sensor is valid where it was and has all three values.
    t_s [T] from the first sample; values [T, C] in the recording's unit, nan where a sample was
    lost. label [T]: index into SITUATIONS, or NO_LABEL. start_ns: of the first sample since 1970,
    to the second; 0 where the trial gives none. about: what is known of the trial, and how the
    values were prepared, for the metadata of a format.
    """

    recording: Recording
    t_s: FloatArray
    values: FloatArray
    label: npt.NDArray[np.int8]
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
    def t_ns(self) -> IntArray:
        """[T] the stamps that formats with absolute times get: start_ns + t_s."""
        return self.start_ns + np.round(self.t_s * 1e9).astype(np.int64)

    def phases(self) -> list[tuple[int, int, str]]:
        """(first row, row after the last, situation) of runs of equal labels, in their order."""
        changes = np.flatnonzero(np.diff(self.label)) + 1
        ends = pairwise([0, *changes.tolist(), len(self.label)])
        return [(first, stop, LABEL_OF[self.label[first]]) for first, stop in ends]


def read_payloads(
    source: Path, only: str = "*", *, raw: bool = False
) -> list[TrialPayload]:
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

    # Names are compared before a trial is read, so that choosing a few of many trials is quick.
    readers = {
        _name(one.place.path, root): one for one in reader_of(layout).readers(root)
    }
    chosen = [readers[name] for name in readers if fnmatch(name, only)]
    if not chosen:
        raise DataNotFound(
            f"no trial matches {only!r}",
            where=root,
            next_step=f"its trials are {listed(list(readers), most=3)}",
        )

    return [_payload(reader.place.path, reader.read(), raw) for reader in chosen]


def _name(path: Path, root: Path) -> str:
    """The trial_id that a trial will have, known before it is read."""
    # The recorder makes a folder of each trial; elsewhere a trial is a file.
    place = path.parent if path.name == TACTILE else path.with_suffix("")
    return root.name if place == root else place.relative_to(root).as_posix()


def _payload(path: Path, timed: TimedTrial, raw: bool) -> TrialPayload:
    """The payload of a trial that was read. raw: values as recorded."""
    # Read again, since a reader gives prepared samples, and `raw` wants those of the file.
    trial = read_trial(path, hand_card_near(path))
    recording = timed.recording

    # Rows in no phase keep NO_LABEL: no other situation is assumed for them.
    label = np.full(len(trial.t_s), NO_LABEL, dtype=np.int8)
    for phase in recording.phases:
        label[phase.first : phase.stop] = phase.situation

    # Only the recorder's folders have a start.
    is_folder = path.name == TACTILE
    start = read_json(path.with_name(META)).get(START_KEY) if is_folder else None

    # Sign and bias travel with the values, so that either form can be had from the other.
    sign, bias = preparation(recording.unit).learn(trial.raw, trial.valid)

    about = {
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
        START_KEY: start,
    }
    return TrialPayload(
        recording=recording,
        t_s=trial.t_s,
        values=trial.raw if raw else recording.samples,
        label=label,
        start_ns=_start_ns(start),
        about=about,
    )


def _start_ns(start: object) -> int:
    """The start in a recorder's meta.json in ns since 1970; 0 where it gives none."""
    try:
        return int(datetime.fromisoformat(str(start)).timestamp()) * 1_000_000_000
    except ValueError:
        return 0
