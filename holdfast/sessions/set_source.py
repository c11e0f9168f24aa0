"""SET#N as a source: one trial of a labelled set, by its number or its name."""

from __future__ import annotations

import numpy as np

from holdfast.core.errors import DataNotFound
from holdfast.drivers.replay import Replay


def read_set_trial(name: str, channels: int | None) -> Replay:
    """The trial after the # of a name; the set's reader has prepared its samples.

    Raises a DataError.
    """
    from holdfast.training.datasets import load

    folder, _, chosen = name.rpartition("#")
    data = load(folder, channels=channels, windows="none")
    names = [recording.trial_id for recording in data.recordings]
    numbers = list(map(str, range(len(names))))
    # A name comes before a number.
    place = next(
        (all_.index(chosen) for all_ in (names, numbers) if chosen in all_), None
    )
    if place is None:
        raise DataNotFound(
            f"no trial {chosen!r} among {len(names)}",
            where=folder,
            next_step=f"give 0..{len(names) - 1} or {names[0]!r}",
        )

    recording = data.recordings[place]
    t_s = np.arange(len(recording.samples)) / recording.rate_hz
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    return Replay(
        t_ns,
        recording.samples,
        recording.valid,
        recording.rate_hz,
        recording.unit,
        "first samples",
    )
