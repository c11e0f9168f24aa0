"""Self-checks of the step graph: batches and reset.

Each check takes an opened model and yields results with a figure. The input is the golden input of
model.py, which is made by formula and never from a recording.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from holdfast.core.contract import BoolArray, CheckResult, FloatArray
from holdfast.edge_runtime.graph import (
    Outputs,
    StepGraph,
    run_recording,
    run_recordings,
)
from holdfast.edge_runtime.model import Model, golden_input

BATCH = (1.0, 0.5, 2.0, -1.0)
"""Factors: each recording of the batch is the golden input times one of these."""


def clean_input(model: Model) -> tuple[FloatArray, BoolArray]:
    """The golden input [T, C] and [T, S] without its corrupted and lost samples."""
    card = model.card
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
    good = np.isfinite(values) & (np.abs(values) < 1e6)
    return np.where(good, values, 0.0), np.ones_like(valid)


def check_one_against_many(model: Model) -> Iterator[CheckResult]:
    """A recording alone and the same one in a batch must give the same bits."""
    values, valid = clean_input(model)
    names = _output_names(model)

    # different recordings, so that one that leaks into another shows
    scaled = [values * factor for factor in BATCH]
    flags = [valid] * len(BATCH)
    rows = [np.arange(len(values))] * len(BATCH)
    together = run_recordings(model.session, scaled, flags, names, rows)

    different = set()
    for recording, of_batch in zip(scaled, together, strict=True):
        alone = run_recording(model.session, recording, valid, names)
        different.update(_different(alone, of_batch))

    figure = f"{len(values)} rows, {len(BATCH)} together: "
    figure += _verdict(different, f"{len(names)} outputs, the same bits")
    yield CheckResult("one sample against a batch", not different, figure)


def check_reset(model: Model) -> Iterator[CheckResult]:
    """After a reset the graph must answer as a fresh one does, bit for bit."""
    values, valid = clean_input(model)
    graph = StepGraph(model.session)
    first = _outputs_and_states(graph, values, valid)

    # something else in between, which a reset must forget
    _outputs_and_states(graph, -3.0 * values, ~valid)

    graph.reset()
    different = _different(first, _outputs_and_states(graph, values, valid))
    figure = f"{len(values)} rows again: {_verdict(different, 'the same bits')}"
    yield CheckResult("reset forgets", not different, figure)


def _output_names(model: Model) -> list[str]:
    """All outputs but the state."""
    names = [one.name for one in model.session.get_outputs()]
    names.remove("state_out")
    return names


def _outputs_and_states(
    graph: StepGraph, values: FloatArray, valid: BoolArray
) -> Outputs:
    """Every output and the state at every row; the graph may have stepped before."""
    kept: dict[str, list[np.ndarray]] = {name: [] for name in graph.out}
    kept["state"] = []
    for row, flags in zip(values, valid, strict=True):
        np.copyto(graph.sample[0], row)
        np.copyto(graph.valid[0], flags)
        answers = graph.step()
        # copied, because the graph reuses its buffers
        for name, array in answers.items():
            kept[name].append(array[0].copy())
        kept["state"].append(graph.state[0].copy())

    return {name: np.array(rows) for name, rows in kept.items()}


def _different(one: Outputs, other: Outputs) -> list[str]:
    """Names of the outputs whose bits differ."""
    return [name for name in one if one[name].tobytes() != other[name].tobytes()]


def _verdict(different: set[str] | list[str], same: str) -> str:
    """The end of a figure."""
    return f"{', '.join(sorted(different))} differ" if different else same
