"""What is timed of a model: its learner on one row, and its whole step on one sample."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle

from holdfast.core.contract import FloatArray
from holdfast.edge_runtime.graph import StepGraph, open_session
from holdfast.training.featurise import FloatRows


def learner_call(model: bytes, rows: FloatRows) -> Callable[[], object]:
    """Answers one of the rows [N, F] a call, in turn. model: a file cut at its features."""
    session = open_session(model)
    one = [rows[k : k + 1] for k in range(len(rows))]
    turn = cycle(range(len(rows)))
    return lambda: session.run(["votes"], {"features": one[next(turn)]})


def step_call(model: bytes, samples: FloatArray) -> Callable[[], object]:
    """Steps over one of the samples [T, C] a call, in turn."""
    graph = StepGraph(open_session(model))
    turn = cycle(range(len(samples)))
    graph.valid[:] = True

    def step() -> None:
        graph.sample[0] = samples[next(turn)]
        graph.step()

    return step
