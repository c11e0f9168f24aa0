"""Six fingertips on a bus: brought up, read in one scan, and brought back when something fails.

A reading is valid only where the chip acknowledged, its CRC fits (drivers/packet_check.py), it has
converted anew within 20 ms, kept its power, found no fault in itself, and is not at the end of its
range. It has converted anew where its packet differs: results and SET_COUNT change with a
conversion and with nothing else. (SET_COUNT alone rolls over every 8 conversions, 19.4 ms, and
seems to stand still when read at 50 Hz.)

A mux is part of every reading behind it: a select that was not acknowledged makes these readings
invalid, and while anything on the bus was in doubt in the last ten seconds, each mux is read back
after its fingers.

A failure costs only itself, and is repaired while the others are read on (the recovery ladder):

    a finger      does not acknowledge twice in a row, lost its power, or two CRCs do not fit: it is brought up anew
    the bus       is held low: nine clocks
    the bridge    fails three times in a row: it is opened anew
                  is gone from USB, or no longer ours: it is looked for, until it is there
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from drivers.bring_up import bring_up
from drivers.bus import Bus, Reply, Transfer, freeing
from drivers.finger_state import TRY_AGAIN_NS, FingerState
from drivers.layout import LAYOUTS, Channel, Finger, masks_of, muxes_of, read_behind
from drivers.mux import is_mux, joined, plain_read
from drivers.packet_check import MOST_TEST_PACKETS
from drivers.tmag5273 import GENERAL_CALL, TRIGGER, Setup, conversion_s
from edge_runtime.contract import BoolArray, FloatArray
from edge_runtime.errors import (
    BusStuck,
    DeviceError,
    DeviceNotFound,
    TransferFailed,
    WrongDevice,
)

FAILURES_TO_REOPEN = 3
TRIES_AT_START = 3
"""A bit that is flipped once must not keep a hand from starting."""
DOUBT_NS = 10_000_000_000
DOUBTS = frozenset({"crc", "nack", "garbage", "reset", "mux"})
"""What a bus that flips bits looks like."""
NO_READING = (np.nan, np.nan, np.nan)

Crc = Literal["auto", "on", "off"]


@dataclass(frozen=True)
class Reading:
    """One scan: field_ut [S, 3] (NaN where nothing came), valid [S], and why not: one word a
    finger, "" where valid."""

    t_ns: int
    field_ut: FloatArray
    valid: BoolArray
    why: tuple[str, ...]


@dataclass
class _Group:
    """Fingers that are read behind the same channels. A place is an index of a scan's transfers and
    replies.

    fingers: number -> place; selects: places; masks: of every mux meanwhile; read_backs: place ->
    mask that came back.
    """

    fingers: dict[int, int]
    selects: list[int]
    masks: dict[int, int]
    read_backs: dict[int, int]

    def joined(self, replies: Sequence[Reply]) -> bool:
        """Whether every select was acknowledged, and every mux held its mask where it was read
        back."""
        held = all(replies[place].data == bytes([mask]) for place, mask in self.read_backs.items())
        return held and all(replies[place].acked for place in self.selects)


@dataclass(frozen=True)
class _Plan:
    """A scan's transfers, their groups, and the masks of the muxes after it."""

    transfers: list[Transfer]
    groups: list[_Group]
    masks: dict[int, int]


def _read_back(transfers: list[Transfer], groups: list[_Group], doubtful: bool) -> None:
    """End a group: while the bus is in doubt, with what each mux holds."""
    for mux, mask in groups[-1].masks.items() if doubtful and groups else ():
        groups[-1].read_backs[len(transfers)] = mask
        transfers.append(Transfer(mux, b"", 1))


@dataclass(frozen=True)
class _Scanned:
    """A reply for each finger, None where it was not read; unjoined: fingers whose mux did not do
    as it was told."""

    replies: list[Reply | None]
    unjoined: set[int]


class Hand:
    """Fingers behind a bridge that open_bus opens. now_ns, pause (s): the clock; say: told what
    fails and comes back.

    crc: "auto" checks each chip that sends a CRC, says which do not and reads them unchecked; "on"
    refuses those; "off" checks none. start raises what keeps every finger from being read; later
    nothing is raised, and readings say what is wrong.
    """

    def __init__(
        self,
        open_bus: Callable[[], Bus],
        fingers: Sequence[Finger] = LAYOUTS["mux"],
        *,
        setup: Setup | None = None,
        crc: Crc = "auto",
        now_ns: Callable[[], int],
        pause: Callable[[float], None],
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        self.fingers, self.setup, self.crc = tuple(fingers), setup or Setup(), crc
        self._open_bus, self._now_ns, self._pause, self._say = open_bus, now_ns, pause, say
        self._states = [
            FingerState(finger, replace(self.setup, crc=crc != "off")) for finger in self.fingers
        ]
        self._bus: Bus | None = None
        self._muxes = muxes_of(self.fingers)
        self._behind = [read_behind(self.fingers, finger) for finger in self.fingers]
        self._everywhere = frozenset[Channel]().union(*(finger.behind for finger in self.fingers))
        self._masks: dict[int, int] = {}
        self._plans: dict[object, _Plan] = {}
        self._failures = 0
        self._looked_ns = -TRY_AGAIN_NS
        self._doubtful_until_ns = 0
        self._complaint = ""
        self._was = tuple("" for _ in self.fingers)
        self._range_mt = np.array([self.setup.range_mt(state.version) for state in self._states])

    def start(self) -> None:
        """Open the bridge and bring up every finger that answers; a bus that is held low is freed.

        Raises a DeviceError, and gives the bridge back: the bridge's, DeviceNotFound where no
        finger or no mux answers, WrongDevice for another chip, two at one address, or (crc "on")
        one without a CRC.
        """
        try:
            bus = self._bus = self._open_bus()
            freeing(bus, self._start_fingers)
            freeing(bus, self._settle)
        except BaseException:
            self.close()
            raise

    def read(self) -> Reading:
        """One scan; whatever fails is in the reading, and its repair has been begun."""
        t_ns = self._now_ns()
        bus = self._bus or self._look_for_bridge(t_ns)
        if bus is None:
            return self._nothing(t_ns, "lost")
        try:
            scanned = self._scan(bus)
        except BusStuck as error:
            return self._free(bus, t_ns, error)
        except TransferFailed as error:
            self._failures += 1
            if self._failures >= FAILURES_TO_REOPEN:
                return self._give_up(t_ns, error)
            return self._nothing(t_ns, "bridge")
        except DeviceError as error:  # gone, or taken by another program
            return self._give_up(t_ns, error)
        self._failures, self._complaint = 0, ""
        reading = self._judge(t_ns, scanned)
        self._repair(reading)
        self._tell(reading.why)
        return reading

    def about(self) -> dict[str, object]:
        """What is known of what is read: the bridge, the place and variant of every finger, and how
        they convert.

        The chip has no serial number, and the bridges do not tell their firmware.
        """
        sensors = [
            {
                "finger": k,
                "address": f"0x{finger.address:02x}",
                "channel": finger.channel,
                "mux": None if finger.channel is None else f"0x{finger.mux:02x}",
                "ready": state.ready,
                "range_mt": self.setup.range_mt(state.version).tolist(),
                "version": state.version,
                "serial": None,
                "crc": state.setup.crc,
            }
            for k, (finger, state) in enumerate(zip(self.fingers, self._states, strict=True), 1)
        ]
        return {
            "bridge": None if self._bus is None else self._bus.name,
            "firmware": None,
            "chip": "TMAG5273",
            "averages": self.setup.averages,
            "sensors": sensors,
        }

    def close(self) -> None:
        """Give the bridge back."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    # -- at start

    def _start_fingers(self) -> None:
        troubles = self._bring_up_all()
        for trouble in troubles:
            if isinstance(trouble, WrongDevice):
                raise trouble
        if not any(state.ready for state in self._states):
            assert self._bus is not None
            raise DeviceNotFound(
                "no finger answers",
                where=self._bus.name,
                cause="no power, SDA and SCL swapped, or another layout",
                next_step="holdfast scan",
            )
        for k, trouble in enumerate(troubles):
            if trouble is not None:
                self._say(f"finger {k + 1}: {trouble}")

    def _find_muxes(self) -> None:
        """See that a mux is where the layout has one, before it is written to. Raises
        DeviceNotFound, WrongDevice."""
        bus = self._bus
        assert bus is not None
        self._masks = {}
        for mux in sorted(self._muxes):
            if any(is_mux(bus, mux) for _ in range(TRIES_AT_START)):
                self._masks[mux] = 0
            elif plain_read(bus, mux):
                raise WrongDevice(
                    "another chip, no mux (TCA9548A)",
                    where=f"{mux:#04x}",
                    cause="the mux has another address",
                    next_step="holdfast scan; layout=mux@71 for a mux at 0x71",
                )
            else:
                raise DeviceNotFound(
                    "no mux answers",
                    where=f"{mux:#04x}",
                    cause="no power, SDA and SCL swapped, or its address pins A0 to A2 make 0x70 to 0x77 of it",
                    next_step="holdfast scan; layout=mux@71 for a mux at 0x71",
                )

    def _tried_to_bring_up(self, k: int) -> DeviceError | None:
        """Bring a finger up, again where it seems another chip; what is wrong with it, or None."""
        for _ in range(TRIES_AT_START):
            trouble = self._bring_up(k)
            if not isinstance(trouble, WrongDevice):
                break
        return trouble

    def _settle(self) -> None:
        """Read until each finger has converted and its CRC is tested, so that the first reading can
        be valid.

        Raises WrongDevice where a CRC does not pass its test.
        """
        bus = self._bus
        assert bus is not None
        conversion = conversion_s(self.setup.averages)
        for _ in range(MOST_TEST_PACKETS + 1):
            self._pause(conversion)
            self._judge(self._now_ns(), self._scan(bus))
            for k, state in enumerate(self._states):
                if state.check.absent and state.setup.crc:
                    self._go_without_crc(k)
            if all(state.settled for state in self._states):
                break
        self._pause(conversion)
        for k, state in enumerate(self._states):
            if state.ready and state.check.failures:
                raise WrongDevice(
                    f"finger {k + 1}: its CRC does not fit its packets",
                    where=f"{state.finger.read_at:#04x}",
                    cause="two chips at one address, noise on the bus, or a chip whose CRC is broken",
                    next_step="holdfast scan; shorter wires or bus_hz=100000; crc=off reads all fingers unchecked",
                )

    def _go_without_crc(self, k: int) -> None:
        """Read a chip that sends no CRC without. Raises WrongDevice where it must."""
        state = self._states[k]
        if self.crc == "on":
            raise WrongDevice(
                f"finger {k + 1}: sends no CRC",
                where=f"{state.finger.read_at:#04x}",
                cause="a chip whose CRC does not work",
                next_step="crc=auto reads this finger unchecked",
            )
        self._say(f"finger {k + 1}: sends no CRC, its readings are unchecked (crc=auto)")
        state.configure(self.setup)
        self._plans.clear()
        self._bring_up(k)

    # -- a scan

    def _scan(self, bus: Bus) -> _Scanned:
        """A reply for each finger that is ready, and which of them cannot be relied on because of a
        mux."""
        if self.setup.together:
            self._convert(bus)
        plan = self._plan()
        try:
            answers = bus.scan(plan.transfers)
        except DeviceError:
            self._masks = {}
            raise
        replies: list[Reply | None] = [None] * len(self.fingers)
        unjoined: set[int] = set()
        for group in plan.groups:
            if unjoined or not group.joined(answers):
                self._masks = {}
                unjoined |= group.fingers.keys()
            for k, place in group.fingers.items():
                replies[k] = answers[place]
        return _Scanned(replies, unjoined)

    def _plan(self) -> _Plan:
        """What a scan carries out now; a hand asks for the same again and again."""
        doubtful = self._now_ns() < self._doubtful_until_ns
        key = (doubtful, tuple(self._masks.items()), tuple([state.ready for state in self._states]))
        if key not in self._plans:
            self._plans[key] = self._planned(doubtful)
        plan = self._plans[key]
        self._masks = {**plan.masks}
        return plan

    def _planned(self, doubtful: bool) -> _Plan:
        """By groups of fingers behind the same channels, each read back while the bus is in
        doubt."""
        transfers: list[Transfer] = []
        groups: list[_Group] = []
        for k, state in enumerate(self._states):
            if not state.ready:
                continue
            selects = self._select(self._behind[k])
            if selects or not groups:
                _read_back(transfers, groups, doubtful)
                places = range(len(transfers), len(transfers) + len(selects))
                groups.append(_Group({}, [*places], {**self._masks}, {}))
                transfers += selects
            groups[-1].fingers[k] = len(transfers)
            transfers.append(state.transfer)
        _read_back(transfers, groups, doubtful)
        return _Plan(transfers, groups, {**self._masks})

    def _convert(self, bus: Bus) -> None:
        """One conversion of every chip, begun at one moment, and waited for."""
        bus.scan([*self._select(self._everywhere), Transfer(GENERAL_CALL, bytes([TRIGGER]))])
        self._pause(conversion_s(self.setup.averages))

    def _select(self, channels: frozenset[Channel]) -> list[Transfer]:
        """Join these channels and no others, where the muxes do not hold that already."""
        wanted = masks_of(channels, self._muxes) if channels else {}
        told = [joined(mux, mask) for mux, mask in wanted.items() if self._masks.get(mux) != mask]
        self._masks = self._masks | wanted
        return told

    def _judge(self, t_ns: int, scanned: _Scanned) -> Reading:
        came_ns = self._now_ns()  # not when it was asked for: a machine can stand still meanwhile
        judged = [
            (None, "mux") if k in scanned.unjoined else state.judge(reply, came_ns)
            for k, (state, reply) in enumerate(zip(self._states, scanned.replies, strict=True))
        ]
        why = tuple([word for _, word in judged])
        if not DOUBTS.isdisjoint(why):
            self._doubtful_until_ns = came_ns + DOUBT_NS
        raw = np.array(
            [NO_READING if found is None else found.raw for found, _ in judged], dtype=np.float64
        )
        return Reading(
            t_ns, raw * (1e3 / 32768.0) * self._range_mt, np.array([not word for word in why]), why
        )

    # -- the ladder

    def _repair(self, reading: Reading) -> None:
        """Bring up one finger that needs it, the one that waits longest, so that the others are
        read on time."""
        due = [
            (state.tried_ns, k)
            for k, (state, why) in enumerate(zip(self._states, reading.why, strict=True))
            if state.needs_bring_up(why) and reading.t_ns - state.tried_ns >= TRY_AGAIN_NS
        ]
        try:
            for k, state in enumerate(self._states):
                if state.check.absent and state.setup.crc and self.crc == "auto":
                    self._go_without_crc(k)
            if due:
                self._bring_up(min(due)[1])
        except DeviceError:
            self._masks = {}  # the next scan meets it again, and climbs on

    def _free(self, bus: Bus, t_ns: int, error: DeviceError) -> Reading:
        """Nine clocks; where they do not help, the bridge is opened anew."""
        self._complain(error)
        try:
            bus.clear()
        except DeviceError as worse:
            return self._give_up(t_ns, worse)
        return self._nothing(t_ns, "stuck")

    def _give_up(self, t_ns: int, error: DeviceError) -> Reading:
        """Close the bridge; the next readings look for it."""
        self._complain(error)
        self.close()
        self._failures = 0
        return self._nothing(t_ns, "lost")

    def _complain(self, error: DeviceError) -> None:
        """Say what is wrong with bus or bridge, once until a scan has gone well."""
        if str(error) != self._complaint:
            self._say(str(error))
        self._complaint = str(error)

    def _look_for_bridge(self, t_ns: int) -> Bus | None:
        if t_ns - self._looked_ns < TRY_AGAIN_NS:
            return None
        self._looked_ns = t_ns
        try:
            bus = self._bus = self._open_bus()
            freeing(bus, self._bring_up_all)
        except DeviceError:
            self.close()
            return None
        self._say(f"{bus.name}: back")
        return bus

    def _nothing(self, t_ns: int, why: str) -> Reading:
        self._masks = {}
        reading = Reading(
            t_ns,
            np.full((len(self.fingers), 3), np.nan),
            np.zeros(len(self.fingers), dtype=np.bool_),
            tuple(why for _ in self.fingers),
        )
        self._tell(reading.why)
        return reading

    def _tell(self, why: tuple[str, ...]) -> None:
        """Say what has changed since the last scan, one line a finger."""
        for k, (before, now) in enumerate(zip(self._was, why, strict=True), 1):
            if before != now:
                self._say(f"finger {k}: {now or 'good again'}")
        self._was = why

    def _bring_up_all(self) -> list[DeviceError | None]:
        """Every finger, behind muxes that were found; what is wrong with each."""
        self._find_muxes()
        return [self._tried_to_bring_up(k) for k in range(len(self.fingers))]

    def _bring_up(self, k: int) -> DeviceError | None:
        """Make a finger ready; what is wrong with it, or None. Raises what the bridge raises."""
        bus, state = self._bus, self._states[k]
        assert bus is not None
        state.begin(self._now_ns())
        try:
            self._join(bus, state.finger)
            version = bring_up(bus, state.finger, state.setup, self._pause, known=state.known)
        except (DeviceNotFound, WrongDevice) as trouble:
            return trouble
        self._range_mt[k] = self.setup.range_mt(version)
        state.brought_up(version, self._now_ns())
        return None

    def _join(self, bus: Bus, finger: Finger) -> None:
        """Join a finger's channel alone, and see that it is. Raises DeviceNotFound."""
        self._masks = {}
        selects = self._select(finger.behind)
        held = bus.scan([*selects, *(Transfer(one.address, b"", 1) for one in selects)])[
            len(selects) :
        ]
        if any(reply.data != select.write for reply, select in zip(held, selects, strict=True)):
            self._masks = {}
            raise DeviceNotFound(
                "its mux does not switch",
                where=f"{finger.mux:#04x}",
                cause="no power, or noise on the bus",
                next_step="holdfast scan",
            )
