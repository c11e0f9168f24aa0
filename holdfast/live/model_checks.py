"""`holdfast doctor MODEL`: short checks of a model file on the machine that will run it.

Each check is a law that must hold, with a figure: golden rows, one recording against a batch, and
reset. The input is the golden input of model.py, which is made by formula and never from a
recording. All together take some thousand steps, a second on a small board.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from hashlib import sha256
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
ModelCheck = Callable[[Model], str]
"""A figure of a law that holds. Raises LawBroken."""


class LawBroken(Exception):
    """A law that a model file must hold does not hold on this machine."""

    next_step = DO_NOT_USE


def model_checks(path: str | Path) -> Iterator[Finding]:
    """All checks of a model file, each as soon as it is done.

    A file that cannot be opened fails the first check, and no other check follows.
    """
    try:
        model = Model(path)
    except HoldfastError as error:
        reason = f"{type(error).__name__}: {error}"
        yield Finding(GOLDEN, "broken", reason, DO_NOT_USE)
        return

    for what, check in CHECKS.items():
        yield from findings_of(what, partial(_held, what, check, model))


def _held(what: str, check: ModelCheck, model: Model) -> list[Finding]:
    figure = check(model)
    return [Finding(what, "ok", figure)]


def golden_rows(model: Model) -> str:
    """Opening the file has compared them: it would have failed."""
    stored = golden_of(model.session.get_modelmeta().custom_metadata_map)
    n_rows = len(stored["votes"])
    return f"{n_rows} rows of {len(stored)} outputs, as at its export"


def one_against_many(model: Model) -> str:
    """A recording alone and the same one in a batch must give the same bits."""
    values, valid = _clean_input(model)
    # different recordings, so that one that leaks into another shows
    recordings = [values * factor for factor in BATCH]
    together = _digests(model, recordings, valid)
    alone = []
    for recording in recordings:
        alone += _digests(model, [recording], valid)
    if alone != together:
        raise LawBroken(f"{len(BATCH)} recordings together give other bits than alone")
    return f"{len(values)} rows, {len(BATCH)} together: the same bits"


def reset_forgets(model: Model) -> str:
    """After a reset the graph must answer as a fresh one does, bit for bit."""
    values, valid = _clean_input(model)
    graph = StepGraph(model.session)
    first = _bits(graph, values, valid)
    # something else in between, which a reset must forget
    _bits(graph, -3.0 * values, ~valid)
    graph.reset()
    if _bits(graph, values, valid) != first:
        raise LawBroken("after a reset the same rows give other bits")
    return f"{len(values)} rows again: the same bits"


def _clean_input(model: Model) -> tuple[FloatArray, BoolArray]:
    """The golden input [T, C] and [T, S] without its corrupted and lost samples."""
    card = model.card
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
    good = np.isfinite(values) & (np.abs(values) < 1e6)
    return np.where(good, values, 0.0), np.ones_like(valid)


def _digests(model: Model, recordings: list[FloatArray], valid: BoolArray) -> list[str]:
    """A digest of every output at every row, for each of the recordings that run together."""
    names = [one.name for one in model.session.get_outputs()]
    names.remove("state_out")
    flags = [valid] * len(recordings)
    rows = [np.arange(len(valid))] * len(recordings)
    digests = []
    for outputs in run_recordings(model.session, recordings, flags, names, rows):
        digest = sha256()
        for name in names:
            digest.update(outputs[name].tobytes())
        digests.append(digest.hexdigest())
    return digests


def _bits(graph: StepGraph, values: FloatArray, valid: BoolArray) -> str:
    """A digest of every output and the state at every row; the graph may have stepped before."""
    digest = sha256()
    for row, flags in zip(values, valid, strict=True):
        np.copyto(graph.sample[0], row)
        np.copyto(graph.valid[0], flags)
        for array in (*graph.step().values(), graph.state):
            digest.update(array.tobytes())
    return digest.hexdigest()


CHECKS: dict[str, ModelCheck] = {
    GOLDEN: golden_rows,
    "one sample against a batch": one_against_many,
    "reset forgets": reset_forgets,
}
