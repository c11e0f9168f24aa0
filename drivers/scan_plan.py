"""Which I2C transfers one scan of a hand needs, and what their replies say about the muxes.

Fingers behind the same mux channels form a group: the channels are enabled once, then the fingers
are read. The planner remembers the mask that each mux holds, so that it switches only where needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from holdfast.drivers.bus import Reply, Transfer
from holdfast.drivers.finger_state import FingerState
from holdfast.drivers.layout import Channel, Finger, masks_of, muxes_of, read_behind
from holdfast.drivers.mux import enable_channels


@dataclass
class Group:
    """Fingers read behind the same channels. A place is an index into a scan's transfers.

    fingers: finger index -> place of its read. selects: places of the mux writes. masks: the mask
    of every mux during this group. read_backs: place of a mux read -> mask that it must return.
    """

    fingers: dict[int, int]
    selects: list[int]
    masks: dict[int, int]
    read_backs: dict[int, int]

    def switched(self, replies: Sequence[Reply]) -> bool:
        """Whether every mux write was acknowledged and every mux that was read held its mask."""
        held = all(replies[place].data == bytes([mask]) for place, mask in self.read_backs.items())
        return held and all(replies[place].acked for place in self.selects)


@dataclass(frozen=True)
class ScanPlan:
    """The transfers of one scan, their groups, and the masks that the muxes hold afterwards."""

    transfers: list[Transfer]
    groups: list[Group]
    masks: dict[int, int]


class ScanPlanner:
    """Plans the scans of a hand.

    masks: what each mux holds; a mux without an entry is unknown and will be written. muxes: the
    addresses of all muxes.
    """

    def __init__(self, fingers: Sequence[Finger]) -> None:
        self.muxes = muxes_of(fingers)
        self.masks: dict[int, int] = {}
        self._behind = [read_behind(fingers, finger) for finger in fingers]
        self._all_channels = frozenset[Channel]().union(*(finger.behind for finger in fingers))
        self._plans: dict[object, ScanPlan] = {}

    def forget_masks(self) -> None:
        """Treat every mux as unknown: the next scan writes all masks again."""
        self.masks = {}

    def forget_plans(self) -> None:
        """Drop all plans, because a finger is read by another transfer from now on."""
        self._plans.clear()

    def plan(self, states: Sequence[FingerState], *, doubtful: bool) -> ScanPlan:
        """The plan for the fingers that are ready; plans are cached.

        doubtful: the bus flipped bits lately, so each group ends with a read of its muxes.
        """
        key = (doubtful, tuple(self.masks.items()), tuple([state.ready for state in states]))
        if key not in self._plans:
            self._plans[key] = self._new_plan(states, doubtful)
        plan = self._plans[key]
        self.masks = {**plan.masks}
        return plan

    def select(self, channels: frozenset[Channel]) -> list[Transfer]:
        """Mux writes that enable these channels and disable the others; none where that holds."""
        wanted = masks_of(channels, self.muxes) if channels else {}
        writes = [
            enable_channels(mux, mask)
            for mux, mask in wanted.items()
            if self.masks.get(mux) != mask
        ]
        self.masks = self.masks | wanted
        return writes

    def select_all(self) -> list[Transfer]:
        """Mux writes that enable the channels of all fingers at once."""
        return self.select(self._all_channels)

    def _new_plan(self, states: Sequence[FingerState], doubtful: bool) -> ScanPlan:
        transfers: list[Transfer] = []
        groups: list[Group] = []
        for k, state in enumerate(states):
            if not state.ready:
                continue
            selects = self.select(self._behind[k])
            if selects or not groups:
                _read_back(transfers, groups, doubtful)
                places = range(len(transfers), len(transfers) + len(selects))
                groups.append(Group({}, [*places], {**self.masks}, {}))
                transfers += selects
            groups[-1].fingers[k] = len(transfers)
            transfers.append(state.transfer)
        _read_back(transfers, groups, doubtful)
        return ScanPlan(transfers, groups, {**self.masks})


def _read_back(transfers: list[Transfer], groups: list[Group], doubtful: bool) -> None:
    """Where the bus is in doubt, end the last group with a read of every mux."""
    for mux, mask in groups[-1].masks.items() if doubtful and groups else ():
        groups[-1].read_backs[len(transfers)] = mask
        transfers.append(Transfer(mux, b"", 1))
