"""The clock of a run with a scene: what the scene costs is no time, and is made up for in waits."""

from __future__ import annotations

import time

import pytest

from holdfast.core.source import MonotonicClock
from holdfast.live.scene import SceneClock


class Machine:
    """A machine whose clock goes on by what a test says, and by waiting. slept_ns: all waits."""

    def __init__(self) -> None:
        self.now_ns, self.slept_ns = 1_000, 0


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    one = Machine()

    def wait_until(clock: MonotonicClock, t_ns: int) -> None:
        remaining_ns = max(t_ns - clock.now_ns(), 0)
        one.now_ns += remaining_ns
        one.slept_ns += remaining_ns

    monkeypatch.setattr(MonotonicClock, "now_ns", lambda clock: one.now_ns)
    monkeypatch.setattr(MonotonicClock, "wait_until", wait_until)
    return one


def test_no_time_passes_while_a_scene_is_computed(machine: Machine) -> None:
    clock = SceneClock()
    with clock.still():
        machine.now_ns += 500
    assert clock.now_ns() == 1_000
    machine.now_ns += 30
    assert clock.now_ns() == 1_030


def test_what_a_scene_cost_is_made_up_for_where_the_loop_waits(
    machine: Machine,
) -> None:
    clock = SceneClock()
    with clock.still():
        machine.now_ns += 500
    clock.wait_until(1_800)
    assert (clock.now_ns(), machine.slept_ns) == (1_800, 300)
    assert machine.now_ns == 1_800


def test_the_machine_s_clock_waits_until_a_time_and_for_none_that_has_passed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The machine ends each sleep early here; so the clock has to sleep again."""
    now_ns, slept_s = [1_000], list[float]()

    def sleep(seconds: float) -> None:
        assert seconds >= 0.0
        slept_s.append(seconds)
        now_ns[0] += max(1, round(0.75e9 * seconds))

    monkeypatch.setattr(time, "clock_gettime_ns", lambda which: now_ns[0])
    monkeypatch.setattr(time, "sleep", sleep)
    MonotonicClock().wait_until(900)
    assert slept_s == []
    MonotonicClock().wait_until(2_000)
    assert now_ns == [2_000]
    assert slept_s[:2] == pytest.approx([1e-6, 0.25e-6])
