"""Six fingertips on a bus: brought up, read in one scan, and brought back when something fails.

A reading is valid only where the chip acknowledged, has converted anew within 20 ms, kept its power, found no fault in
itself, and is not at the end of its range. It has converted anew where its packet differs: results and SET_COUNT
change with a conversion and with nothing else. (SET_COUNT alone rolls over every 8 conversions, 19.4 ms, and seems to
stand still to whoever reads at 50 Hz.) Whatever fails costs only itself, and is repaired while the others are read
on (the recovery ladder):

    a finger      does not acknowledge twice in a row, or lost its power: it is brought up anew
    the bus       is held low: nine clocks
    the bridge    fails three times in a row: it is opened anew
                  is gone from USB, or no longer ours: it is looked for, until it is there
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.bring_up import bring_up, configure_all
from drivers.bus import Bus, Reply, Transfer
from drivers.layout import LAYOUTS, Finger, joined, read_behind
from drivers.tmag5273 import GENERAL_CALL, PACKET_BYTES, RESULTS, TRIGGER, Packet, Setup, conversion_s, packet
from edge_runtime.contract import BoolArray, FloatArray
from edge_runtime.errors import (
    BusStuck,
    DeviceError,
    DeviceNotFound,
    TransferFailed,
    WrongDevice,
)

STALE_NS = 20_000_000
TRY_AGAIN_NS = 50_000_000
"""A finger that cannot be brought up, or a bridge that is gone, is tried so often."""
FAILURES_TO_REOPEN = 3
NACKS_TO_BRING_UP = 2
EDGE = 32767
GARBAGE = (bytes(PACKET_BYTES), b"\xff" * PACKET_BYTES)
NOTHING_CAME = (np.nan, np.nan, np.nan)
TIRED = ("reset", "missing", "stale", "garbage", "diagnosis")
"""Why a finger is brought up anew, beside two missing acknowledges."""


@dataclass(frozen=True)
class Reading:
    """One scan: field_ut [S, 3] (NaN where nothing came), valid [S], and why not: one word a finger, "" where valid."""

    t_ns: int
    field_ut: FloatArray
    valid: BoolArray
    why: tuple[str, ...]


@dataclass
class _State:
    """What is known of a finger."""

    ready: bool = False
    version: int = 1
    last: bytes = b""
    changed_ns: int = 0
    converts: bool = False
    nacks: int = 0
    tried_ns: int = -TRY_AGAIN_NS


class Hand:
    """Fingers behind a bridge that open_bus opens. now_ns, pause (s): the clock; say: told what fails and comes back.

    start raises what keeps every finger from being read; later nothing is raised, and readings say what is wrong.
    """

    def __init__(
        self,
        open_bus: Callable[[], Bus],
        fingers: Sequence[Finger] = LAYOUTS["mux"],
        *,
        setup: Setup | None = None,
        now_ns: Callable[[], int],
        pause: Callable[[float], None],
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        self.fingers, self.setup = tuple(fingers), setup or Setup()
        self._open_bus, self._now_ns, self._pause, self._say = open_bus, now_ns, pause, say
        self._states = [_State() for _ in self.fingers]
        self._bus: Bus | None = None
        self._behind = [read_behind(self.fingers, finger) for finger in self.fingers]
        self._everywhere = frozenset(one.channel for one in self.fingers if one.channel is not None)
        self._joined: frozenset[int] | None = None
        self._failures = 0
        self._looked_ns = -TRY_AGAIN_NS
        self._was = tuple("" for _ in self.fingers)
        self._range_mt = np.array([self.setup.range_mt(state.version) for state in self._states])

    def start(self) -> None:
        """Open the bridge and bring up every finger that answers.

        Raises a DeviceError: the bridge's, DeviceNotFound where no finger answers, WrongDevice for another chip.
        """
        self._bus = self._open_bus()
        if self.setup.together:
            self._bus.scan(self._select(self._everywhere))
            configure_all(self._bus, self.setup)
        troubles = [self._bring_up(k) for k in range(len(self.fingers))]
        for trouble in troubles:
            if isinstance(trouble, WrongDevice):
                raise trouble
        if not any(state.ready for state in self._states):
            raise DeviceNotFound(
                "no finger answers", where=self._bus.name, cause="no power, SDA and SCL swapped, or another layout",
                next_step="holdfast scan",
            )  # fmt: skip
        for k, trouble in enumerate(troubles):
            if trouble is not None:
                self._say(f"finger {k + 1}: {trouble}")
        settle_s = 2.0 * conversion_s(self.setup.averages)
        self._pause(settle_s)
        self._judge(self._now_ns(), self._scan(self._bus))  # so that the first reading can see SET_COUNT change
        self._pause(settle_s)

    def read(self) -> Reading:
        """One scan; whatever fails is in the reading, and its repair has been begun."""
        t_ns = self._now_ns()
        bus = self._bus or self._look_for_bridge(t_ns)
        if bus is None:
            return self._nothing(t_ns, "lost")
        try:
            replies = self._scan(bus)
        except BusStuck as error:
            return self._free(bus, t_ns, error)
        except TransferFailed as error:
            self._failures += 1
            if self._failures >= FAILURES_TO_REOPEN:
                return self._give_up(t_ns, error)
            self._joined = None
            return self._nothing(t_ns, "bridge")
        except DeviceError as error:  # gone, or taken by another program
            return self._give_up(t_ns, error)
        self._failures = 0
        reading = self._judge(t_ns, replies)
        self._repair(reading)
        self._tell(reading.why)
        return reading

    def about(self) -> dict[str, object]:
        """What is known of what is read: the bridge, the place and variant of every finger, and how they convert.

        The chip has no serial number, and the bridges do not tell their firmware.
        """
        sensors = [
            {"finger": k, "address": f"0x{finger.address:02x}", "channel": finger.channel, "ready": state.ready,
             "range_mt": self.setup.range_mt(state.version).tolist(), "version": state.version, "serial": None}
            for k, (finger, state) in enumerate(zip(self.fingers, self._states, strict=True), 1)
        ]  # fmt: skip
        return {
            "bridge": None if self._bus is None else self._bus.name, "firmware": None, "chip": "TMAG5273",
            "averages": self.setup.averages, "sensors": sensors,
        }  # fmt: skip

    def close(self) -> None:
        """Give the bridge back."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    # -- a scan

    def _scan(self, bus: Bus) -> list[Reply | None]:
        """A reply for each finger that is ready."""
        transfers, places = [], []
        if self.setup.together:
            self._convert(bus)
        for k, finger in enumerate(self.fingers):
            if self._states[k].ready:
                transfers += self._select(self._behind[k])
                places.append((k, len(transfers)))
                transfers.append(self._results(finger))
        try:
            answers = bus.scan(transfers)
        except DeviceError:
            self._joined = None
            raise
        replies: list[Reply | None] = [None] * len(self.fingers)
        for k, place in places:
            replies[k] = answers[place]
        return replies

    def _results(self, finger: Finger) -> Transfer:
        return Transfer(finger.read_at, b"" if self.setup.burst else bytes([RESULTS]), PACKET_BYTES)

    def _convert(self, bus: Bus) -> None:
        """One conversion of every chip, begun at one moment, and waited for."""
        bus.scan([*self._select(self._everywhere), Transfer(GENERAL_CALL, bytes([TRIGGER]))])
        self._pause(conversion_s(self.setup.averages))

    def _select(self, channels: frozenset[int]) -> list[Transfer]:
        """Join these channels, if they are not."""
        if not channels or channels == self._joined:
            return []
        self._joined = channels
        return [joined(channels)]

    def _judge(self, t_ns: int, replies: Sequence[Reply | None]) -> Reading:
        came = [packet(one.data) if one is not None and len(one.data) == PACKET_BYTES else None for one in replies]
        came_ns = self._now_ns()  # not when it was asked for: a machine can stand still meanwhile
        told = zip(self._states, replies, came, strict=True)
        why = tuple([self._trouble(state, reply, found, came_ns) for state, reply, found in told])
        raw = np.array([NOTHING_CAME if found is None else found.raw for found in came], dtype=np.float64)
        return Reading(t_ns, raw * (1e3 / 32768.0) * self._range_mt, np.array([not one for one in why]), why)

    def _trouble(self, state: _State, reply: Reply | None, found: Packet | None, came_ns: int) -> str:
        """One word for why a finger's reading is not valid, or nothing."""
        if reply is None:
            return "missing"
        if not reply.acked or found is None:
            state.nacks += 1
            return "nack"
        state.nacks = 0
        if reply.data in GARBAGE:
            return "garbage"
        if found.reset:
            return "reset"
        if found.failing:
            return "diagnosis"
        if reply.data != state.last:
            state.converts = bool(state.last)
            state.last, state.changed_ns = reply.data, came_ns
        if came_ns - state.changed_ns > STALE_NS:
            state.converts = False
        if not state.converts:
            return "stale"
        return "saturated" if max(found.raw) >= EDGE or min(found.raw) <= -EDGE else ""

    # -- the ladder

    def _repair(self, reading: Reading) -> None:
        """Bring up fingers that need it, at most one a scan, so that the others are read on time."""
        for k, (state, why) in enumerate(zip(self._states, reading.why, strict=True)):
            tired = state.nacks >= NACKS_TO_BRING_UP or why in TIRED
            if tired and reading.t_ns - state.tried_ns >= TRY_AGAIN_NS:
                try:
                    self._bring_up(k)
                except DeviceError:
                    self._joined = None  # the next scan meets it again, and climbs on
                return

    def _free(self, bus: Bus, t_ns: int, error: DeviceError) -> Reading:
        """Nine clocks; where they do not help, the bridge is opened anew."""
        self._say(str(error))
        try:
            bus.clear()
        except DeviceError as worse:
            return self._give_up(t_ns, worse)
        return self._nothing(t_ns, "stuck")

    def _give_up(self, t_ns: int, error: DeviceError) -> Reading:
        """Close the bridge; the next readings look for it."""
        self._say(str(error))
        self.close()
        self._failures = 0
        return self._nothing(t_ns, "lost")

    def _look_for_bridge(self, t_ns: int) -> Bus | None:
        if t_ns - self._looked_ns < TRY_AGAIN_NS:
            return None
        self._looked_ns = t_ns
        try:
            self._bus = self._open_bus()
            for k in range(len(self.fingers)):
                self._bring_up(k)
        except DeviceError:
            self.close()
            return None
        self._say(f"{self._bus.name}: back")
        return self._bus

    def _nothing(self, t_ns: int, why: str) -> Reading:
        self._joined = None
        reading = Reading(
            t_ns, np.full((len(self.fingers), 3), np.nan), np.zeros(len(self.fingers), dtype=np.bool_),
            tuple(why for _ in self.fingers),
        )  # fmt: skip
        self._tell(reading.why)
        return reading

    def _tell(self, why: tuple[str, ...]) -> None:
        """Say what has changed since the last scan, one line a finger."""
        for k, (before, now) in enumerate(zip(self._was, why, strict=True), 1):
            if before != now:
                self._say(f"finger {k}: {now or 'good again'}")
        self._was = why

    def _bring_up(self, k: int) -> DeviceError | None:
        """Make a finger ready; what is wrong with it, or None. Raises what the bridge raises."""
        bus, finger, state = self._bus, self.fingers[k], self._states[k]
        assert bus is not None
        state.tried_ns, state.ready, state.nacks = self._now_ns(), False, 0
        self._joined = None
        if finger.channel is not None:
            bus.scan(self._select(frozenset({finger.channel})))
        try:
            state.version = bring_up(bus, finger, self.setup, self._pause)
        except (DeviceNotFound, WrongDevice) as trouble:
            return trouble
        self._range_mt[k] = self.setup.range_mt(state.version)
        state.ready, state.last, state.changed_ns = True, b"", self._now_ns()
        state.converts = False
        return None
