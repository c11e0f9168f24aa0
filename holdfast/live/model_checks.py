"""`holdfast doctor MODEL`: short checks of a model file on the machine that will run it.

Each check is a law that must hold, with a figure: golden rows, one recording against a batch, and
reset. The input is the golden input of model.py, which is made by formula and never from a
recording. All together take some thousand steps, a second on a small board.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import HoldfastError
from holdfast.edge_runtime.graph import StepGraph, run_recordings
from holdfast.edge_runtime.model import Model, golden_input, golden_of
from holdfast.live.doctor import Finding, findings_of

BATCH = (1.0, 0.5, 2.0, -1.0)
"""Factors: each recording of the batch is the golden input times one of these."""
GOLDEN = "golden rows"
DO_NOT_USE = "do not use this file here; export it again, or report this line"
Law = Callable[[Model, FloatArray, BoolArray], bool]
"""Whether it holds, for values [T, C] that are valid [T, S]."""


def model_checks(path: str | Path) -> Iterator[Finding]:
    """All checks of a model file, each as soon as it is done.

    A file that cannot be opened fails the first check, and no other check follows.
    """
    # opening a file compares its golden rows: it would fail
    try:
        model = Model(path)
    except HoldfastError as error:
        reason = f"{type(error).__name__}: {error}"
        yield Finding(GOLDEN, "broken", reason, DO_NOT_USE)
        return

    stored = golden_of(model.session.get_modelmeta().custom_metadata_map)
    rows = f"{len(stored['votes'])} rows of {len(stored)} outputs, as at its export"
    yield Finding(GOLDEN, "ok", rows)
    for what, law in LAWS.items():
        yield from findings_of(what, partial(_judged, what, law, model))


def _judged(what: str, law: Law, model: Model) -> list[Finding]:
    """Whether a law holds for the golden input without its corrupted and lost samples."""
    card = model.card
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)

    # zeros in place of its corrupted samples
    good = np.isfinite(values) & (np.abs(values) < 1e6)
    if law(model, np.where(good, values, 0.0), np.ones_like(valid)):
        return [Finding(what, "ok", f"{len(values)} rows: the same bits")]
    return [Finding(what, "broken", "the same rows give other bits", DO_NOT_USE)]


def one_against_many(model: Model, values: FloatArray, valid: BoolArray) -> bool:
    """A recording alone and the same one in a batch must give the same bits."""
    # different recordings, so that one that leaks into another shows
    recordings = [values * factor for factor in BATCH]

    alone = []
    for recording in recordings:
        alone += _recorded(model, [recording], valid)
    return alone == _recorded(model, recordings, valid)


def reset_forgets(model: Model, values: FloatArray, valid: BoolArray) -> bool:
    """After a reset the graph must answer as a fresh one does, bit for bit."""
    graph = StepGraph(model.session)
    first = _stepped(graph, values, valid)
    # something else in between, which a reset must forget
    _stepped(graph, -3.0 * values, ~valid)
    graph.reset()
    return _stepped(graph, values, valid) == first


def _recorded(
    model: Model, recordings: list[FloatArray], valid: BoolArray
) -> list[bytes]:
    """Every output at every row, of recordings that run together, one after the other."""
    names = [one.name for one in model.session.get_outputs()]
    names.remove("state_out")

    n = len(recordings)
    rows = [np.arange(len(valid))] * n
    bits = []
    for outputs in run_recordings(model.session, recordings, [valid] * n, names, rows):
        bits += [outputs[name].tobytes() for name in names]
    return bits


def _stepped(graph: StepGraph, values: FloatArray, valid: BoolArray) -> list[bytes]:
    """Every output and the state at every row; the graph may have stepped before."""
    bits = []
    for row, flags in zip(values, valid, strict=True):
        np.copyto(graph.sample[0], row)
        np.copyto(graph.valid[0], flags)
        bits += [array.tobytes() for array in (*graph.step().values(), graph.state)]
    return bits


LAWS: dict[str, Law] = {
    "one sample against a batch": one_against_many,
    "reset forgets": reset_forgets,
}
