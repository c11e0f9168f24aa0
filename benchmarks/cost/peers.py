"""Other ways to a decision, beside the whole step of a file, one row a call:

scikit-learn    predict_proba of 100 full-depth trees on the raw window
a walk in C     the same trees in a few lines of C (where there is a compiler)
treelite        the same trees by its interpreter (where it is installed)
the thesis' way ten band-pass filters a channel, one sample at a time in Python, then scikit-learn
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import numpy as np
from scipy.signal import butter

from benchmarks.cost.forest_c import c_walk
from benchmarks.timed_calls import (
    simulated_set,
    times_beside,
)
from holdfast.core.contract import CLASSES, Json
from holdfast.core.errors import LibraryMissing
from holdfast.edge_runtime.model import Model
from holdfast.export.learner import Forest, reference_votes
from holdfast.export.spec import bands_for
from holdfast.live.bench import CALLS_A_TURN, STEP, TURNS, step_of
from holdfast.training.crossval import fit_learner
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.plan import RAW_BASELINE
from holdfast.training.recording import DataSet

SKLEARN = "scikit-learn, the same trees"
THESIS = "the thesis' way"
WALK = "a walk in C, the same trees"
TREELITE = "treelite, the same trees"
"""Names of the calls."""
LEAST_THESIS_OVER_STEP = 40.0
"""Median of the thesis' way over that of the whole step, of one run (aim 200)."""


def peer_calls(data: DataSet, work: Path) -> dict[str, Callable[[], object]]:
    """Every peer that this machine has, by its name, fitted on a set; each call takes a next row.

    work: a folder for what is compiled.
    """
    rows = features_of(data, spec_for(data, RAW_BASELINE.groups))["classes"]
    everything = np.arange(len(rows))
    forest = fit_learner(data, rows, RAW_BASELINE, "classes", everything, 0)
    return {
        SKLEARN: _predict(forest, rows),
        **_walk(forest, rows, work),
        **_treelite(forest, rows),
        THESIS: _thesis_way(forest, data),
    }


def peer_times(path: Path, turns: int = TURNS, calls: int = CALLS_A_TURN) -> Json:
    """us of a file's step and of every peer, in one run; broken: the limit that does not hold."""
    model = Model(path)
    with tempfile.TemporaryDirectory() as work:
        data = simulated_set(Path(work), model.card.rate_hz)
        step = step_of(model)
        times = times_beside({STEP: step, **peer_calls(data, Path(work))}, turns, calls)
    ratio = times[THESIS]["over_first"]
    line = f"{THESIS} takes {ratio:.1f} steps, less than {LEAST_THESIS_OVER_STEP:g}"
    return {
        "peers": [{"call": name, **of} for name, of in times.items()],
        "broken": [line] if ratio < LEAST_THESIS_OVER_STEP else [],
    }


def _predict(forest: Forest, rows: FloatRows) -> Callable[[], object]:
    # Threads cost more than they save on one row.
    forest.set_params(n_jobs=1)
    turn = cycle(range(len(rows)))

    def call() -> object:
        k = next(turn)
        return forest.predict_proba(rows[k : k + 1])

    return call


def _walk(
    forest: Forest, rows: FloatRows, work: Path
) -> dict[str, Callable[[], object]]:
    """The walk in C, its votes checked against the reference first; empty without a compiler."""
    try:
        votes = c_walk(forest, len(CLASSES), rows, work)
    except LibraryMissing:
        return {}

    # Only a walk with the same votes can be compared with the others.
    # Votes and not labels: a difference that changes no label would still be a mistake.
    expected = reference_votes(forest, rows, len(CLASSES))
    for k in range(len(rows)):
        if not np.array_equal(votes(k), expected[k]):
            raise AssertionError("the walk in C does not vote as the reference does")

    turn = cycle(range(len(rows)))
    return {WALK: lambda: votes(next(turn))}


def _treelite(forest: Forest, rows: FloatRows) -> dict[str, Callable[[], object]]:
    """treelite's own interpreter, one row a call; nothing where it is not installed."""
    try:
        import treelite
    except ImportError:
        return {}

    model = treelite.sklearn.import_model(forest)
    turn = cycle(range(len(rows)))

    def call() -> object:
        k = next(turn)
        return treelite.gtil.predict(model, rows[k : k + 1], nthread=1)

    return {TREELITE: call}


def _thesis_way(forest: Forest, data: DataSet) -> Callable[[], object]:
    """Every sample through ten second-order band-pass filters a channel, in plain Python."""
    samples = data.recordings[0].samples
    # Plain lists: on single numbers Python is faster with them than with numpy.
    filters = []
    for hz in bands_for(data.rate_hz):
        # The thesis' bands: a tenth of the centre frequency to either side.
        edges_hz = (0.9 * hz, 1.1 * hz)
        b, a = butter(1, edges_hz, "bandpass", fs=data.rate_hz)
        filters.append((b.tolist(), a.tolist()))

    memory = []
    for _ in range(samples.shape[1]):
        memory.append([[0.0, 0.0] for _ in filters])

    # The window is kept as float32, which is what the forest compares.
    window = np.zeros((1, forest.n_features_in_), dtype=np.float32)
    turn = cycle(range(len(samples)))

    def call() -> None:
        sample = samples[next(turn)].tolist()
        # Direct form II transposed, as scipy's lfilter has it.
        for value, states in zip(sample, memory, strict=True):
            for (b, a), state in zip(filters, states, strict=True):
                out = b[0] * value + state[0]
                state[0] = b[1] * value - a[1] * out + state[1]
                state[1] = b[2] * value - a[2] * out

        # The window moves on by one sample of all channels.
        n = len(sample)
        window[0, :-n] = window[0, n:]
        window[0, -n:] = sample
        forest.predict_proba(window)

    return call
