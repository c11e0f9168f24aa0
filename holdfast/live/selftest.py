"""Self-checks of a model file on the machine that will run it.

Each check is a statement that must hold, with a figure: first those of the graph (graph_checks.py),
then those of what surrounds it: the monitor and the clock. All checks together take
some thousand steps, a second on a small board.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from holdfast.core.clock import MonotonicClock
from holdfast.core.contract import (
    CheckResult,
    Sample,
)
from holdfast.core.errors import HoldfastError
from holdfast.edge_runtime.model import (
    AMPLITUDE,
    Model,
    golden_answers,
    golden_of,
)
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.live.graph_checks import (
    check_one_against_many,
    check_reset,
)

CLOCK_READS = 20_000
WAITS = 20
"""Of WAIT_NS each."""
WAIT_NS = 1_000_000


def self_checks(path: str | Path) -> Iterator[CheckResult]:
    """All checks of a model file, each as soon as it is done.

    A file that cannot be opened fails the first check, and no other check follows.
    """
    try:
        model = Model(path)
    except HoldfastError as error:
        reason = f"{type(error).__name__}: {error}"
        yield CheckResult("seal, card and golden rows", False, reason)
        return

    yield _golden(model)
    for check in CHECKS:
        try:
            yield from check(model)
        # a check that raises has failed, and the others still run
        except Exception as error:
            what = check.__name__.strip("_").removeprefix("check_").replace("_", " ")
            yield CheckResult(what, False, f"{type(error).__name__}: {error}")


def _golden(model: Model) -> CheckResult:
    """Opening the file has compared the golden rows already; this reports how close they are."""
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
    figure = f"{n_rows} rows of {len(stored)} outputs, off by {worst:.1e}"

    return CheckResult("seal, card and golden rows", True, figure)


def check_unknown(model: Model) -> Iterator[CheckResult]:
    """The state must be unknown until settled, and again after too many sensors are lost."""
    card = model.card
    monitor = GripMonitor(model, None)
    period_ns = round(1e9 / card.rate_hz)
    sensors = card.n_channels // 3
    too_few = np.arange(sensors) < max(card.min_valid_sensors, 1) - 1
    settle = card.settle_samples
    gap = card.gap_samples

    # long enough to settle, to lose sight of the hand, and to settle again
    before = settle + 5
    between = gap + 5
    after = settle + 5

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
    yield CheckResult("unknown when it must be", missed + needless == 0, figure)


def check_clock(model: Model) -> Iterator[CheckResult]:
    """The schedule's clock never steps back, and a wait never ends too early."""
    clock = MonotonicClock()
    # a clock that can be set could step back
    steps = np.diff([clock.now_ns() for _ in range(CLOCK_READS)])
    back = int((steps < 0).sum())
    finest = int(steps[steps > 0].min(initial=10**9))

    early = 0
    latest_ns = 0
    for _ in range(WAITS):
        due_ns = clock.now_ns() + WAIT_NS
        clock.wait_until(due_ns)
        late_ns = clock.now_ns() - due_ns
        early += late_ns < 0
        latest_ns = max(latest_ns, late_ns)

    figure = (
        f"{CLOCK_READS} readings, {back} back, finest step {finest} ns; "
        f"{WAITS} waits, {early} too short, late by {latest_ns / 1e3:.0f} us at most"
    )
    yield CheckResult("clock", back + early == 0, figure)


CHECKS: tuple[Callable[[Model], Iterator[CheckResult]], ...] = (
    check_one_against_many,
    check_reset,
    check_unknown,
    check_clock,
)
