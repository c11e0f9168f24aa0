"""The hard cases in short, on the machine that answers and with the very file it answers by.

Every check is a law and a figure; the input is made by formula (golden.py), never from a recording.
Together some fifteen thousand steps: a few seconds on a small board.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_runtime.clock import MonotonicClock
from edge_runtime.contract import GRASP, RISKY_SLIP, BoolArray, FloatArray, Sample
from edge_runtime.decision import UNKNOWN, DecisionState, decide, period_us
from edge_runtime.errors import HoldfastError
from edge_runtime.golden import AMPLITUDE, golden_answers, golden_from_json, golden_input
from edge_runtime.graph import Outputs, StepGraph, run_recording, run_recordings
from edge_runtime.health import RING
from edge_runtime.model_file import GOLDEN_KEY
from edge_runtime.monitor import GripMonitor, Model

SILENT_STEPS = 10_000
WARM_STEPS = 500
MOST_GROWTH_KB = 1024
"""Pages that Python's own allocator takes now and then; a leak of one buffer a step would be a
hundred times more."""
STATM = Path("/proc/self/statm")
PAGE_KB = 4
CLOCK_READS = 20_000
WAITS, WAIT_NS = 20, 1_000_000
BATCH = (1.0, 0.5, 2.0, -1.0)
"""Recordings of a batch: the golden input times these."""


@dataclass(frozen=True)
class Checked:
    """One law, whether it held, and the figure."""

    what: str
    ok: bool
    figure: str


def self_checks(path: str | Path) -> Iterator[Checked]:
    """All checks of a model file, one by one as they are done; a file that cannot be opened is the
    only one."""
    try:
        model = Model(path)
    except HoldfastError as error:
        yield Checked("seal, card and golden rows", False, f"{type(error).__name__}: {error}")
        return
    yield _golden(model)
    for check in CHECKS:
        try:
            yield from check(model)
        # a check that cannot be carried out has failed, and the others go on
        except Exception as error:
            yield Checked(
                check.__name__.strip("_").replace("_", " "),
                False,
                f"{type(error).__name__}: {error}",
            )


def _golden(model: Model) -> Checked:
    """Opening has compared them already; here is how close."""
    card = model.card
    stored = golden_from_json(model.session.get_modelmeta().custom_metadata_map[GOLDEN_KEY])
    answers = golden_answers(model.session, card.n_channels, card.unit, card.settle_samples)
    worst = max(
        float(np.abs(answers[name].astype(float) - stored[name].astype(float)).max())
        for name in stored
    )
    rows = len(next(iter(stored.values())))
    return Checked(
        "seal, card and golden rows",
        True,
        f"{rows} rows of {len(stored)} outputs, off by {worst:.1e}",
    )


def _one_against_many(model: Model) -> Iterator[Checked]:
    values, valid = _input(model)
    names = [one.name for one in model.session.get_outputs() if one.name != "state_out"]
    scaled = [values * factor for factor in BATCH]
    rows = [np.arange(len(values))] * len(BATCH)
    together = run_recordings(model.session, scaled, [valid] * len(BATCH), names, rows)
    alone = [run_recording(model.session, one, valid, names) for one in scaled]
    pairs = list(zip(alone, together, strict=True))
    other = [
        name for name in names if any(_bits(one[name]) != _bits(many[name]) for one, many in pairs)
    ]
    said = f"{', '.join(other)} differ" if other else f"{len(names)} outputs, the same bits"
    yield Checked(
        "one sample against a batch",
        not other,
        f"{len(values)} rows, {len(BATCH)} together: {said}",
    )


def _corrupted_samples(model: Model) -> Iterator[Checked]:
    """NaN, inf and 1e30 are a lost sensor, to the last bit and in the state too, and nothing of
    them comes out."""
    values, valid = _input(model)
    settle, bad_values, lost = model.card.settle_samples, values.copy(), valid.copy()
    places = [(settle + 3 * k, k % model.card.n_channels, evil) for k, evil in enumerate(EVIL * 2)]
    for row, channel, evil in places:
        bad_values[row, channel] = evil
        lost[row, channel // 3] = False
    got, finite = _followed(model, bad_values, valid)
    wanted, _ = _followed(model, values, lost)
    same = all(_bits(got[name]) == _bits(wanted[name]) for name in got)
    said = f"{len(places)} of nan, inf, 1e30: " + (
        "as if lost, to the last bit" if same else "not as if lost"
    )
    yield Checked("corrupted samples", same and finite, said + ("" if finite else "; not finite"))


EVIL = (np.nan, np.inf, -np.inf, 1e30, -1e30)


def _silence_and_memory(model: Model) -> Iterator[Checked]:
    """A press and a shake, then the same reading for ever."""
    graph, (values, _) = StepGraph(model.session), _input(model)
    tiny, smallest, subnormal = float(np.finfo(np.float64).tiny), np.inf, 0
    for row in values[: model.card.settle_samples + 5]:
        np.copyto(graph.sample[0], row)
        graph.step()
    for _ in range(WARM_STEPS):
        graph.step()
    before_kb = _resident_kb()
    for k in range(SILENT_STEPS):
        graph.step()
        if k % 10 == 0:
            size = np.abs(graph.state[graph.state != 0.0])
            subnormal += int((size < tiny).sum())
            smallest = min(smallest, float(size.min(initial=np.inf)))
    grown_kb = _resident_kb() - before_kb
    yield Checked(
        "silence",
        subnormal == 0,
        f"{subnormal} subnormal numbers, the smallest state {smallest:.1e}",
    )
    yield Checked("memory", grown_kb <= MOST_GROWTH_KB, f"{SILENT_STEPS} steps, {grown_kb:+d} kB")


def _reset(model: Model) -> Iterator[Checked]:
    values, valid = _input(model)
    graph = StepGraph(model.session)
    first = _walked(graph, values, valid)
    _walked(graph, -3.0 * values, ~valid)
    graph.reset()
    again = _walked(graph, values, valid)
    other = [name for name in first if _bits(first[name]) != _bits(again[name])]
    said = f"{', '.join(other)} differ" if other else "the same bits"
    yield Checked("reset forgets", not other, f"{len(values)} rows again: {said}")


def _votes(model: Model) -> Iterator[Checked]:
    values, valid = _input(model)
    votes = run_recording(model.session, values, valid, ["votes"])["votes"].astype(np.float64)
    head = model.card.raw["heads"]["situation"]
    wanted = head["trees"] * 2 ** head["vote_bits"]
    sums = np.unique(votes.sum(axis=1))
    whole = bool((votes == np.round(votes)).all()) and sums.tolist() == [wanted]
    said = f"{head['trees']} trees x 2^{head['vote_bits']} = {wanted}, found {sums[:3].tolist()}"
    yield Checked("votes", whole, said)


def _unknown(model: Model) -> Iterator[Checked]:
    """From the start until settled, and as soon as one sensor too many is lost, until settled
    again."""
    card, monitor = model.card, GripMonitor(model, None)
    period_ns, sensors = round(1e9 / card.rate_hz), card.n_channels // 3
    too_few = np.arange(sensors) < max(card.min_valid_sensors, 1) - 1
    settle, gap = card.settle_samples, card.gap_samples
    turns = settle + 5, gap + 5, settle + 5
    states = []
    for k in range(sum(turns)):
        lost = turns[0] <= k < turns[0] + turns[1]
        valid = too_few if lost else np.ones(sensors, dtype=np.bool_)
        # good numbers: the flags alone must do
        moving = np.full(card.n_channels, AMPLITUDE[card.unit] * k / 1024)
        sample = Sample(k * period_ns, moving, valid, k)
        states.append(monitor.feed(sample).state == "unknown")
    must = np.zeros(sum(turns), dtype=np.bool_)
    must[: settle - 1] = True
    must[turns[0] : turns[0] + turns[1] + settle - 1] = True
    bold, shy = int((must & ~np.array(states)).sum()), int((~must & np.array(states)).sum())
    yield Checked(
        "unknown when it must be",
        bold + shy == 0,
        f"{must.sum()} samples; missed {bold}, needlessly {shy}",
    )


def _unbelievable(model: Model) -> Iterator[Checked]:
    """Good-looking samples that must not be believed: a stuck hand, another rate, a late answer, a
    loaded start."""
    card, settle = model.card, model.card.settle_samples
    period_ns, count = round(1e9 / card.rate_hz), 3 * settle + RING
    alive = _input(model)[0][:settle]
    live, stuck = (
        np.resize(alive, (count, card.n_channels)),
        np.resize(alive[-3:], (count, card.n_channels)),
    )
    cases = {
        "a stuck hand": _states(GripMonitor(model, None), stuck, period_ns),
        "0.7 of the rate": _states(GripMonitor(model, None), live, round(period_ns / 0.7)),
        "a standing clock": _states(GripMonitor(model, None), live, 0),
        "late answers": _states(
            GripMonitor(model, lambda: count * 10 * period_ns), live, period_ns
        ),
    }
    bold = [name for name, states in cases.items() if set(states[settle + RING :]) != {"unknown"}]
    yield Checked(
        "unbelievable samples",
        not bold,
        f"{', '.join(cases)}: {'believed: ' if bold else 'unknown'}{', '.join(bold)}",
    )
    loaded = np.full((settle + 1, card.n_channels), 2.0 * card.normal_floor) * (
        1.0 + live[: settle + 1] * 1e-9
    )
    states = _states(GripMonitor(model, None, bias_known=True), loaded, period_ns)
    wrong = states.count("nothing")
    yield Checked("a start under load", not wrong, f"{len(states)} samples, {wrong} nothing")


def _states(monitor: GripMonitor, values: FloatArray, period_ns: int) -> list[str]:
    """The state at every sample [T, C], stamps period_ns apart."""
    there = np.ones(values.shape[1] // 3, dtype=np.bool_)
    return [
        monitor.feed(Sample(k * period_ns, row, there, k)).state for k, row in enumerate(values)
    ]


def _decision(model: Model) -> Iterator[Checked]:
    """The card's own rules, step by step: a run acts, an override ends it and lasts, a silent alarm
    times out."""
    rules, period = model.card.decision, period_us(model.card.rate_hz)
    sure, enough = (
        1000,
        -(-1000 * max(rules.evidence_ms, rules.override_ms) // period) + rules.act_samples,
    )
    acting = DecisionState()
    for _ in range(rules.act_samples):
        acting = decide(rules, acting, RISKY_SLIP, sure, period_us=period)
    overridden, alone = (
        decide(rules, acting, RISKY_SLIP, sure, period_us=period, override=True),
        acting,
    )
    longest_us, state = 0, overridden
    while state.overridden and longest_us <= 1000 * rules.override_ms:
        state, longest_us = (
            decide(rules, state, RISKY_SLIP, sure, period_us=period),
            longest_us + period,
        )
        if state.act:
            break
    for _ in range(enough):
        alone = decide(rules, alone, GRASP, 0, period_us=period)
    opened = decide(rules, acting, UNKNOWN, 0, period_us=period, opening=True)
    holds = acting.act and not overridden.act and longest_us >= 1000 * rules.override_ms
    ok = holds and alone.ended == "timed_out" and opened.ended == "opened"
    yield Checked(
        "decision",
        ok,
        f"override lasts {longest_us / 1e6:.2f} s; an act without evidence is {alone.ended}; "
        f"an opened hand's act is {opened.ended}",
    )


def _large_offset(model: Model) -> Iterator[Checked]:
    """A power of two on every channel, which the input's numbers take without rounding: no
    vibration is lost."""
    values, valid = _input(model)
    offset = 2.0 ** np.floor(np.log2(0.5 * model.card.raw["range_limit"]))
    columns = [k for k, name in enumerate(model.card.detectors) if name.startswith("band_pass")]
    plain, moved = (
        run_recording(model.session, one, valid, ["detectors"])["detectors"][:, columns]
        for one in (values, values + offset)
    )
    differ = int((plain != moved).sum())
    said = f"{offset:g} {model.card.unit} on every channel: {int(plain.sum())} firings, {differ} differ"
    yield Checked("a large offset", differ == 0, said)


def _clock(model: Model) -> Iterator[Checked]:
    """What the schedule runs by never steps back, and a wait is never over too early."""
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
    said = f"{CLOCK_READS} readings, {back} back, finest step {finest} ns; {WAITS} waits, {early} too short"
    yield Checked("clock", back + early == 0, f"{said}, late by {latest_ns / 1e3:.0f} us at most")


CHECKS: tuple[Callable[[Model], Iterator[Checked]], ...] = (
    _one_against_many,
    _corrupted_samples,
    _silence_and_memory,
    _reset,
    _votes,
    _unknown,
    _unbelievable,
    _decision,
    _large_offset,
    _clock,
)


def _input(model: Model) -> tuple[FloatArray, BoolArray]:
    """The golden input [T, C] and [T, S] without its faults."""
    values, valid = golden_input(model.card.n_channels, model.card.unit, model.card.settle_samples)
    good = np.isfinite(values) & (np.abs(values) < 1e6)
    return np.where(good, values, 0.0), np.ones_like(valid)


def _walked(graph: StepGraph, values: FloatArray, valid: BoolArray) -> Outputs:
    """Every output at every row, and the state after the last, through a graph that may have a
    past."""
    kept: dict[str, list[Any]] = {name: [] for name in graph.out}
    for row, flags in zip(values, valid, strict=True):
        np.copyto(graph.sample[0], row)
        np.copyto(graph.valid[0], flags)
        for name, array in graph.step().items():
            kept[name].append(array[0].copy())
    return {**{name: np.array(rows) for name, rows in kept.items()}, "state": graph.state.copy()}


def _followed(model: Model, values: FloatArray, valid: BoolArray) -> tuple[Outputs, bool]:
    """What came out of a fresh graph, and whether all of it, the state too, was finite at every
    step."""
    graph, finite = StepGraph(model.session), True
    kept: dict[str, list[Any]] = {name: [] for name in (*graph.out, "state")}
    for row, flags in zip(values, valid, strict=True):
        np.copyto(graph.sample[0], row)
        np.copyto(graph.valid[0], flags)
        for name, array in {**graph.step(), "state": graph.state}.items():
            kept[name].append(array[0].copy())
            finite = finite and bool(np.isfinite(array.astype(np.float64)).all())
    return {name: np.array(rows) for name, rows in kept.items()}, finite


def _bits(array: npt.NDArray[Any]) -> bytes:
    return array.tobytes()


def _resident_kb() -> int:
    """Memory of this process; 0 where the system does not tell."""
    return int(STATM.read_text(encoding="ascii").split()[1]) * PAGE_KB if STATM.exists() else 0
