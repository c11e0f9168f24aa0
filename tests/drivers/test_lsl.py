"""Streams of the lab streaming layer: in with the sender's clock put right, out and back again."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest.mock import MagicMock

import msgspec
import numpy as np
import pylsl
import pytest
from command_line import fails
from live_bench import TINY, go
from pylsl.util import LostError

from holdfast.core.contract import Sample, channel_names
from holdfast.core.errors import (
    ChannelError,
    DeviceLost,
    DeviceNotFound,
    LibraryMissing,
    RateError,
    UnitError,
)
from holdfast.core.hand_card import read_hand_card
from holdfast.drivers import lsl
from holdfast.drivers.arrivals import SKIPPED
from holdfast.drivers.lsl import (
    DECISION,
    NO_NUMBER,
    LslAnswers,
    LslInlet,
    LslSource,
    StreamFacts,
    decision_row,
    order_of,
)
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.monitor import GripMonitor, Model

RATE_HZ = 150.0
PERIOD_S = 1.0 / RATE_HZ
LABELS = channel_names(6)
FACTS = StreamFacts("hand", False, RATE_HZ, LABELS, ("N",) * 18)
BEHIND_S = 1000.0
"""This machine's LSL clock minus its monotonic clock."""
LOOPBACK = "[multicast]\nResolveScope = machine\n"


class ScriptedInlet(LslInlet):
    """Sends a sample a period, on a virtual clock; none in `gone`, and it ends at `ends`."""

    def __init__(
        self,
        clock: VirtualClock,
        facts: StreamFacts = FACTS,
        gone: range = range(0),
        ends: int = 10**9,
        rows: Callable[[int], np.ndarray] | None = None,
        tick: int = 1,
    ) -> None:
        self.tick = tick
        self.facts = facts
        self.clock = clock
        self.gone = gone
        self.ends = ends
        self.rows = rows or (lambda k: 0.02 * np.random.default_rng(k).normal(size=18))
        self.next = 0
        self.closed = False

    def pull(self, timeout_s: float) -> list[tuple[float, list[float]]]:
        until_ns = self.clock.now_ns() + round(1e9 * timeout_s)
        while self.next in self.gone:
            self.next += 1
        if self.next >= self.ends:
            raise DeviceLost("the stream ended")
        if self._sent_ns(self.next) > until_ns:
            self.clock.wait_until(until_ns)
            return []
        self.clock.wait_until(self._sent_ns(self.next))
        came = []
        while self.next < self.ends and self._sent_ns(self.next) <= self.clock.now_ns():
            if self.next not in self.gone:
                stamped = self.next // self.tick * self.tick
                stamp_s = BEHIND_S + 1e-9 * self._sent_ns(stamped)
                came.append((stamp_s, self.rows(self.next).tolist()))
            self.next += 1
        return came

    def _sent_ns(self, k: int) -> int:
        return round(1e9 * (k + 0.5) * PERIOD_S)

    def clock_s(self) -> float:
        return BEHIND_S + 1e-9 * self.clock.now_ns()

    def close(self) -> None:
        self.closed = True


def opened(
    clock: VirtualClock, **script: Any
) -> tuple[LslSource, ScriptedInlet, list[str]]:
    said: list[str] = []
    inlet = ScriptedInlet(clock, **script)
    return LslSource(inlet, clock, said.append), inlet, said


def test_every_sample_is_read_once_and_its_stamp_is_on_our_clock():
    clock = VirtualClock()
    source, inlet, _ = opened(clock)
    readings = [source.read() for _ in range(50)]
    for k, reading in enumerate(readings):
        assert (
            abs(reading.t_ns - 1e9 * (k + 0.5) * PERIOD_S) < 200
        )  # of a double near 1000 s
        np.testing.assert_array_equal(reading.values, inlet.rows(k))
        assert reading.valid.all()
    assert (source.unit, source.n_channels, source.rate_hz) == ("N", 18, RATE_HZ)


def test_equal_stamps_of_a_sender_are_named():
    source, _, said = opened(VirtualClock(), tick=2)
    readings = [source.read() for _ in range(50)]
    source.close()
    assert readings[2].t_ns == readings[3].t_ns
    assert said == [
        "lsl://hand: a sample is stamped like the one before",
        "lsl://hand: 25 skipped in all",
    ]


def test_a_reader_that_falls_behind_drops_all_but_the_newest_and_says_so():
    clock = VirtualClock()
    source, _, _ = opened(clock)
    source.read()
    clock.spend(round(1e9 * 10.2 * PERIOD_S))
    late, newest, after = (source.read() for _ in range(3))
    assert (late.why, late.valid.any()) == ((SKIPPED,) * 6, False)
    assert newest.valid.all()
    assert clock.now_ns() - newest.t_ns <= 1.5e9 * PERIOD_S
    assert after.t_ns > newest.t_ns


def test_a_stream_may_leave_out_what_its_hand_does_not_measure():
    usual = read_hand_card("six-fingertips")
    yz = tuple(msgspec.structs.replace(one, measures="yz") for one in usual.contacts)
    hand = replace(usual, contacts=yz)
    left = [name for name in LABELS if not name.startswith("X")]
    whole = np.arange(1.0, 19.0)
    expected = np.where(hand.measured, whole, 0.0)
    for labels, row in ((LABELS, whole), (left, expected[hand.measured])):
        facts = StreamFacts("hand", False, RATE_HZ, tuple(labels), ("N",) * len(labels))
        inlet = ScriptedInlet(VirtualClock(), facts, rows=lambda k, row=row: row)
        source = LslSource(inlet, inlet.clock, print, hand=hand)
        reading = source.read()
        assert reading.values.tolist() == expected.tolist()
        assert reading.valid.all()
        assert (source.n_channels, source.hand) == (18, hand)
    with pytest.raises(ChannelError, match="12 channels, not 18 of the hand card"):
        order_of(left, "lsl://hand", usual)


def test_a_value_that_is_no_number_makes_its_finger_invalid_and_labels_give_the_order():
    def row(k: int) -> np.ndarray:
        return np.where(np.arange(18) == 4, np.nan, np.arange(18) + 0.001 * k)

    facts = StreamFacts("hand", False, RATE_HZ, LABELS[::-1], ("newton",) * 18)
    source, _, _ = opened(VirtualClock(), facts=facts, rows=row)
    reading = source.read()
    assert reading.values[0] == 17.0
    assert reading.valid.tolist() == [True] * 4 + [False, True]
    assert reading.why[4] == NO_NUMBER


@pytest.mark.parametrize(
    ("facts", "error"),
    [
        (StreamFacts("hand", False, RATE_HZ, ("",) * 17, ("N",) * 17), ChannelError),
        (StreamFacts("hand", True, RATE_HZ, ("",), ("N",)), ChannelError),
        (StreamFacts("hand", False, RATE_HZ, LABELS, ("",) * 18), UnitError),
        (StreamFacts("hand", False, RATE_HZ, LABELS, (*("N",) * 17, "uT")), UnitError),
        (StreamFacts("hand", False, 0.0, LABELS, ("N",) * 18), RateError),
    ],
)
def test_a_stream_that_cannot_be_a_hand_is_refused(facts, error):
    with pytest.raises(error, match=r"lsl://hand"):
        opened(VirtualClock(), facts=facts)


@pytest.mark.parametrize("script", [{"gone": range(300, 450)}, {"ends": 300}])
def test_a_silent_stream_is_unknown_and_never_safe(script):
    clock = VirtualClock()
    model = Model(TINY)
    source, inlet, said = opened(clock, **script)
    summary, answers, _ = go(
        model, source, clock, stopped=lambda: clock.now_ns() > 1e9 * 620 * PERIOD_S
    )
    at = [round(1e-9 * one.t_decided_ns / PERIOD_S) for one in answers]
    states = dict(zip(at, (one.state for one in answers), strict=True))
    assert {state for k, state in states.items() if 150 < k < 300} == {"nothing"}
    assert {state for k, state in states.items() if 302 < k < 450} == {"unknown"}
    if "ends" in script:
        assert {state for k, state in states.items() if k > 450} == {"unknown"}
        assert [line for line in said if "the stream ended" in line] == said
        assert len(said) == 1
    else:
        assert states[max(states)] == "nothing"
    assert summary.lost["repeated"] > 0
    source.close()
    assert inlet.closed


# -- over the network stack of this machine


@pytest.fixture(scope="module")
def name() -> str:
    """Of streams of this run alone, which stay on this machine."""
    pylsl.set_config_content(LOOPBACK)
    return f"holdfast-test-{os.getpid()}"


def received(inlet: LslInlet, count: int) -> list[tuple[float, list[float]]]:
    """So many samples; fewer where none comes for five seconds."""
    pairs: list[tuple[float, list[float]]] = []
    while len(pairs) < count and (more := inlet.pull(5.0)):
        pairs += more
    return pairs


def test_values_and_decisions_go_out_and_come_back(name):
    clock = VirtualClock()
    model = Model(TINY)
    offset_ns = round(1e9 * pylsl.local_clock())
    clock.spend(offset_ns)  # the stamps of the samples: the LSL clock itself
    answers = LslAnswers(
        name, 6, "N", RATE_HZ, lambda: round(1e9 * pylsl.local_clock())
    )
    inlet = LslInlet(name)
    decisions = LslInlet(f"{name}-decision")
    assert inlet.facts == StreamFacts(name, False, RATE_HZ, LABELS, ("N",) * 18)
    assert decisions.facts.labels == DECISION
    monitor = GripMonitor(model, None)
    sent = []
    for k in range(20):
        values = np.random.default_rng(k).normal(size=18)
        valid = np.arange(6) != (3 if k == 7 else -1)
        sample = Sample(offset_ns + round(1e9 * k * PERIOD_S), values, valid, k)
        sent.append((sample, monitor.feed(sample)))
        answers.write(sent[-1][1], sample)
    came = received(inlet, len(sent))
    rows = received(decisions, len(sent))
    for (sample, prediction), (stamp_s, values), (at_s, row) in zip(
        sent, came, rows, strict=True
    ):
        assert abs(stamp_s - 1e-9 * sample.t_ns) < 0.01
        assert stamp_s == pytest.approx(at_s, abs=1e-3)
        expected = np.where(np.repeat(sample.valid, 3), sample.values, np.nan)
        np.testing.assert_array_equal(values, expected)
        assert row == decision_row(prediction)
    inlet.close()
    decisions.close()


def test_a_url_that_cannot_be_a_stream_is_a_usage_error(run):
    for url, says in {
        "lsl://": "is no stream",
        "lsl://a?unit=kg": "allowed: N or uT or count",
        "lsl://a?seed=1": "allowed: unit, rate_hz",
    }.items():
        fails(run, 2, "UsageError", "run", TINY, "--source", url, says=says)


def test_without_pylsl_the_error_names_the_extra(monkeypatch):
    monkeypatch.delitem(sys.modules, "holdfast.drivers.lsl")
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(LibraryMissing, match=r"pip install 'holdfast\[lsl\]'"):
        import holdfast.drivers.lsl  # noqa: F401


@pytest.mark.parametrize(
    ("ahead_ns", "late_ns"), [(0, 0), (1_000_000, 0), (1_000_001, 1_000_001), (-5, -5)]
)
def test_a_stamp_may_be_a_millisecond_ahead_and_is_then_now(ahead_ns, late_ns):
    clock = VirtualClock(10**12)

    class Inlet(ScriptedInlet):
        def pull(self, timeout_s):
            return [((10**12 + ahead_ns) * 1e-9, [0.0] * 18)]

        def clock_s(self):
            return 1e3

    source = LslSource(Inlet(clock), clock, print)
    assert abs(source.read().t_ns - clock.now_ns() - late_ns) <= 1


def test_an_opened_stream_has_five_seconds_and_its_url_may_say_unit_and_rate():
    clock = VirtualClock()
    with pytest.raises(DeviceNotFound, match="for 5 s"):
        opened(clock, gone=range(10**4))
    assert clock.now_ns() == 5_000_000_000
    facts = StreamFacts("hand", False, 0.0, LABELS, ("",) * 18)
    source = LslSource(
        ScriptedInlet(VirtualClock(), facts), VirtualClock(), print, "uT", 100.0
    )
    assert (source.unit, source.rate_hz) == ("uT", 100.0)
    with pytest.raises(UnitError, match=r"lsl://hand\?unit=N\|uT\|count"):
        opened(VirtualClock(), facts=facts)


def test_a_decision_is_nine_numbers_and_nan_where_the_model_cannot_tell():
    prediction = GripMonitor(Model(TINY), None).feed(
        Sample(0, np.zeros(18), np.ones(6, dtype=bool), 0)
    )
    one = replace(
        prediction,
        state="safe_slip",
        p_situation={"nothing": 0.1, "grasp": 0.2, "safe_slip": 0.6, "risky_slip": 0.1},
        p_risky=0.125,
        arm=True,
        act=False,
    )
    assert decision_row(one) == [2.0, 0.1, 0.2, 0.6, 0.1, 0.125, 1.0, 0.0]
    assert decision_row(replace(one, state="unknown", act=True))[::7] == [-1.0, 1.0]
    rows = decision_row(one, ["safe_slip"]), decision_row(one, ["risky_slip"])
    assert [np.flatnonzero(np.isnan(row)).tolist() for row in rows] == [[3], [4, 5]]


def scripted(monkeypatch: Any, **errors: Exception) -> Any:
    """pylsl with one stream; `errors` by the name of the call."""
    script = MagicMock()
    script.resolve_byprop.return_value = [script]
    inlet = script.StreamInlet.return_value
    inlet.info.return_value.channel_count.return_value = 1
    inlet.pull_sample.return_value = ([1.0], 5.0)
    inlet.configure_mock(**{f"{name}.side_effect": e for name, e in errors.items()})
    monkeypatch.setattr(lsl, "pylsl", script)
    return script


@pytest.mark.parametrize("error", [TimeoutError(), LostError()])
def test_a_stream_that_does_not_open_or_ends_is_an_error_of_its_own(monkeypatch, error):
    for name in ("info", "open_stream", "time_correction"):
        scripted(monkeypatch, **{name: error})
        with pytest.raises(
            DeviceNotFound, match=f"does not open .{type(error).__name__}"
        ):
            LslInlet("hand")
    for name in ("pull_sample", "pull_chunk"):
        scripted(monkeypatch, **{name: error})
        with pytest.raises(DeviceLost, match="the stream ended"):
            LslInlet("hand").pull(0.0)
    scripted(monkeypatch).resolve_byprop.return_value = []
    with pytest.raises(DeviceNotFound, match="no such stream"):
        LslInlet("hand")
