"""Time and schedule: catch up or drop by a declared rule, counted, never silently late."""

from __future__ import annotations

import io
import math
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_bench import Steady, go
from numbered_lines import numbered_sender

import holdfast
from holdfast.core import source as clock_module
from holdfast.core.contract import Sample
from holdfast.core.errors import TimeError
from holdfast.core.hand_lines import MOST_A_CALL
from holdfast.core.lines import stream_sink
from holdfast.core.source import MonotonicClock, SourceReading
from holdfast.core.trial_file import read_trial
from holdfast.drivers.calibration import MIN_BIAS_ROWS
from holdfast.drivers.replay import PacedReplay, Replay
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.live import hand_files
from holdfast.live.outputs import LineOutput
from holdfast.live.run import answer
from holdfast.live.wearer import wearer_monitor
from holdfast.sessions.calibrate import RATE_HZ, measure_bias, read_rows

AREA = "Time and schedule"
PERIOD_NS = round(1e9 / 150)


@pytest.fixture
def stalled() -> Iterator[tuple[int, int]]:
    """The ends of a pipe that is not read: (read, write)."""
    ends = os.pipe()
    yield ends
    for end in ends:
        os.close(end)


def lines_of(read_end: int) -> list[str]:
    os.set_blocking(read_end, False)
    taken = b""
    while True:
        try:
            taken += os.read(read_end, 1 << 16)
        except BlockingIOError:
            return taken.decode().splitlines()


# -- consumers that stall

stalled_consumer = pytest.mark.hard_case(
    AREA,
    "a stalled consumer",
    elsewhere="a log that no program reads fills its pipe, and the next print blocks the hand",
    here="a thread of its own waits; a line without room in its queue is dropped whole and "
    "counted; no answer is late",
)


@stalled_consumer
def test_a_pipe_without_a_reader_loses_whole_lines_counted_and_delays_no_sample(
    model, stalled, record_property
):
    clock, kept = VirtualClock(), io.StringIO()
    with open(stalled[1], "w", encoding="utf-8", closefd=False) as stream:
        outlets = LineOutput([stream_sink(stream), stream_sink(kept)], print)
    summary = answer(
        Steady(clock, 400),
        model,
        clock,
        lambda prediction, sample, measured: outlets.write(prediction),
        lambda: False,
    )
    outlets.close()
    summary.lost["dropped"] = outlets.dropped
    taken = lines_of(stalled[0])
    record_property("dropped of 400", summary.lost["dropped"])
    assert summary.overruns == 0
    lines = kept.getvalue().splitlines()
    assert len(lines) == 400
    assert summary.lost["dropped"] - (400 - len(taken)) in (0, 1), (
        "the line under way goes out once there is room"
    )
    assert summary.lost["dropped"] > 100
    assert taken == lines[: len(taken)]


@pytest.mark.hard_case(
    AREA,
    "a stalled consumer",
    elsewhere="a log that no program reads fills its pipe, and the next print blocks the hand",
    here="a thread of its own waits; a line without room in its queue is dropped whole and "
    "counted; no answer is late",
    unguarded=True,
)
def test_a_plain_print_into_a_pipe_without_a_reader_would_wait_for_ever(stalled):
    os.set_blocking(stalled[1], False)  # what would wait raises instead
    with pytest.raises(BlockingIOError):
        os.writev(stalled[1], [b"x" * 1000 + b"\n"] * 400) and os.write(
            stalled[1], b"x" * (1 << 16)
        )


# -- the machine and the source fall behind


@pytest.mark.hard_case(
    AREA,
    "a step slower than the source",
    elsewhere="samples queue, and every answer is later than the one before",
    here="the newest reading is taken, those that would be past are not read, counted as overruns",
)
def test_answers_that_take_longer_than_a_period_lose_samples_counted_and_never_lag(
    model, record_property
):
    clock, late_ns = VirtualClock(), []

    class Slow(Steady):
        def read(self) -> SourceReading | None:
            measured = super().read()
            clock.spend(round(2.5 * PERIOD_NS))
            return measured

    source = Slow(clock, 200)
    summary, _, samples = go(model, source, clock)
    for sample in samples:
        late_ns.append(sample.t_ns - sample.sequence * 1e9 / 150)
    record_property("latest_ms", max(late_ns) / 1e6)
    # every period is one or the other
    assert summary.samples + summary.overruns == pytest.approx(2.5 * 200, abs=2)
    assert max(late_ns) < PERIOD_NS


def test_a_program_that_pauses_with_an_open_hand_gets_no_burst_of_late_samples(
    model, monkeypatch
):
    clock = VirtualClock()
    monkeypatch.setattr(hand_files, "RunClock", lambda: clock)
    monitor = GripMonitor(model, clock.now_ns)
    with holdfast.open_hand("virtual://ft232h") as hand:
        samples, answers = [], []
        for sample in hand.samples(monitor, seconds=4):
            if sample.sequence == 300:
                clock.spend(500_000_000)
            samples.append(sample)
            answers.append(monitor.feed(sample))
    steps_ns = np.diff([one.t_ns for one in samples])
    # the turn of now may have begun a little earlier
    assert steps_ns.min() > 0.5 * PERIOD_NS
    numbers = [one.sequence for one in samples]
    assert numbers == [*range(301), *range(375, 600)]
    # the pause is one sample that was late and a history that begins anew, and no other rate
    assert {one.why for one in answers} == {"", "late", "settling"}


def test_a_reading_that_takes_long_shifts_no_row_of_a_bias():
    clock = VirtualClock()
    source = Steady(clock, 1000, {20: 0.5})
    rows = read_rows(source, clock, 2.0)
    steps_ns = np.diff(source.times)
    assert steps_ns.min() > 0.9 * 1e9 / RATE_HZ
    assert len(rows) == 2.0 * RATE_HZ - round(0.5 * RATE_HZ) + 1


@pytest.mark.parametrize("pause_s", [0.25, 1.9])
def test_a_bias_on_a_starved_machine_is_read_on_until_it_has_the_rows_it_needs(pause_s):
    clock = VirtualClock()
    rows = read_rows(Steady(clock, 1000, {5: pause_s}), clock, 0.3)
    assert len(rows) == MIN_BIAS_ROWS


def test_the_bias_of_a_slow_stream_takes_as_long_as_its_rows_and_says_so():
    clock, said = VirtualClock(), []
    source = Steady(clock, 1000)
    source.rate_hz = 10.0
    measured = measure_bias(source, clock, said.append, 2.0)
    assert measured.bias.n == MIN_BIAS_ROWS
    assert said[0].endswith("touch nothing for 3 s")


@pytest.mark.hard_case(
    AREA,
    "jitter",
    elsewhere="a sample that comes early or late is taken for two, or for none",
    here="up to half a period either way every sample is one sample",
)
@settings(max_examples=25)
@given(st.lists(st.floats(0.0, 0.45), min_size=120, max_size=120))
def test_jitter_below_half_a_period_loses_nothing(model, late):
    monitor = GripMonitor(model, None)
    for k, share in enumerate(late):
        answer = monitor.feed(still(k, round((k + share) * 1e9 / 150)))
        assert answer.settled == (k >= model.card.settle_samples - 1)


def still(sequence: int, t_ns: int) -> Sample:
    return Sample(t_ns, np.zeros(18), np.ones(6, dtype=np.bool_), sequence)


@pytest.mark.hard_case(
    AREA,
    "a recording a few per cent off the model's rate",
    elsewhere="read on the model's schedule, rows come twice or never, without a message",
    here="a recording is read at its own rate, so that every row is read once",
)
@pytest.mark.parametrize("rate_hz", [137.0, 150.0, 164.0])
def test_a_recording_within_the_tolerance_is_read_row_by_row(model, rate_hz):
    clock, rows = VirtualClock(), np.arange(300.0)
    replay = Replay(
        np.arange(300),
        np.repeat(rows[:, None], 18, axis=1),
        np.ones((300, 6), bool),
        rate_hz,
        "N",
    )
    met: list[float] = []
    answer(
        PacedReplay(replay, clock.now_ns),
        model,
        clock,
        lambda prediction, sample, measured: met.append(measured.values[0]),
        lambda: False,
    )
    assert met == rows.tolist()


# -- stamps that are not what they should be


class Stamped(Steady):
    """A source with stamps of its own making: reading -> ns."""

    def __init__(self, clock: VirtualClock, stamps: list[int]) -> None:
        super().__init__(clock, len(stamps))
        self._stamps = stamps

    def read(self) -> SourceReading | None:
        measured = super().read()
        return measured and SourceReading(
            self._stamps[self.k - 1], measured.values, measured.valid
        )


def on_time(count: int, start_ns: int = 0) -> list[int]:
    return [start_ns + round(k * 1e9 / 150) for k in range(count)]


@pytest.mark.hard_case(
    AREA,
    "a duplicated sample",
    elsewhere="the same reading twice is a change of nothing: the hand looks at rest",
    here="a reading is used once; the second is a lost sample, counted, and more than 20 ms of "
    "them are unknown",
)
def test_a_source_that_repeats_itself_is_lost_and_then_unknown(model):
    stamps = on_time(200) + [on_time(200)[-1]] * 20 + on_time(120, round(220e9 / 150))
    summary, predictions, _ = go(model, Stamped(clock := VirtualClock(), stamps), clock)
    assert summary.lost["repeated"] == 20
    assert {p.state for p in predictions[150:200]} == {"nothing"}
    assert {p.state for p in predictions[200:220]} == {"unknown"}
    assert predictions[-1].state == "nothing"


@pytest.mark.hard_case(
    AREA,
    "a sample that comes late",
    elsewhere="it is taken for a new one, and the past comes after the present",
    here="what is older than the newest is not used; it counts, and its place is a lost sample",
)
def test_two_readings_in_the_wrong_order_cost_one_sample_and_no_error(model):
    stamps = on_time(300)
    stamps[200], stamps[201] = stamps[201], stamps[200]
    summary, predictions, samples = go(
        model, Stamped(clock := VirtualClock(), stamps), clock
    )
    assert (
        summary.lost["late"],
        summary.lost["repeated"],
        summary.lost["restarts"],
    ) == (1, 0, 0)
    assert not samples[201].valid.any()
    assert predictions[201].state == "unknown"
    assert predictions[202].state == "nothing"
    assert np.diff([sample.t_ns for sample in samples]).min() > 0


@pytest.mark.hard_case(
    AREA,
    "a clock that jumps back, and 32-bit microseconds that wrap",
    elsewhere="an interval below zero becomes a huge one, or the stream stops with an error in "
    "the middle of a grip",
    here="the stream begins anew: counted, unknown until settled; a request that runs goes on",
)
@pytest.mark.parametrize("back_ns", [2**32 * 1000, 3_600_000_000_000, 2_000_000_000])
def test_stamps_that_jump_back_begin_anew_and_are_unknown_until_settled(
    model, back_ns, record_property
):
    stamps = on_time(200, back_ns) + on_time(200, round(200e9 / 150))
    summary, predictions, _ = go(model, Stamped(clock := VirtualClock(), stamps), clock)
    settle = model.card.settle_samples
    record_property(
        "unknown_samples", sum(p.state == "unknown" for p in predictions[200:])
    )
    assert summary.lost["restarts"] == 1
    assert {p.state for p in predictions[200 : 200 + settle - 1]} == {"unknown"}
    assert {p.state for p in predictions[200 + settle :]} == {"nothing"}


@pytest.mark.hard_case(
    AREA,
    "a clock that jumps back, and 32-bit microseconds that wrap",
    elsewhere="an interval below zero becomes a huge one, or the stream stops with an error in "
    "the middle of a grip",
    here="the stream begins anew: counted, unknown until settled; a request that runs goes on",
    unguarded=True,
)
def test_the_monitor_alone_refuses_time_that_runs_backwards(model):
    monitor = GripMonitor(model, None)
    monitor.feed(still(0, 2**32 * 1000))
    with pytest.raises(TimeError, match="older"):
        monitor.feed(still(1, 0))


@pytest.mark.hard_case(
    AREA,
    "a clock that jumps forwards",
    elsewhere="an hour of lost samples is filled in, one by one, before the next",
    here="at most one step more than the longest bridged gap is filled in; "
    "then unknown until settled",
)
@pytest.mark.parametrize("ahead_s", [0.1, 3600.0, 1e9])
def test_a_jump_ahead_takes_no_more_steps_than_a_gap(model, ahead_s, monkeypatch):
    monitor, steps = GripMonitor(model, VirtualClock().now_ns), []
    graph = monitor._graph
    real = graph.step
    monkeypatch.setattr(graph, "step", lambda: steps.append(1) or real())
    for k in range(100):
        monitor.feed(still(k, k * PERIOD_NS))
    before = len(steps)
    answer = monitor.feed(still(100, 100 * PERIOD_NS + round(1e9 * ahead_s)))
    assert len(steps) - before <= model.card.gap_samples + 2
    assert answer.state == "unknown"


@pytest.mark.hard_case(
    AREA,
    "the recorder's device clock wraps",
    elsewhere="32-bit microseconds run out after 71 minutes",
    here="time is the host's alone; the device's own column may wrap",
)
def test_a_recording_whose_device_clock_wraps_reads_as_any_other(tmp_path: Path):
    table = ["Time,X1,Y1,Z1,host_ns,device_us,sequence,valid1"]
    table += [
        f"{k / 50},1,2,3,{k * 20_000_000},{(2**32 - 40_000 + 20_000 * k) % 2**32},{k},1"
        for k in range(6)
    ]
    (tmp_path / "trial_1.csv").write_text("\n".join(table) + "\n")
    trial = read_trial(tmp_path / "trial_1.csv")
    np.testing.assert_allclose(trial.t_s, np.arange(6) / 50)
    assert trial.valid.all()


# -- the clock, and who floods


@pytest.mark.hard_case(
    AREA,
    "a machine that is suspended",
    elsewhere="CLOCK_MONOTONIC stands still: before and after seem neighbours",
    here="the schedule runs by the time since boot, which goes on; what was missed is lost samples",
)
def test_the_schedule_s_clock_goes_on_while_the_machine_is_suspended(monkeypatch):
    clocks = []
    real = time.clock_gettime_ns

    def suspended_for_an_hour(which: int) -> int:
        clocks.append(which)
        return real(which) + (3_600_000_000_000 if which == time.CLOCK_BOOTTIME else 0)

    before_ns = MonotonicClock().now_ns()
    monkeypatch.setattr(clock_module.time, "clock_gettime_ns", suspended_for_an_hour)
    assert MonotonicClock().now_ns() - before_ns > 3_599_000_000_000
    MonotonicClock().wait_until(before_ns)  # long past: at once
    assert set(clocks) == {time.CLOCK_BOOTTIME}


@pytest.mark.hard_case(
    AREA,
    "a flood of commands",
    elsewhere="a sender that is faster than the reader occupies the loop",
    here="at most 32 datagrams are read at a sample; the others wait",
)
def test_a_flooded_port_delays_commands_and_no_sample(tmp_path, record_property):
    log: list[str] = []
    url = f"unix://{tmp_path}/wearer"
    with (
        wearer_monitor(url, VirtualClock(), log.append) as wearer,
        numbered_sender(tmp_path / "wearer") as user,
    ):
        wearer.look()
        user.socket.setblocking(False)
        sent = 0
        # as many as the socket's queue takes
        with suppress(BlockingIOError):
            while sent < 2 * MOST_A_CALL:
                user.send({"wants": "override"})
                sent += 1
        kept = 0
        while wearer.command().override:
            kept += 1
    record_property("samples that the flood lasts", kept)
    assert kept == math.ceil(sent / MOST_A_CALL)
