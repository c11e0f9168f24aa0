"""EXPERIMENT `timed=`: the live loop on scans that an emulated FT232H times itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_bench import DEFAULT, go

from holdfast.core.contract import Prediction, Sample
from holdfast.core.errors import UsageError
from holdfast.drivers.bridges import open_virtual
from holdfast.drivers.hand import LiveHand
from holdfast.drivers.layout import LAYOUTS
from holdfast.drivers.timed_bridge import timed_virtual
from holdfast.drivers.timed_hand import TimedHand, TimedLiveHand
from holdfast.drivers.virtual.clock import DeviceClock, VirtualClock
from holdfast.drivers.virtual.virtual_hand import VirtualHand, still
from holdfast.edge_runtime.model import Model
from holdfast.live.hand_sources import open_live
from holdfast.live.loop import Summary

AHEAD = 16
PERIOD_NS = 1e9 / 150
BLOCK_NS = AHEAD // 2 * PERIOD_NS
TARED = 4
"""From this sample on the bias is known."""
HAND_OVER_NS = 3_000_000
"""Reading what the chip kept, and writing a block, until the chip begins it."""


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(DEFAULT)


@dataclass
class Run:
    """What a run answered. woke_ns: when the host came back from each stall."""

    summary: Summary
    answers: list[Prediction]
    samples: list[Sample]
    messages: list[str]
    start_ns: int
    woke_ns: list[int] = field(default_factory=list)

    def due_ns(self, sequence: int) -> float:
        return self.start_ns + sequence * PERIOD_NS

    @property
    def sequences(self) -> list[int]:
        return [one.sequence for one in self.samples]


def run(model: Model, url: str, n: int, stalls: dict[int, float] | None = None) -> Run:
    """n reads; stalls: {read: seconds for which the host is away before it}."""
    clock, messages = VirtualClock(), list[str]()
    source: Any = open_live(url, clock=clock, say=messages.append, runs=True)
    return live(model, source, clock, messages, n, stalls or {})


def live(
    model: Model,
    source: Any,
    clock: VirtualClock,
    messages: list[str],
    n: int,
    stalls: dict[int, float],
) -> Run:
    reads, woke_ns, read = 0, list[int](), source.read

    def read_late() -> Any:
        nonlocal reads
        if reads in stalls:
            clock.spend(round(1e9 * stalls[reads]))
            woke_ns.append(clock.now_ns())
        reads += 1
        return read()

    source.read = read_late
    summary, answers, samples = go(model, source, clock, stopped=lambda: reads >= n)
    start_ns = source._hand._start_ns if isinstance(source, TimedLiveHand) else 0
    source.close()
    return Run(summary, answers, samples, messages, start_ns, woke_ns)


TIMED = f"virtual://ft232h?seed=1&timed={AHEAD}"


# -- the same samples


class Staircase:
    """A field that moves every 20 periods, 4.7 ms before a sample: longer than a conversion."""

    start_ns: int | None = None

    def __init__(self, clock: VirtualClock) -> None:
        self.born_ns = clock.now_ns()

    def at(self, now_s: float, sensor: int) -> list[float]:
        passed_ns = 0.0
        if self.start_ns is not None:
            passed_ns = max(0.0, 1e9 * now_s + self.born_ns - self.start_ns)
        level = 300.0 * int(passed_ns / PERIOD_NS / 20 + 0.7 / 20)
        return [x_ut + level * (sensor + 1) for x_ut in REST.at(0.0, sensor)]


REST = still()


def on_a_staircase(model: Model, n: int, *, timed: bool) -> Run:
    clock = VirtualClock()
    field_of = Staircase(clock)
    hand = VirtualHand(DeviceClock(clock), track=field_of, seed=None)  # type: ignore[arg-type]
    bridge = open_virtual("ft232h", hand, 400_000)
    driver = TimedHand(
        timed_virtual(bridge, clock.now_ns) if timed else bridge,
        LAYOUTS["mux"],
        ahead=AHEAD,
        now_ns=clock.now_ns,
        pause=lambda seconds: clock.spend(round(1e9 * seconds)),
    )
    driver.start()
    source = (TimedLiveHand if timed else LiveHand)(
        driver, lambda field_ut: 1e-3 * field_ut
    )
    field_of.start_ns = clock.now_ns()
    if isinstance(source, TimedLiveHand):
        keep_time = source.keep_time

        def note_start(period_ns: float) -> None:
            keep_time(period_ns)
            field_of.start_ns = driver._start_ns

        source.keep_time = note_start  # type: ignore[method-assign]
    return live(model, source, clock, [], n, {})


def test_on_an_undisturbed_scene_the_samples_are_those_without_the_experiment(model):
    timed, plain = (on_a_staircase(model, 300, timed=one) for one in (True, False))
    assert timed.sequences == plain.sequences == list(range(300))
    assert len(np.unique([one.values[0] for one in plain.samples])) > 10
    for one, other in zip(timed.samples, plain.samples, strict=True):
        assert np.array_equal(one.values, other.values)
    assert all(
        one.valid.all() for one in (*timed.samples[TARED:], *plain.samples[TARED:])
    )
    assert [one.state for one in timed.answers] == [one.state for one in plain.answers]
    assert timed.summary.overruns == plain.summary.overruns == 0


# -- a host that is away


def test_a_stall_within_the_queue_loses_no_sample_and_only_the_newest_answers_count(
    model,
):
    got = run(model, TIMED, 300, {200: 0.05})
    assert got.sequences == list(range(300))
    steps_ns = np.diff([one.t_ns for one in got.samples[2:]])
    assert np.abs(steps_ns - PERIOD_NS).max() < 150_000, "the chip's own times"
    late = [one.sequence for one in got.answers if one.late]
    assert late == [*range(200, 205)], "older than two periods when they are answered"
    assert all(one.why == "late" for one in got.answers if one.late)
    assert {one.state for one in got.answers[205:]} == {"nothing"}, (
        "the history stays whole"
    )
    assert got.summary.overruns == 0
    assert got.summary.too_old == len(late)


def test_without_the_experiment_the_same_stall_loses_samples(model):
    got = run(model, "virtual://ft232h?seed=1", 300, {200: 0.05})
    assert got.summary.overruns == 6


@settings(max_examples=15, deadline=None)
@given(
    stalls=st.dictionaries(
        st.integers(20, 150), st.floats(0.0, 0.4, allow_subnormal=False), max_size=4
    )
)
def test_a_stall_loses_the_periods_for_which_nothing_was_queued_and_no_other(
    model, stalls
):
    got = run(model, TIMED, 180, stalls)
    numbers = np.array(got.sequences)
    assert (np.diff(numbers) >= 1).all()
    assert got.summary.samples + got.summary.overruns == numbers[-1] + 1
    assert (np.diff([one.t_ns for one in got.samples]) > 0).all()
    gaps = [(a, b) for a, b in pairwise(numbers) if b > a + 1]
    for _, again in gaps:
        woke_ns = max(at for at in got.woke_ns if at < got.due_ns(again))
        assert got.due_ns(again) < woke_ns + HAND_OVER_NS + PERIOD_NS, (
            "at the next time left"
        )
        assert got.due_ns(again - 1) < woke_ns + HAND_OVER_NS, (
            "no time that was left is skipped"
        )
    assert len(gaps) <= sum(
        1e9 * one > BLOCK_NS - HAND_OVER_NS for one in stalls.values()
    )


def test_after_a_gap_the_loop_goes_on_and_settles_again(model):
    got = run(model, TIMED, 400, {200: 1.0})
    assert got.summary.overruns == pytest.approx(
        1e9 / PERIOD_NS - AHEAD, abs=AHEAD // 2 + 1
    )
    assert {one.state for one in got.answers[-50:]} == {"nothing"}
    assert (
        max(abs(one.t_ns - got.due_ns(one.sequence)) for one in got.samples[300:])
        < 500_000
    )


# -- faults


FAULTS = [
    ("unplug@1%2B0.5", "no longer on USB"),
    ("stall@1%2B0.1", "stall"),
    ("stuck@1", "held low"),
    ("nack:3@1%2B0.3", "finger 3: nack"),
    ("por:4@1", "finger 4: "),
    ("short@1%2B0.1", "bridge"),
]


@pytest.mark.parametrize(("fault", "message"), FAULTS)
def test_a_fault_is_repaired_as_without_the_experiment(model, fault, message):
    timed = run(model, f"{TIMED}&fault={fault}", 450)
    plain = run(model, f"virtual://ft232h?seed=1&fault={fault}", 450)
    for got in (timed, plain):
        assert any(message in line for line in got.messages)
        assert got.samples[-1].valid.all()
        assert {one.state for one in got.answers[-20:]} == {"nothing"}
        assert got.summary.samples + got.summary.overruns == got.sequences[-1] + 1
    assert timed.summary.overruns <= plain.summary.overruns + AHEAD


def test_a_bridge_that_is_gone_says_the_same_as_without_the_experiment(model):
    timed, plain = (
        run(model, f"{url}&fault=unplug@1%2B0.5", 300).messages
        for url in (TIMED, "virtual://ft232h?seed=1")
    )
    until_back = plain.index("ft232h: back") + 1
    assert timed[:until_back] == plain[:until_back]


def test_a_finger_that_stays_dead_costs_no_other_finger_a_sample(model):
    got = run(model, f"{TIMED}&fault=nack:3@1%2B60", 450)
    dead = np.array([not one.valid[2] for one in got.samples])
    assert dead[160:].all()
    assert all(one.valid[[0, 1, 3, 4, 5]].all() for one in got.samples[TARED:])
    assert got.summary.overruns == 0


# -- who may ask for it


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("virtual://tiny-usb?timed=16", "times its own scans"),
        ("usb://mcp2221?timed=16", "times its own scans"),
        ("i2c://1?timed=16", "times its own scans"),
        (f"{TIMED}&timed=3", "cannot be queued"),
        (f"{TIMED}&timed=x", "not a whole number"),
        (f"{TIMED}&together=1", "together=1"),
    ],
)
def test_what_cannot_be_timed_is_refused(url, words):
    with pytest.raises(UsageError, match=words):
        open_live(url, clock=VirtualClock(), say=print, runs=True)


def test_only_the_loop_of_run_may_be_timed_and_no_scene_that_it_moves():
    with pytest.raises(UsageError, match="holdfast run"):
        open_live(TIMED, clock=VirtualClock(), say=print)
    with pytest.raises(UsageError, match="--grip virtual"):
        open_live(TIMED, clock=VirtualClock(), say=print, field=still(), runs=True)


def test_a_bus_that_is_too_slow_for_the_rate_is_refused(model):
    with pytest.raises(UsageError, match="cannot come every"):
        run(model, f"{TIMED}&bus_hz=50000", 10)
