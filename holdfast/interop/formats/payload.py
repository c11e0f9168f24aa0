"""A trial as every other format gets it: times, values, validity, labels, and its metadata.

Lost samples stay rows, invalid and without a value. Nothing is resampled or filled.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from holdfast.core.contract import NOTHING, SITUATIONS, FloatArray, IntArray, Json
from holdfast.core.errors import DataNotFound, listed
from holdfast.core.hand_card import hand_card_near
from holdfast.core.trial_file import read_trial
from holdfast.core.trial_layout import META, read_json
from holdfast.data.datasets import LAYOUTS, find, layout_of, reader_of
from holdfast.data.datasets.thesis import preparation
from holdfast.data.recording import Recording
from holdfast.data.windows import TimedTrial

LABELS = (*SITUATIONS, "unlabelled")
"""The names of labels by their numbers; -1 is that of a row without one."""


@dataclass(frozen=True)
class TrialPayload:
    """One trial.

    recording: unit, rate and validity; a sensor is valid where it was and has all three values.
    t_s [T] from the first sample; values [T, C] in the recording's unit, nan where a sample was
    lost. label [T]: index into SITUATIONS, -1 for none. about: what is known of the trial, and how
    the values were prepared, for the metadata of a format.
    """

    recording: Recording
    t_s: FloatArray
    values: FloatArray
    label: IntArray
    about: Json


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
    readers = {}
    for reader in reader_of(layout).readers(root):
        path = reader.place.path.relative_to(root).with_suffix("")
        # the recorder makes a folder of each trial
        readers[path.as_posix().removesuffix("/tactile")] = reader
    chosen = [reader for name, reader in readers.items() if fnmatch(name, only)]
    if not chosen:
        raise DataNotFound(
            f"no trial matches {only!r}",
            where=root,
            next_step=f"its trials are {listed(list(readers), most=3)}",
        )

    return [_payload(reader.place.path, reader.read(), raw) for reader in chosen]


def _payload(path: Path, timed: TimedTrial, raw: bool) -> TrialPayload:
    """The payload of a trial that was read. raw: values as recorded."""
    # Read again, since a reader gives prepared samples, and `raw` wants those of the file.
    trial = read_trial(path, hand_card_near(path))
    recording = timed.recording

    # Rows in no phase keep -1: no other situation is assumed for them.
    label = np.full(len(trial.t_s), -1)
    for phase in recording.phases:
        label[phase.first : phase.stop] = phase.situation

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
        # to the second, of the recorder's folders alone
        "started_utc": read_json(path.with_name(META)).get("started_utc"),
    }
    values = trial.raw if raw else recording.samples
    return TrialPayload(recording, trial.t_s, values, label, about)
