"""`holdfast doctor MODEL`: short checks of a model file on the machine that will run it.

Each check is a law that must hold, with a figure: golden rows, one recording against a batch,
reset, unknown, and the clock. The input is the golden input of model.py, which is made by formula
and never from a recording. All together take some thousand steps, a second on a small board.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from holdfast.core.clock import MonotonicClock
from holdfast.core.contract import BoolArray, FloatArray, Sample
from holdfast.core.errors import HoldfastError
from holdfast.edge_runtime.graph import (
    Outputs,
    StepGraph,
    run_recording,
    run_recordings,
)
from holdfast.edge_runtime.model import (
    AMPLITUDE,
    Model,
    golden_answers,
    golden_input,
    golden_of,
)
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.live.doctor import Finding

BATCH = (1.0, 0.5, 2.0, -1.0)
"""Factors: each recording of the batch is the golden input times one of these."""
CLOCK_READS = 20_000
WAITS, WAIT_NS = 20, 1_000_000
GOLDEN = "golden rows"
DO_NOT_USE = "do not use this file here; export it again, or report this line"


def model_checks(path: str | Path) -> Iterator[Finding]:
    """All checks of a model file, each as soon as it is done.

    A file that cannot be opened fails the first check, and no other check follows.
    """
    try:
        model = Model(path)
    except HoldfastError as error:
        reason = f"{type(error).__name__}: {error}"
        yield _finding(GOLDEN, False, reason)
        return

    for what, check in CHECKS.items():
        try:
            yield _finding(what, *check(model))
        # a check that raises has failed, and the others still run
        except Exception as error:
            yield _finding(what, False, f"{type(error).__name__}: {error}")


def _finding(what: str, holds: bool, figure: str) -> Finding:
    if holds:
        return Finding(what, "ok", figure)
    return Finding(what, "broken", figure, DO_NOT_USE)


def golden_rows(model: Model) -> tuple[bool, str]:
    """Opening the file has compared them already; this reports how close they are."""
    card = model.card
    stored = golden_of(model.session.get_modelmeta().custom_metadata_map)
    answers = golden_answers(
        model.session, card.n_channels, card.unit, card.settle_samples
    )
    worst = 0.0
    for name, rows in stored.items():
        off = np.abs(answers[name].astype(float) - rows.astype(float))
        worst = max(worst, float(off.max()))
    n_rows = len(stored["votes"])
    return True, f"{n_rows} rows of {len(stored)} outputs, off by {worst:.1e}"


def one_against_many(model: Model) -> tuple[bool, str]:
    """A recording alone and the same one in a batch must give the same bits."""
    values, valid = _clean_input(model)
    names = [one.name for one in model.session.get_outputs()]
    names.remove("state_out")

    # different recordings, so that one that leaks into another shows
    scaled = [values * factor for factor in BATCH]
    flags = [valid] * len(BATCH)
    rows = [np.arange(len(values))] * len(BATCH)
    together = run_recordings(model.session, scaled, flags, names, rows)
    different = set()
    for recording, of_batch in zip(scaled, together, strict=True):
        alone = run_recording(model.session, recording, valid, names)
        different.update(_different(alone, of_batch))

    figure = f"{len(values)} rows, {len(BATCH)} together: {_verdict(different)}"
    return not different, figure


def reset_forgets(model: Model) -> tuple[bool, str]:
    """After a reset the graph must answer as a fresh one does, bit for bit."""
    values, valid = _clean_input(model)
    graph = StepGraph(model.session)
    first = _outputs_and_states(graph, values, valid)
    # something else in between, which a reset must forget
    _outputs_and_states(graph, -3.0 * values, ~valid)
    graph.reset()
    different = _different(first, _outputs_and_states(graph, values, valid))
    return not different, f"{len(values)} rows again: {_verdict(different)}"


def unknown_in_time(model: Model) -> tuple[bool, str]:
    """The state must be unknown until settled, and again after too many sensors are lost."""
    card = model.card
    monitor = GripMonitor(model, None)
    period_ns = round(1e9 / card.rate_hz)
    sensors = card.n_channels // 3
    too_few = np.arange(sensors) < max(card.min_valid_sensors, 1) - 1

    # long enough to settle, to lose sight of the hand, and to settle again
    settle = card.settle_samples
    before = after = settle + 5
    between = card.gap_samples + 5
    missed = needless = must = 0
    for k in range(before + between + after):
        lost = before <= k < before + between
        valid = too_few if lost else np.ones(sensors, dtype=np.bool_)
        # the values are good, so only the flags can make the state unknown
        moving = np.full(card.n_channels, AMPLITUDE[card.unit] * k / 1024)
        answer = monitor.feed(Sample(k * period_ns, moving, valid, k))
        unknown = answer.state == "unknown"
        # the sample that completes the history is the first that is answered
        settling = k < settle - 1
        lost_or_settling = before <= k < before + between + settle - 1
        if settling or lost_or_settling:
            must += 1
            missed += not unknown
        else:
            needless += unknown

    figure = f"{must} samples; missed {missed}, needless {needless}"
    return missed + needless == 0, figure


def clock_goes_on(model: Model) -> tuple[bool, str]:
    """The schedule's clock never steps back, and a wait never ends too early."""
    clock = MonotonicClock()
    # a clock that can be set could step back
    steps = np.diff([clock.now_ns() for _ in range(CLOCK_READS)])
    back = int((steps < 0).sum())

    early = latest_ns = 0
    for _ in range(WAITS):
        due_ns = clock.now_ns() + WAIT_NS
        clock.wait_until(due_ns)
        late_ns = clock.now_ns() - due_ns
        early += late_ns < 0
        latest_ns = max(latest_ns, late_ns)

    figure = (
        f"{CLOCK_READS} readings, {back} back; {WAITS} waits, {early} too short, "
        f"late by {latest_ns / 1e3:.0f} us at most"
    )
    return back + early == 0, figure


def _clean_input(model: Model) -> tuple[FloatArray, BoolArray]:
    """The golden input [T, C] and [T, S] without its corrupted and lost samples."""
    card = model.card
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
    good = np.isfinite(values) & (np.abs(values) < 1e6)
    return np.where(good, values, 0.0), np.ones_like(valid)


def _outputs_and_states(
    graph: StepGraph, values: FloatArray, valid: BoolArray
) -> Outputs:
    """Every output and the state at every row; the graph may have stepped before."""
    kept: dict[str, list[np.ndarray]] = {name: [] for name in (*graph.out, "state")}
    for row, flags in zip(values, valid, strict=True):
        np.copyto(graph.sample[0], row)
        np.copyto(graph.valid[0], flags)
        # copied, because the graph reuses its buffers
        for name, array in graph.step().items():
            kept[name].append(array[0].copy())
        kept["state"].append(graph.state[0].copy())
    return {name: np.array(rows) for name, rows in kept.items()}


def _different(one: Outputs, other: Outputs) -> list[str]:
    """Names of the outputs whose bits differ."""
    return [name for name in one if one[name].tobytes() != other[name].tobytes()]


def _verdict(different: set[str] | list[str]) -> str:
    return f"{', '.join(sorted(different))} differ" if different else "the same bits"


CHECKS: dict[str, Callable[[Model], tuple[bool, str]]] = {
    GOLDEN: golden_rows,
    "one sample against a batch": one_against_many,
    "reset forgets": reset_forgets,
    "unknown when it must be": unknown_in_time,
    "clock": clock_goes_on,
}
