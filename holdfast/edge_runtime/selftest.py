"""Self-checks of a model file on the machine that will run it.

Each check is a statement that must hold, with a figure. The input is made by formula (golden.py),
never from a recording. All checks together take some fifteen thousand steps, a few seconds on a
small board.

Self-checks of what surrounds the graph: the monitor, the decision and the clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from holdfast.core.clock import MonotonicClock
from holdfast.core.contract import GRASP, RISKY_SLIP, FloatArray, Sample
from holdfast.core.errors import HoldfastError
from holdfast.edge_runtime.check_result import CheckResult, clean_input
from holdfast.edge_runtime.decision import UNKNOWN, DecisionState, decide, period_us
from holdfast.edge_runtime.golden import (
    AMPLITUDE,
    golden_answers,
    golden_from_json,
)
from holdfast.edge_runtime.graph_checks import (
    check_corrupted_samples,
    check_large_offset,
    check_one_against_many,
    check_reset,
    check_silence_and_memory,
    check_votes,
)
from holdfast.edge_runtime.health import RING
from holdfast.edge_runtime.model_file import GOLDEN_KEY
from holdfast.edge_runtime.monitor import GripMonitor, Model

CERTAIN_PERMILLE = 1000
CLOCK_READS = 20_000
WAITS, WAIT_NS = 20, 1_000_000


def check_unknown(model: Model) -> Iterator[CheckResult]:
    """The state must be unknown until settled, and again after too many sensors are lost."""
    card, monitor = model.card, GripMonitor(model, None)
    period_ns, sensors = round(1e9 / card.rate_hz), card.n_channels // 3
    too_few = np.arange(sensors) < max(card.min_valid_sensors, 1) - 1
    settle, gap = card.settle_samples, card.gap_samples
    before, between, after = settle + 5, gap + 5, settle + 5
    states = []
    for k in range(before + between + after):
        lost = before <= k < before + between
        valid = too_few if lost else np.ones(sensors, dtype=np.bool_)
        # the values are good, so only the flags can make the state unknown
        moving = np.full(card.n_channels, AMPLITUDE[card.unit] * k / 1024)
        sample = Sample(k * period_ns, moving, valid, k)
        states.append(monitor.feed(sample).state == "unknown")
    must = np.zeros(len(states), dtype=np.bool_)
    must[: settle - 1] = True
    must[before : before + between + settle - 1] = True
    missed, needless = (
        int((must & ~np.array(states)).sum()),
        int((~must & np.array(states)).sum()),
    )
    yield CheckResult(
        "unknown when it must be",
        missed + needless == 0,
        f"{must.sum()} samples; missed {missed}, needless {needless}",
    )


def check_unbelievable(model: Model) -> Iterator[CheckResult]:
    """Samples that look good and must not be believed: a stuck hand, a wrong rate, late answers.

    After a start under load, the answer must not be "nothing".
    """
    card, settle = model.card, model.card.settle_samples
    period_ns, count = round(1e9 / card.rate_hz), 3 * settle + RING
    alive = clean_input(model)[0][:settle]
    live, stuck = (
        np.resize(rows, (count, card.n_channels)) for rows in (alive, alive[-3:])
    )
    cases = {
        "a stuck hand": _states(GripMonitor(model, None), stuck, period_ns),
        "0.7 of the rate": _states(
            GripMonitor(model, None), live, round(period_ns / 0.7)
        ),
        "a standing clock": _states(GripMonitor(model, None), live, 0),
        "late answers": _states(
            GripMonitor(model, lambda: count * 10 * period_ns), live, period_ns
        ),
    }
    believed = [
        name
        for name, states in cases.items()
        if set(states[settle + RING :]) != {"unknown"}
    ]
    yield CheckResult(
        "unbelievable samples",
        not believed,
        f"{', '.join(cases)}: {'believed: ' if believed else 'unknown'}{', '.join(believed)}",
    )
    loaded = np.full((settle + 1, card.n_channels), 2.0 * card.normal_floor) * (
        1.0 + live[: settle + 1] * 1e-9
    )
    states = _states(GripMonitor(model, None, bias_known=True), loaded, period_ns)
    wrong = states.count("nothing")
    yield CheckResult(
        "a start under load", not wrong, f"{len(states)} samples, {wrong} nothing"
    )


def _states(monitor: GripMonitor, values: FloatArray, period_ns: int) -> list[str]:
    """The state at every sample [T, C], stamps period_ns apart."""
    there = np.ones(values.shape[1] // 3, dtype=np.bool_)
    return [
        monitor.feed(Sample(k * period_ns, row, there, k)).state
        for k, row in enumerate(values)
    ]


def check_decision(model: Model) -> Iterator[CheckResult]:
    """The model's own decision rules.

    A run acts, an override ends it, and missing evidence times out.
    """
    rules, period = model.card.decision, period_us(model.card.rate_hz)
    longest_ms = max(rules.evidence_ms, rules.override_ms)
    enough = -(-1000 * longest_ms // period) + rules.act_samples
    acting = DecisionState()
    for _ in range(rules.act_samples):
        acting = decide(rules, acting, RISKY_SLIP, CERTAIN_PERMILLE, period_us=period)
    overridden = decide(
        rules, acting, RISKY_SLIP, CERTAIN_PERMILLE, period_us=period, override=True
    )
    longest_us, state = 0, overridden
    while state.overridden and longest_us <= 1000 * rules.override_ms:
        state = decide(rules, state, RISKY_SLIP, CERTAIN_PERMILLE, period_us=period)
        longest_us += period
        if state.act:
            break
    alone = acting
    for _ in range(enough):
        alone = decide(rules, alone, GRASP, 0, period_us=period)
    opened = decide(rules, acting, UNKNOWN, 0, period_us=period, opening=True)
    holds = acting.act and not overridden.act and longest_us >= 1000 * rules.override_ms
    ok = holds and alone.ended == "timed_out" and opened.ended == "opened"
    yield CheckResult(
        "decision",
        ok,
        f"override lasts {longest_us / 1e6:.2f} s; an act without evidence is {alone.ended}; "
        f"an opened hand's act is {opened.ended}",
    )


def check_clock(model: Model) -> Iterator[CheckResult]:
    """The schedule's clock never steps back, and a wait never ends too early."""
    clock = MonotonicClock()
    steps = np.diff([clock.now_ns() for _ in range(CLOCK_READS)])
    early, latest_ns = 0, 0
    for _ in range(WAITS):
        due_ns = clock.now_ns() + WAIT_NS
        clock.wait_until(due_ns)
        late_ns = clock.now_ns() - due_ns
        early, latest_ns = early + (late_ns < 0), max(latest_ns, late_ns)
    finest = int(steps[steps > 0].min(initial=10**9))
    back = int((steps < 0).sum())
    readings = f"{CLOCK_READS} readings, {back} back, finest step {finest} ns"
    waits = (
        f"{WAITS} waits, {early} too short, late by {latest_ns / 1e3:.0f} us at most"
    )
    yield CheckResult("clock", back + early == 0, f"{readings}; {waits}")


def self_checks(path: str | Path) -> Iterator[CheckResult]:
    """All checks of a model file, each as soon as it is done.

    A file that cannot be opened fails the first check, and no other check follows.
    """
    try:
        model = Model(path)
    except HoldfastError as error:
        yield CheckResult(
            "seal, card and golden rows", False, f"{type(error).__name__}: {error}"
        )
        return
    yield _golden(model)
    for check in CHECKS:
        try:
            yield from check(model)
        # a check that raises has failed, and the others still run
        except Exception as error:
            yield CheckResult(
                check.__name__.strip("_").removeprefix("check_").replace("_", " "),
                False,
                f"{type(error).__name__}: {error}",
            )


def _golden(model: Model) -> CheckResult:
    """Opening the file has compared the golden rows already; this reports how close they are."""
    card = model.card
    stored = golden_from_json(
        model.session.get_modelmeta().custom_metadata_map[GOLDEN_KEY]
    )
    answers = golden_answers(
        model.session, card.n_channels, card.unit, card.settle_samples
    )
    worst = max(
        float(np.abs(answers[name].astype(float) - stored[name].astype(float)).max())
        for name in stored
    )
    rows = len(next(iter(stored.values())))
    return CheckResult(
        "seal, card and golden rows",
        True,
        f"{rows} rows of {len(stored)} outputs, off by {worst:.1e}",
    )


CHECKS: tuple[Callable[[Model], Iterator[CheckResult]], ...] = (
    check_one_against_many,
    check_corrupted_samples,
    check_silence_and_memory,
    check_reset,
    check_votes,
    check_unknown,
    check_unbelievable,
    check_decision,
    check_large_offset,
    check_clock,
)
