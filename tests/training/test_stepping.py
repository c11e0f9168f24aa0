"""Many recordings through a step graph: how far it is, and that threads change nothing."""

from __future__ import annotations

import numpy as np
from small_model import spec

from holdfast.data.recording import Recording
from holdfast.edge_runtime.graph import open_session, run_recordings, steps_of
from holdfast.step.features import feature_graph
from holdfast.training.crossval import stepped


def recordings_of(lengths: list[int]) -> list[Recording]:
    rng = np.random.default_rng(0)
    return [
        Recording(
            f"t{k}",
            f"t{k}",
            rng.normal(size=(n, 6)),
            np.ones((n, 2), dtype=np.bool_),
            50.0,
            "N",
        )
        for k, n in enumerate(lengths)
    ]


def test_threads_change_no_bit_and_every_share_done_is_reported() -> None:
    recordings = recordings_of([9, 3, 7, 5, 8])
    values = [one.samples for one in recordings]
    valid = [one.valid for one in recordings]
    rows = [np.arange(len(samples)) for samples in values]
    session = open_session(feature_graph(spec(rate_hz=100.0)).SerializeToString())
    shares: list[float] = []
    found = stepped(steps_of(session, ["features"]), recordings, rows, shares.append)
    alone = run_recordings(session, values, valid, ["features"], rows)
    for here, there in zip(found, alone, strict=True):
        np.testing.assert_array_equal(here["features"], there["features"])
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
