"""The fingertips of a hand on an open bus: brought up, scanned, judged and brought up again.

A reading is valid only if all of this holds: the chip acknowledged, it converted anew within the
last 20 ms, it kept its power, its own diagnosis found no fault, and no axis is at the end of its
range. How a kind of chip tells that is its driver's (drivers/chips.py).

A mux is part of every reading behind it. If a mux write was not acknowledged, the readings behind
that mux are invalid. For ten seconds after any doubtful reply, each mux is read back after its
fingers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from holdfast.core.errors import DeviceError, DeviceNotFound, WrongDevice
from holdfast.core.source import SourceReading
from holdfast.drivers.bus import Bus, Reply, Transfer
from holdfast.drivers.chips import ChipDriver, Raw
from holdfast.drivers.layout import Finger, ScanPlanner, is_mux, plain_read

TRY_AGAIN_NS = 50_000_000
"""The pause between two attempts to bring up a finger."""
NACKS_TO_BRING_UP = 2
REINIT_REASONS = ("reset", "missing", "stale", "garbage", "diagnosis")
"""Reasons for a new bring-up, besides missing acknowledges."""
TRIES_AT_START = 3
"""One flipped bit must not keep a hand from starting."""
MOST_READS_TO_SETTLE = 8
DOUBT_NS = 10_000_000_000
DOUBTS = frozenset({"nack", "garbage", "reset", "mux"})
"""Reasons for an invalid reading that a bus which flips bits produces."""
NO_READING = (np.nan, np.nan, np.nan)
Answer = Reply | str
"""Of a finger: its reply, or one word for why there is none."""


class FingerState:
    """One finger of a hand. chip: the driver of its chip."""

    def __init__(self, finger: Finger, chip: ChipDriver) -> None:
        self.finger = finger
        self.transfer = chip.read(finger.address)
        """The transfer that reads the finger."""
        self.ready = False
        self.version = 1
        self.nacks = 0
        self.tried_ns = -TRY_AGAIN_NS
        self._readings = chip.readings()

    @property
    def settled(self) -> bool:
        """Whether its readings count from now on, or it is not read at all."""
        return not self.ready or self._readings.converts

    def begin(self, now_ns: int) -> None:
        """A bring-up begins at this time; what was counted before it is over."""
        self.tried_ns = now_ns
        self.ready = False
        self.nacks = 0

    def brought_up(self, version: int, now_ns: int) -> None:
        """The chip is ready; its earlier conversions do not count."""
        self.ready = True
        self.version = version
        self._readings.begin(now_ns)

    def needs_bring_up(self, why: str) -> bool:
        """Whether the reason of an invalid reading calls for a bring-up."""
        return self.nacks >= NACKS_TO_BRING_UP or why in REINIT_REASONS

    def judge(self, reply: Reply, came_ns: int) -> tuple[Raw | None, str]:
        """The reply's raw x, y, z, and one word for why they are not valid ("" where they are).

        came_ns: when it came.
        """
        if not reply.acked or len(reply.data) != self.transfer.read:
            self.nacks += 1
            self._readings.missed()
            return None, "nack"
        self.nacks = 0
        return self._readings.judge(reply.data, came_ns)


class Fingers:
    """The fingers of one hand. Methods take the open bus; Hand owns it and its repair.

    now_ns, pause (s): the clock. say: receives one line for each event that the user should see.
    """

    def __init__(
        self,
        fingers: Sequence[Finger],
        chip: ChipDriver,
        *,
        now_ns: Callable[[], int],
        pause: Callable[[float], None],
        say: Callable[[str], None],
    ) -> None:
        self._chip = chip
        self._now_ns = now_ns
        self._pause = pause
        self._say = say
        self._states = [FingerState(finger, chip) for finger in fingers]
        self._planner = ScanPlanner(fingers)
        self._doubtful_until_ns = 0
        self._scale_ut = np.array([chip.scale_ut(one.version) for one in self._states])

    def about(self) -> list[dict[str, object]]:
        """What is known of each finger: its place, its chip's variant and whether it is ready.

        serial is None because the chips have no serial number.
        """
        facts: list[dict[str, object]] = []
        for k, state in enumerate(self._states, 1):
            finger = state.finger
            facts.append(
                {
                    "finger": k,
                    "address": f"0x{finger.address:02x}",
                    "channel": finger.channel,
                    "mux": None if finger.channel is None else f"0x{finger.mux:02x}",
                    "ready": state.ready,
                    "range_mt": self._chip.range_mt(state.version).tolist(),
                    "version": state.version,
                    "serial": None,
                }
            )

        return facts

    def forget_masks(self) -> None:
        """Treat every mux as unknown, after anything went wrong on the bus."""
        self._planner.forget_masks()

    # -- bring-up

    def start(self, bus: Bus) -> None:
        """Bring up every finger that answers. Raises DeviceNotFound without any, WrongDevice."""
        failures = self.bring_up_all(bus)
        # a wrong chip is an error even where other fingers answer
        for failure in failures:
            if isinstance(failure, WrongDevice):
                raise failure

        if not any(state.ready for state in self._states):
            raise DeviceNotFound(
                "no finger answers",
                where=bus.name,
                cause="no power, SDA and SCL swapped, or another layout",
                next_step="holdfast scan lists the sensors on the bus",
            )

        for k, failure in enumerate(failures, 1):
            if failure is not None:
                self._say(f"finger {k}: {failure}")

    def bring_up_all(self, bus: Bus) -> list[DeviceError | None]:
        """Check the muxes and bring up every finger; what is wrong with each, or None."""
        self._require_muxes(bus)
        failures = []
        # again if another chip seems to answer
        for k in range(len(self._states)):
            for _ in range(TRIES_AT_START):
                failure = self._bring_up(bus, k)
                # silence does not change by asking again; a wrong answer may be noise
                if not isinstance(failure, WrongDevice):
                    break
            failures.append(failure)
        return failures

    def settle(self, bus: Bus) -> None:
        """Read until each finger has converted: the next reading can then be valid."""
        conversion = self._chip.conversion_s
        for _ in range(MOST_READS_TO_SETTLE):
            self._pause(conversion)
            self.judge(self._now_ns(), self.scan(bus))
            if all(state.settled for state in self._states):
                break

        self._pause(conversion)

    def repair(self, bus: Bus, reading: SourceReading) -> None:
        """Bring up the finger that has waited longest; only one, so the others stay on time."""
        # (when it was last tried, finger) of those that need a bring-up now
        due: list[tuple[int, int]] = []
        for k, state in enumerate(self._states):
            rested = reading.t_ns - state.tried_ns >= TRY_AGAIN_NS
            if rested and state.needs_bring_up(reading.why[k]):
                due.append((state.tried_ns, k))

        try:
            if due:
                self._bring_up(bus, min(due)[1])
        except DeviceError:
            self.forget_masks()  # the next scan meets the same failure and handles it

    def _require_muxes(self, bus: Bus) -> None:
        """See that every mux of the layout is there before it is written to.

        Raises DeviceNotFound, WrongDevice.
        """
        self.forget_masks()
        for mux in sorted(self._planner.muxes):
            # one flipped bit must not hide a mux
            if not any(is_mux(bus, mux) for _ in range(TRIES_AT_START)):
                raise _no_mux(mux, another_chip=bool(plain_read(bus, mux)))
            # the test for a mux ends with all its channels disabled
            self._planner.masks[mux] = 0

    def _bring_up(self, bus: Bus, k: int) -> DeviceError | None:
        """Make a finger ready; what is wrong with it, or None. Raises what the bridge raises."""
        state = self._states[k]
        state.begin(self._now_ns())
        try:
            self._switch_to(bus, state.finger)
            address = state.finger.address
            version = self._chip.identify(bus, address, self._pause)
            self._chip.configure(bus, address)
        except (DeviceNotFound, WrongDevice) as failure:
            return failure

        self._scale_ut[k] = self._chip.scale_ut(version)
        state.brought_up(version, self._now_ns())
        return None

    def _switch_to(self, bus: Bus, finger: Finger) -> None:
        """Enable this finger's channel only, and read the mux back. Raises DeviceNotFound."""
        self.forget_masks()
        selects = self._planner.select(finger.behind)
        read_backs = [Transfer(one.address, b"", 1) for one in selects]
        held = bus.scan([*selects, *read_backs])[len(selects) :]
        # another finger behind the wrong channel would answer in its place
        if [reply.data for reply in held] != [one.write for one in selects]:
            self.forget_masks()
            raise DeviceNotFound(
                "its mux does not switch",
                where=f"{finger.mux:#04x}",
                cause="no power, or noise on the bus",
                next_step="holdfast scan lists the muxes and sensors on the bus",
            )

    # -- scans

    def scan(self, bus: Bus) -> list[Answer]:
        """Read each finger that is ready. Raises a DeviceError where bridge or bus fails."""
        reads = [state.transfer if state.ready else None for state in self._states]
        doubtful = self._now_ns() < self._doubtful_until_ns
        plan = self._planner.plan(reads, doubtful=doubtful)
        try:
            replies = bus.scan(plan.transfers)
        except DeviceError:
            self.forget_masks()
            raise

        answers: list[Answer] = ["missing"] * len(self._states)
        switched = True
        for group in plan.groups:
            # after one failed switch the masks of all later groups are in doubt
            switched = switched and group.switched(replies)
            if not switched:
                self.forget_masks()
            for k, place in group.fingers.items():
                answers[k] = replies[place] if switched else "mux"

        return answers

    def judge(self, t_ns: int, answers: Sequence[Answer]) -> SourceReading:
        """What the replies to a scan that began at t_ns say, in uT; nan where nothing came."""
        # the time of arrival, not of the request: the machine can stall in between
        came_ns = self._now_ns()
        raw: list[tuple[float, float, float]] = []
        why: list[str] = []
        for state, answer in zip(self._states, answers, strict=True):
            if isinstance(answer, str):
                raw.append(NO_READING)
                why.append(answer)
                continue
            found, word = state.judge(answer, came_ns)
            raw.append(NO_READING if found is None else found)
            why.append(word)

        if not DOUBTS.isdisjoint(why):
            self._doubtful_until_ns = came_ns + DOUBT_NS
        valid = np.array([not word for word in why])
        values = (np.array(raw) * self._scale_ut).reshape(-1)
        return SourceReading(t_ns, values, valid, tuple(why))


def _no_mux(mux: int, *, another_chip: bool) -> DeviceError:
    next_step = "holdfast scan lists the muxes; layout=mux@71 is for a mux at 0x71"
    if another_chip:
        return WrongDevice(
            "another chip, no mux (TCA9548A)",
            where=f"{mux:#04x}",
            cause="the mux has another address",
            next_step=next_step,
        )

    return DeviceNotFound(
        "no mux answers",
        where=f"{mux:#04x}",
        cause="no power, SDA and SCL swapped, or another address (0x70 to 0x77, pins A0 to A2)",
        next_step=next_step,
    )
