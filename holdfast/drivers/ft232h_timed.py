"""EXPERIMENT: an FT232H that times the scans itself, several queued ahead in one USB transfer.

Before each scan the engine clocks a counted number of bits with its pins released (0x8F): nothing
moves on the bus, and time passes by the chip's own quartz. So a scan begins when the chip says, and
not when the host's scheduler lets the program run. A host that is away for less than a block
finds every sample when it comes back; only their answers are late.

Scans belong to a grid of the host's clock: scan n is due at start + n periods. The driver learns
from the earliest answer of each block where the chip's clock stands, and pulls the next block
towards the grid by at most PULL_NS a scan. After a stall that empties the queue it begins again at
the next time of the grid, so the numbers that are missing are the samples that were not taken.

Never tried on a real chip. How long its engine takes for a pin write is not documented, so the
driver measures how long a scan lasts. Recovery from faults is that of drivers/timed_hand.py.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any

from holdfast.core.errors import TransferFailed, UsageError
from holdfast.drivers.bus import Reply, Transfer
from holdfast.drivers.ft232h import (
    FLUSH,
    IN_ENDPOINT,
    MASTER_HZ,
    MOST_IN,
    OUT_ENDPOINT,
    PACKET,
    SCL,
    SDA,
    SET_LOW_PINS,
    STATUS_BYTES,
    Ft232h,
    batch_of,
    replies_of,
)
from holdfast.drivers.usb import TIMEOUT_MS

IDLE = 0x8F
"""Clock 8 (n + 1) bits without data."""
IDLE_BITS, MOST_IDLE = 8, 1 << 16
RELEASED = bytes([SET_LOW_PINS, SCL | SDA, 0])
"""All pins are inputs: the engine's clock does not reach SCL."""
BLOCKS = 2
"""One is carried out while the other waits in the host's USB controller."""
HAND_OVER_NS = 500_000
"""From when a block is written until the chip can begin it."""
FIFO = 1024
"""Bytes that wait in the chip for a host that does not read."""
PHASE_TRUST, LENGTH_TRUST = 0.25, 0.02
"""Shares of a block's error in when the chip is taken to be done, and in how long a scan lasts."""
PULL_NS = 10_000
"""A scan is moved towards the grid by at most this: 1500 ppm at 150 Hz."""
TRIES, MOST_SCANS = 5, 5
PIN_BYTES = 2
"""Of a scan's answer: the idle lines before and after."""
PATIENCE_PERIODS = 4
"""An answer that is so much later than its scan was planned does not come any more."""


@dataclass(frozen=True)
class TimedScan:
    """One scan. number: of its period, with gaps where none was queued; t_ns: when it began."""

    number: int
    t_ns: int
    replies: list[Reply]


class TimedFt232h(Ft232h):
    """An FT232H that also scans by itself. writer: what writes blocks without being waited for.

    Raises what Ft232h raises.
    """

    def __init__(
        self,
        backend: Any,
        *,
        now_ns: Callable[[], int],
        writer: Executor | None = None,
        **more: Any,
    ) -> None:
        super().__init__(backend, **more)
        self._now_ns, self._writer = now_ns, writer or ThreadPoolExecutor(BLOCKS)
        self._bit_ns = 1e9 * 3 * (self._divider + 1) / MASTER_HZ
        self.ns_per_byte: float | None = None
        """How long a scan lasts for each byte that it answers; None until that was measured."""
        self._planned: deque[tuple[int, int]] = deque()
        self._writes: deque[Future[object]] = deque()

    def begin(
        self,
        transfers: Sequence[Transfer],
        period_ns: float,
        block: int = 8,
        *,
        start_ns: int | None = None,
        number: int = 0,
    ) -> None:
        """Queue two blocks of scans, `block` each: scan n is due at start_ns + n periods.

        number: the first that may be queued; earlier ones and those whose time has passed are not.
        Raises UsageError where their answers do not fit the chip's memory or a scan does not fit a
        period, and a DeviceError.
        """
        self._transfers, self._period_ns, self._block = (
            list(transfers),
            period_ns,
            block,
        )
        self._batch, self._bytes = batch_of(transfers)
        if 2 * self._bytes > MOST_IN or block > most_block(transfers):
            raise UsageError(
                f"{BLOCKS * block} scans of {self._bytes} bytes do not fit the chip's memory",
                cause=f"it keeps {FIFO} bytes while its host is away",
                next_step=f"queue blocks of at most {most_block(transfers)} scans",
            )
        self._ask(b"", 0)
        if self.ns_per_byte is None:
            self.learn(transfers)
        self._scan_ns = float(self.ns_per_byte or 0.0) * (self._bytes - PIN_BYTES)
        self._doubtful = True
        if self._scan_ns + IDLE_BITS * self._bit_ns > period_ns:
            raise UsageError(
                f"a scan of {1e-6 * self._scan_ns:.2f} ms cannot come every "
                f"{1e-6 * period_ns:.2f} ms",
                next_step="scan more slowly, or without the chip's own timing",
            )
        now_ns = self._now_ns()
        self._rest, self._number, self._free_ns, self._refills = (
            b"",
            number,
            float(now_ns),
            True,
        )
        self._start_ns = now_ns + 2 * HAND_OVER_NS if start_ns is None else start_ns
        self._earliest_ns: float | None = None
        for _ in range(BLOCKS):
            self._queue()

    @property
    def queued(self) -> int:
        """Scans whose answers were not handed out yet."""
        return len(self._planned)

    def finish(self) -> None:
        """Queue no more scans; `next` hands out those that are queued."""
        self._refills = False

    def next(self) -> TimedScan:
        """The next scan; waits for it, and keeps two blocks queued. Raises a DeviceError."""
        waited = self._wait_for_answer()
        if waited:
            self._measure(*self._planned[0])
        if self._refills:
            self._refill()
        number, t_ns = self._planned.popleft()
        answer, self._rest = self._rest[: self._bytes], self._rest[self._bytes :]
        return TimedScan(number, t_ns, replies_of(self._transfers, answer))

    def end(self) -> None:
        """Wait for the scans that are queued, and throw them away. Raises a DeviceError."""
        self._refills = False
        try:
            while self._planned:
                self._wait_for_answer()
                self._planned.popleft()
                self._rest = self._rest[self._bytes :]
            self._require_written(wait=True)
        finally:
            wait(self._writes)
            self._planned.clear()
            self._writes.clear()

    def close(self) -> None:
        """Give the bridge back; a second call does no harm."""
        self._writer.shutdown(wait=False, cancel_futures=True)
        super().close()

    def learn(self, transfers: Sequence[Transfer]) -> None:
        """Measure how long a scan lasts, by the round trips of a batch of some, and of one.

        Raises a DeviceError.
        """
        batch, size = batch_of(transfers)
        many = min(MOST_SCANS, MOST_IN // size)
        lasts_ns = (
            self._fastest_ns(batch, size, many) - self._fastest_ns(batch, size, 1)
        ) / (many - 1)
        self.ns_per_byte = lasts_ns / (size - PIN_BYTES)

    def _fastest_ns(self, batch: bytes, size: int, scans: int) -> int:
        """The shortest round trip of so many scans in one batch, of some tries."""
        spent_ns = []
        for _ in range(TRIES):
            began_ns = self._now_ns()
            self._ask(batch * scans, size * scans)
            spent_ns.append(self._now_ns() - began_ns)
        return min(spent_ns)

    def _refill(self) -> None:
        """Keep two blocks in the chip; where it has run dry, first take all that it answered."""
        while self._now_ns() > self._free_ns and self._in_chip() > 0:
            self._wait_for_answer(len(self._planned))
        while self._in_chip() <= self._block * (BLOCKS - 1):
            self._queue()

    def _in_chip(self) -> int:
        """Scans whose answers have not come."""
        return len(self._planned) - len(self._rest) // self._bytes

    def _queue(self) -> None:
        """One more block, its first scan at the next time of the grid that is left."""
        self._require_written(wait=False)
        step_ns = IDLE_BITS * self._bit_ns
        rest_ns = self._period_ns - self._scan_ns
        ready_ns = self._now_ns() + HAND_OVER_NS
        if ready_ns > self._free_ns:
            self._free_ns = ready_ns
            missed = math.ceil(
                (ready_ns + step_ns - self._due_ns(self._number)) / self._period_ns
            )
            self._number += max(0, missed)
            first = _steps((self._due_ns(self._number) - ready_ns) / step_ns)
            pull_ns = 0.0
        else:
            late_ns = self._free_ns + rest_ns - self._due_ns(self._number)
            pull_ns = min(max(late_ns / self._block, -PULL_NS), PULL_NS)
            first = _steps((rest_ns - pull_ns) / step_ns)
        each = _steps((rest_ns - pull_ns) / step_ns)
        commands = b""
        for steps in (first, *[each] * (self._block - 1)):
            begin_ns = self._free_ns + steps * step_ns
            self._planned.append((self._number, round(begin_ns)))
            self._number, self._free_ns = self._number + 1, begin_ns + self._scan_ns
            idle = bytes([IDLE, steps - 1 & 0xFF, steps - 1 >> 8])
            commands += RELEASED + idle + self._batch + bytes([FLUSH])
        taken_ms = math.ceil(1e-6 * (BLOCKS + 1) * self._block * self._period_ns)
        self._writes.append(
            self._writer.submit(
                self._port.write, OUT_ENDPOINT, commands, TIMEOUT_MS + taken_ms
            )
        )

    def _due_ns(self, number: int) -> float:
        return self._start_ns + number * self._period_ns

    def _require_written(self, *, wait: bool) -> None:
        """Raise the error of a block that could not be written."""
        while self._writes and (wait or self._writes[0].done()):
            self._writes.popleft().result()

    def _wait_for_answer(self, answers: int = 1) -> bool:
        """Read until so many answers are there; whether they had to be waited for."""
        waited = False
        due_ns = self._planned[answers - 1][1] + PATIENCE_PERIODS * self._period_ns
        while len(self._rest) < answers * self._bytes:
            packet = self._port.read(IN_ENDPOINT, PACKET)
            if len(packet) <= STATUS_BYTES and self._now_ns() > due_ns:
                raise TransferFailed("the queued scans stopped", where=self.name)
            waited = waited or len(packet) <= STATUS_BYTES
            self._rest += packet[STATUS_BYTES:]
        return waited

    def _measure(self, number: int, t_ns: int) -> None:
        """Learn from the earliest answer of a block when the chip's scans really begin.

        The earliest, because a host that stalls sees an answer late, and never early.
        """
        error_ns = self._now_ns() - self._scan_ns - t_ns
        earliest_ns = (
            error_ns if self._earliest_ns is None else min(self._earliest_ns, error_ns)
        )
        self._earliest_ns = earliest_ns
        if number % self._block:
            return
        self._earliest_ns = None
        self._free_ns += PHASE_TRUST * earliest_ns
        self._scan_ns += LENGTH_TRUST * earliest_ns / self._block
        self.ns_per_byte = self._scan_ns / (self._bytes - PIN_BYTES)


def most_block(transfers: Sequence[Transfer]) -> int:
    """How many scans of these transfers a block may have at most."""
    return FIFO // BLOCKS // batch_of(transfers)[1]


def _steps(wanted: float) -> int:
    return min(max(round(wanted), 1), MOST_IDLE)
