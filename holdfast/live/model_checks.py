"""`holdfast doctor MODEL`: short checks of a model file on the machine that will run it.

Each check is a law that must hold, with a figure: golden rows, one recording against a batch, and
reset. The input is the golden input of model.py, which is made by formula
and never from a recording. All together take some thousand steps, a second on a small board.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import HoldfastError
from holdfast.edge_runtime.graph import StepGraph, run_recording, run_recordings
from holdfast.edge_runtime.model import Model, golden_input, golden_of
from holdfast.live.doctor import Finding, findings_of

BATCH = (1.0, 0.5, 2.0, -1.0)
"""Factors: each recording of the batch is the golden input times one of these."""
GOLDEN = "golden rows"
ModelCheck = Callable[[Model], tuple[bool, str]]
"""Whether a law holds for a model, and a figure."""
DO_NOT_USE = "do not use this file here; export it again, or report this line"


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

        def judged(what: str = what, check: ModelCheck = check) -> list[Finding]:
            holds, figure = check(model)
            if holds:
                return [Finding(what, "ok", figure)]
            return [Finding(what, "broken", figure, DO_NOT_USE)]

        yield from findings_of(what, judged)


def golden_rows(model: Model) -> tuple[bool, str]:
    """Opening the file has compared them: it would have failed."""
    stored = golden_of(model.session.get_modelmeta().custom_metadata_map)
    n_rows = len(stored["votes"])
    return True, f"{n_rows} rows of {len(stored)} outputs, as at its export"


def one_against_many(model: Model) -> tuple[bool, str]:
    """A recording alone and the same one in a batch must give the same bits."""
    values, valid = _clean_input(model)
    names = [one.name for one in model.session.get_outputs()]
    names.remove("state_out")

    # different recordings, so that one that leaks into another shows
    scaled = [values * factor for factor in BATCH]
    count = len(BATCH)
    rows = [np.arange(len(values))] * count
    together = run_recordings(model.session, scaled, [valid] * count, names, rows)
    different = set()
    for recording, of_batch in zip(scaled, together, strict=True):
        alone = run_recording(model.session, recording, valid, names)
        different |= {
            name for name in names if alone[name].tobytes() != of_batch[name].tobytes()
        }

    differ = ", ".join(sorted(different)) or "none"
    return not different, f"{len(values)} rows, {count} together: {differ} differ"


def reset_forgets(model: Model) -> tuple[bool, str]:
    """After a reset the graph must answer as a fresh one does, bit for bit."""
    values, valid = _clean_input(model)
    graph = StepGraph(model.session)
    first = _bits(graph, values, valid)
    # something else in between, which a reset must forget
    _bits(graph, -3.0 * values, ~valid)
    graph.reset()
    same = _bits(graph, values, valid) == first
    return same, f"{len(values)} rows again: the same bits: {same}"


def _clean_input(model: Model) -> tuple[FloatArray, BoolArray]:
    """The golden input [T, C] and [T, S] without its corrupted and lost samples."""
    card = model.card
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
    good = np.isfinite(values) & (np.abs(values) < 1e6)
    return np.where(good, values, 0.0), np.ones_like(valid)


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
