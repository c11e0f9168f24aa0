"""Self-checks of a model file on the machine that will run it.

Each check is a statement that must hold, with a figure: first those of the graph (graph_checks.py),
then those of what surrounds it: the monitor, the decision and the clock. All checks together take
some fifteen thousand steps, a few seconds on a small board.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from holdfast.core.clock import MonotonicClock
from holdfast.core.contract import (
    GRASP,
    RISKY_SLIP,
    CheckResult,
    FloatArray,
    Sample,
    State,
)
from holdfast.core.errors import HoldfastError
from holdfast.edge_runtime.decision import UNKNOWN, DecisionState, decide, period_us
from holdfast.edge_runtime.health import RING
from holdfast.edge_runtime.model import (
    AMPLITUDE,
    Model,
    golden_answers,
    golden_from_json,
)
from holdfast.edge_runtime.model_file import GOLDEN_KEY
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.live.graph_checks import (
    check_answers,
    check_corrupted_samples,
    check_large_offset,
    check_one_against_many,
    check_reset,
    check_silence_and_memory,
    clean_input,
)

CERTAIN_PERMILLE = 1000
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
    metadata = model.session.get_modelmeta().custom_metadata_map
    stored = golden_from_json(metadata[GOLDEN_KEY])
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


def check_unbelievable(model: Model) -> Iterator[CheckResult]:
    """Samples that look good and must not be believed: a stuck hand, a wrong rate, late answers.

    After a start under load, the answer must not be "nothing".
    """
    card = model.card
    settle = card.settle_samples
    period_ns = round(1e9 / card.rate_hz)
    count = 3 * settle + RING

    # moving long enough to settle, then repeated in a longer cycle than RING
    values, _ = clean_input(model)
    alive = values[:settle]
    live = np.resize(alive, (count, card.n_channels))
    stuck = np.resize(alive[-3:], (count, card.n_channels))

    def late_clock() -> int:
        return count * 10 * period_ns

    slow_ns = round(period_ns / 0.7)
    cases = {
        "a stuck hand": _states(GripMonitor(model, None), stuck, period_ns),
        "0.7 of the rate": _states(GripMonitor(model, None), live, slow_ns),
        "a standing clock": _states(GripMonitor(model, None), live, 0),
        "late answers": _states(GripMonitor(model, late_clock), live, period_ns),
    }

    believed = []
    for name, states in cases.items():
        if set(states[settle + RING :]) != {"unknown"}:
            believed.append(name)

    verdict = f"believed: {', '.join(believed)}" if believed else "unknown"
    figure = f"{', '.join(cases)}: {verdict}"
    yield CheckResult("unbelievable samples", not believed, figure)

    # a little noise, so that the hand does not repeat itself
    noise = 1.0 + live[: settle + 1] * 1e-9
    loaded = 2.0 * card.normal_floor * noise
    monitor = GripMonitor(model, None, bias_known=True)
    states = _states(monitor, loaded, period_ns)
    wrong = states.count("nothing")
    figure = f"{len(states)} samples, {wrong} nothing"
    yield CheckResult("a start under load", not wrong, figure)


def _states(monitor: GripMonitor, values: FloatArray, period_ns: int) -> list[State]:
    """The state at every sample [T, C], stamps period_ns apart."""
    valid = np.ones(values.shape[1] // 3, dtype=np.bool_)
    states = []
    for k, row in enumerate(values):
        answer = monitor.feed(Sample(k * period_ns, row, valid, k))
        states.append(answer.state)
    return states


def check_decision(model: Model) -> Iterator[CheckResult]:
    """The model's own decision rules.

    A run acts, an override ends it, and missing evidence times out.
    """
    rules = model.card.decision
    period = period_us(model.card.rate_hz)

    def risky(state: DecisionState, override: bool = False) -> DecisionState:
        return decide(
            rules,
            state,
            RISKY_SLIP,
            CERTAIN_PERMILLE,
            period_us=period,
            override=override,
        )

    # as many risky samples as an act needs
    acting = DecisionState()
    for _ in range(rules.act_samples):
        acting = risky(acting)

    # all risky: only the override keeps it from acting
    overridden = risky(acting, override=True)
    longest_us = 0
    state = overridden
    while state.overridden and longest_us <= 1000 * rules.override_ms:
        state = risky(state)
        longest_us += period
        if state.act:
            break

    # no more evidence from here on, for longer than any rule allows
    alone = acting
    longest_ms = max(rules.evidence_ms, rules.override_ms)
    samples = -(-1000 * longest_ms // period) + rules.act_samples
    for _ in range(samples):
        alone = decide(rules, alone, GRASP, 0, period_us=period)

    # in an unknown state, in which nothing else may end an act
    opened = decide(rules, acting, UNKNOWN, 0, period_us=period, opening=True)

    holds = acting.act and not overridden.act and longest_us >= 1000 * rules.override_ms
    figure = (
        f"override lasts {longest_us / 1e6:.2f} s; an act without evidence is {alone.ended}; "
        f"an opened hand's act is {opened.ended}"
    )
    ok = holds and alone.ended == "timed_out" and opened.ended == "opened"
    yield CheckResult("decision", ok, figure)


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
    check_corrupted_samples,
    check_silence_and_memory,
    check_reset,
    check_answers,
    check_unknown,
    check_unbelievable,
    check_decision,
    check_large_offset,
    check_clock,
)
