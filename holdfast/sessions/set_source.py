"""SET#N as a source: one trial of a labelled set, by its number or its name."""

from __future__ import annotations

import numpy as np

from holdfast.core.errors import DataNotFound
from holdfast.drivers.replay import Replay


def read_set_trial(name: str, channels: int | None) -> Replay:
    """The trial after the # of a name; the set's reader has prepared its samples.

    Raises a DataError.
    """
    from holdfast.data.datasets import load

    folder, _, chosen = name.rpartition("#")
    data = load(folder, channels=channels, windows="none")
    known = {str(number): one for number, one in enumerate(data.recordings)}
    # A name comes before a number.
    known |= {one.trial_id: one for one in data.recordings}
    if chosen not in known:
        raise DataNotFound(
            f"no trial {chosen!r} among {len(data.recordings)}",
            where=folder,
            next_step=f"give 0..{len(data.recordings) - 1} or {list(known)[-1]!r}",
        )

    recording = known[chosen]
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
