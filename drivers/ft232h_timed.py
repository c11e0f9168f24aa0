"""EXPERIMENT: an FT232H that times the scans itself, several queued ahead in one USB transfer.

Before each scan the engine clocks a counted number of bits with its pins released (0x8F): nothing
moves on the bus, and time passes by the chip's own quartz. So a scan begins when the chip says, and
not when the host's scheduler lets the program run. A host that is away for less than a block
finds every sample when it comes back; only their answers are late.

Never tried on a real chip. How long its engine takes for a pin write is not documented, so the
driver measures how long a scan lasts and adjusts the clocks between scans. It has no recovery: at
any error the caller goes back to `Ft232h.scan`. `holdfast run` does not use it, because its loop
skips the samples that it is late for instead of answering them one after another.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from drivers.bus import Reply, Transfer
from drivers.ft232h import (
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
from edge_runtime.errors import TransferFailed, UsageError

IDLE = 0x8F
"""Clock 8 (n + 1) bits without data."""
IDLE_BITS, MOST_IDLE = 8, 1 << 16
RELEASED = bytes([SET_LOW_PINS, SCL | SDA, 0])
"""All pins are inputs: the engine's clock does not reach SCL."""
BLOCKS = 2
"""One is carried out while the other waits in the host's USB controller."""
FIFO = 1024
"""Bytes that wait in the chip for a host that does not read."""
TRUST = 0.25
"""Share of a new measurement in what a scan is taken to last."""
TRIES = 3
EMPTY_READS = 2000


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
        self._planned: deque[tuple[int, int]] = deque()
        self._writes: deque[Future[object]] = deque()

    def begin(self, transfers: Sequence[Transfer], period_ns: int, block: int = 8) -> None:
        """Queue two blocks of scans, `block` each, a period apart.

        Raises UsageError where their answers do not fit the chip's memory or a scan does not fit a
        period, and a DeviceError.
        """
        self._transfers, self._period_ns, self._block = list(transfers), period_ns, block
        self._batch, self._bytes = batch_of(transfers)
        if 2 * self._bytes > MOST_IN or BLOCKS * block * self._bytes > FIFO:
            raise UsageError(
                f"{BLOCKS * block} scans of {self._bytes} bytes do not fit the chip's memory",
                cause=f"it keeps {FIFO} bytes while its host is away",
                next_step=f"queue blocks of at most {FIFO // BLOCKS // self._bytes} scans",
            )
        self._ask(b"", 0)
        self._doubtful = True
        self._scan_ns = float(self._fastest_ns(2) - self._fastest_ns(1))
        self._rest, self._number, self._next_ns = b"", 0, self._now_ns()
        self._measured: tuple[int, int] | None = None
        for _ in range(BLOCKS):
            self._queue()

    def next(self) -> TimedScan:
        """The next scan; waits for it, and keeps two blocks queued. Raises a DeviceError."""
        waited = self._wait_for_answer()
        number, t_ns = self._planned.popleft()
        answer, self._rest = self._rest[: self._bytes], self._rest[self._bytes :]
        if waited:
            self._measure(number, t_ns)
        if len(self._planned) <= self._block * (BLOCKS - 1):
            self._queue()
        return TimedScan(number, t_ns, replies_of(self._transfers, answer))

    def end(self) -> None:
        """Wait for the scans that are queued, and throw them away. Raises a DeviceError."""
        while self._planned:
            self._wait_for_answer()
            self._planned.popleft()
            self._rest = self._rest[self._bytes :]
        self._require_written(wait=True)

    def close(self) -> None:
        """Give the bridge back; a second call does no harm."""
        self._writer.shutdown(wait=False, cancel_futures=True)
        super().close()

    def _fastest_ns(self, scans: int) -> int:
        """The shortest round trip of so many scans in one batch, of some tries."""
        spent_ns = []
        for _ in range(TRIES):
            began_ns = self._now_ns()
            self._ask(self._batch * scans, self._bytes * scans)
            spent_ns.append(self._now_ns() - began_ns)
        return min(spent_ns)

    def _queue(self) -> None:
        """One more block. Periods that have passed without a scan are counted by their numbers."""
        self._require_written(wait=False)
        idle = round((self._period_ns - self._scan_ns) / self._bit_ns / IDLE_BITS)
        if not 1 <= idle <= MOST_IDLE:
            raise UsageError(
                f"a scan of {1e-6 * self._scan_ns:.2f} ms cannot come every "
                f"{1e-6 * self._period_ns:.2f} ms",
                next_step="scan more slowly, or without the chip's own timing",
            )
        idle_ns = round(idle * IDLE_BITS * self._bit_ns)
        late_ns = self._now_ns() - (self._next_ns - idle_ns)
        if late_ns > 0:
            missed = int(late_ns // self._period_ns) if self._number else 0
            self._number += missed
            self._next_ns += late_ns
        for _ in range(self._block):
            self._planned.append((self._number, self._next_ns))
            self._number, self._next_ns = self._number + 1, self._next_ns + self._period_ns
        wait = bytes([IDLE, idle - 1 & 0xFF, idle - 1 >> 8])
        commands = (RELEASED + wait + self._batch + bytes([FLUSH])) * self._block
        self._writes.append(self._writer.submit(self._port.write, OUT_ENDPOINT, commands))

    def _require_written(self, *, wait: bool) -> None:
        """Raise the error of a block that could not be written."""
        while self._writes and (wait or self._writes[0].done()):
            self._writes.popleft().result()

    def _wait_for_answer(self) -> bool:
        """Read until a whole answer is there; whether it had to be waited for."""
        empty = 0
        while len(self._rest) < self._bytes:
            packet = self._port.read(IN_ENDPOINT, PACKET)
            empty += len(packet) <= STATUS_BYTES
            if empty > EMPTY_READS:
                raise TransferFailed("the queued scans stopped", where=self.name)
            self._rest += packet[STATUS_BYTES:]
        return empty > 0

    def _measure(self, number: int, t_ns: int) -> None:
        """Learn from an answer that was waited for how long a scan lasts, and when it began."""
        now_ns, before = self._now_ns(), self._measured
        if before is not None and number - before[0] < self._block:
            return
        self._measured = number, now_ns
        self._next_ns += round(TRUST * (now_ns - self._scan_ns - t_ns))
        if before is not None and number - before[0] == self._block:
            apart_ns = (now_ns - before[1]) / self._block
            self._scan_ns += TRUST * (apart_ns - self._period_ns)
