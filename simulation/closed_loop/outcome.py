"""What became of a trial in a closed loop, from its physics alone: kept or lost, at what cost."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.run import TrialMotion
from holdfast.simulation.script import Times
from holdfast.simulation.truth import load_onset

HELD_AT_END_S = float("inf")


@dataclass(frozen=True)
class LoopOutcome:
    """One trial. Times in s of the trial; inf for what never happened.

    lost_s: the last contact ends. onset_s: load onset. slip_mm: travel of the contacts since load
    onset. peak_n: largest force of the other person or the box beyond the one before the action,
    while there is contact. grip_n: the grip of either side that the drive gave, over time [T] from
    begin_s on. overrode_s: the wearer overrides. mu_hat: the last friction estimate, nan where no
    slip has shown it.
    """

    trial: PlannedTrial
    lost_s: float
    onset_s: float
    slip_mm: float
    peak_n: float
    overrode_s: float
    begin_s: float
    rate_hz: float
    mu_hat: float
    grip_n: npt.NDArray[np.float32]

    @property
    def act_s(self) -> float:
        """When the action begins."""
        return Times.of(self.trial).act

    @property
    def opens_s(self) -> float:
        """When the wearer opens the hand."""
        return Times.of(self.trial).open

    @property
    def dropped(self) -> bool:
        """Contact is lost before the wearer opens the hand."""
        return self.lost_s < min(self.opens_s, HELD_AT_END_S)

    @property
    def crushed(self) -> bool:
        """The grip of either side exceeded what the object bears."""
        return 0.0 < self.trial.thing.crush_n < self.peak_grip_n

    @property
    def peak_grip_n(self) -> float:
        """The largest grip of either side."""
        return float(self.grip_n.max())


@dataclass(frozen=True)
class LaneRecord:
    """What the loop itself kept of a trial; fields as in LoopOutcome."""

    overrode_s: float
    begin_s: float
    rate_hz: float
    mu_hat: float
    grip_n: npt.NDArray[np.float32]


def outcome_of(trial: PlannedTrial, motion: TrialMotion, kept: LaneRecord) -> LoopOutcome:
    """Read the outcome of a trial off its motion."""
    act_s, at_s = Times.of(trial).act, motion.at_s
    held = np.flatnonzero(motion.gripped)
    last = int(held[-1]) if held.size else -1
    lost_s = float(at_s[last + 1]) if last + 1 < len(at_s) else HELD_AT_END_S
    onset = load_onset(motion, act_s)
    start = min(onset if onset is not None else last, max(last, 0))
    return LoopOutcome(
        trial=trial,
        lost_s=lost_s,
        onset_s=float(at_s[onset]) if onset is not None else HELD_AT_END_S,
        slip_mm=1e3 * float(motion.slip_m[max(last, 0)] - motion.slip_m[start]),
        peak_n=_peak_n(motion, act_s, last),
        **{one.name: getattr(kept, one.name) for one in fields(kept)},
    )


def _peak_n(motion: TrialMotion, act_s: float, last: int) -> float:
    first = int(np.searchsorted(motion.at_s, act_s))
    if first > last:
        return 0.0
    change = motion.agents_n[first : last + 1] - motion.agents_n[max(first - 1, 0)]
    return float(np.sqrt((change * change).sum(axis=1)).max())
