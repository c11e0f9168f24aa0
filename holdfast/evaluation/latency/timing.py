"""Timing on a noisy machine.

The things to compare are interleaved, so a slow moment hits all alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

from holdfast.core.contract import FloatArray

TURNS = 40
"""Rounds in which every call takes its turn."""
CALLS_A_TURN = 100
"""Calls of a turn; its first comes to cold caches."""


def time_in_turns(
    calls: Mapping[str, Callable[[], object]],
    turns: int = TURNS,
    calls_a_turn: int = CALLS_A_TURN,
) -> dict[str, FloatArray]:
    """Wall-clock us of every call, [turns x calls_a_turn] each.

    The first turn is warm-up and left out.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(turns + 1):
        for name, call in calls.items():
            for _ in range(calls_a_turn):
                # Whole ns around the call alone: what stores the time is not in it.
                started = time.perf_counter_ns()
                call()
                ended = time.perf_counter_ns()
                # Turn 0 pays for what is allocated and compiled at the first call.
                if turn:
                    times[name].append((ended - started) / 1000.0)

    return {name: np.array(values) for name, values in times.items()}


def busy_wait(microseconds: float) -> Callable[[], None]:
    """A call that does nothing for this time.

    Its tail is the machine's own jitter (the reference).
    """
    wait_ns = round(1000 * microseconds)

    # Not a sleep: a process that sleeps is measured by how late the system wakes it.
    def wait() -> None:
        until = time.perf_counter_ns() + wait_ns
        while time.perf_counter_ns() < until:
            pass

    return wait
