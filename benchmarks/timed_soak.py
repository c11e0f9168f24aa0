"""The live loop in real time on an emulated FT232H, today's and timed by the chip, interleaved.

`python -m benchmarks.timed_soak OUT.json [SECONDS]`. The stalls are those of this machine:
every turn of one way is followed by a turn of the other, so both meet the same neighbours. The
emulated chip is part of the process, and its answers have the times at which a chip would give
them.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from contextlib import closing
from dataclasses import asdict
from itertools import cycle, islice
from pathlib import Path

from holdfast.cli.command import show
from holdfast.core.clock import MonotonicClock
from holdfast.core.contract import FloatArray
from holdfast.core.reading import Json
from holdfast.core.writing import write_whole
from holdfast.drivers.bridges import open_virtual
from holdfast.drivers.hand import Hand, LiveHand
from holdfast.drivers.timed_bridge import timed_virtual
from holdfast.drivers.timed_hand import TimedHand, TimedLiveHand
from holdfast.drivers.virtual.clock import DeviceClock
from holdfast.drivers.virtual.virtual_hand import VirtualHand
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.edge_runtime.preparation import Tare
from holdfast.evaluation.provenance import host
from holdfast.live.loop import Summary, run_live
from holdfast.live.real_time import real_time

MODEL = Path("models/holdfast-150hz.onnx")
SECONDS, TURN_S = 300.0, 30.0
WAYS = {"today's": 0, "timed": 16}
"""Way -> scans queued ahead."""
COUNTS = ("samples", "overruns", "too_old", "late", "repeated")


class WaitingClock(MonotonicClock):
    """Real time; the emulated transfers wait on it."""

    def spend(self, duration_ns: int) -> None:
        """Let time pass."""
        self.wait_until(self.now_ns() + duration_ns)


def opened(ahead: int, clock: WaitingClock) -> LiveHand:
    """An emulated hand at rest, started."""
    chips = VirtualHand(DeviceClock(clock), seed=1)
    bridge = open_virtual("ft232h", chips, 400_000)

    def pause(seconds: float) -> None:
        clock.spend(round(1e9 * seconds))

    if not ahead:
        hand = Hand(bridge, now_ns=clock.now_ns, pause=pause, say=show)
        hand.start()
        return LiveHand(hand, _to_force)
    bus = timed_virtual(bridge, clock.now_ns)
    timed = TimedHand(bus, ahead=ahead, now_ns=clock.now_ns, pause=pause, say=show)
    timed.start()
    return TimedLiveHand(timed, _to_force)


def _to_force(field_ut: FloatArray) -> FloatArray:
    """Any newtons will do."""
    return 1e-3 * field_ut


def turn(model: Model, ahead: int, seconds: float) -> tuple[Summary, bool]:
    """One live run, and whether it had real-time priority."""
    clock = WaitingClock()
    with closing(opened(ahead, clock)) as source, real_time() as allowed:
        monitor = GripMonitor(model, clock.now_ns)
        tare = Tare(model.card.preparation, model.card.n_channels)
        end_ns = clock.now_ns() + round(1e9 * seconds)
        summary = run_live(
            source,
            monitor,
            tare,
            clock,
            lambda *one: 0,
            stopped=lambda: clock.now_ns() >= end_ns,
        )
    return summary, allowed


def measure(seconds: float = SECONDS, turn_s: float = TURN_S) -> Json:
    """A row a way: what was answered and what was lost, of all its turns."""
    model = Model(MODEL)
    counts = {way: Counter[str]() for way in WAYS}
    priority = True
    for way in islice(cycle(WAYS), max(len(WAYS), round(seconds / turn_s))):
        summary, allowed = turn(model, WAYS[way], turn_s)
        priority = priority and allowed
        counts[way]["turns"] += 1
        counts[way].update({name: getattr(summary, name) for name in COUNTS})
    return {
        "kind": "emulated chip, real time",
        "host": asdict(host()),
        "model": model.card.model_id,
        "rate_hz": model.card.rate_hz,
        "turn_s": turn_s,
        "real_time_priority": priority,
        "rows": [{"way": way, "queued": WAYS[way], **counts[way]} for way in WAYS],
    }


if __name__ == "__main__":
    given_s = float(sys.argv[2]) if len(sys.argv) > 2 else SECONDS
    show(
        str(
            write_whole(
                Path(sys.argv[1]), json.dumps(measure(given_s), indent=1) + "\n"
            )
        )
    )
