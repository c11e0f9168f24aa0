"""What a grip controller is worth on a set: drops saved, hand-overs blocked, and what it costs.

Each trial is run three times: in a hand that does nothing (bare), by the oracle, and by the
controller. A drop is preventable where the bare hand loses the object in a pull or a fall and the
oracle keeps it. A hand-over is blocked where the receiver needs over 5 N more than from the bare
hand, gets the object over 0.3 s later, or needs an override. All figures are simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from holdfast.core.reading import Json
from holdfast.core.trial_layout import RISKY_ACTIONS
from holdfast.evaluation.statistics import share
from holdfast.simulation.closed_loop import needed_grip_n
from holdfast.simulation.loop_people import LoopOutcome
from holdfast.training.figures import Interval

BLOCKED_N = 5.0
BLOCKED_S = 0.3
TIGHTER_N = 1.0
"""A hand that grips by so much more than its wearer's own grip is tightened."""


@dataclass(frozen=True)
class ThreeRuns:
    """One trial in three hands."""

    bare: LoopOutcome
    oracle: LoopOutcome
    held: LoopOutcome

    @property
    def preventable(self) -> bool:
        """The bare hand drops it in the action, the oracle does not."""
        risky = self.bare.trial.action in RISKY_ACTIONS
        in_action = self.bare.lost_s >= self.bare.act_s
        return risky and self.bare.dropped and in_action and not self.oracle.dropped

    @property
    def blocked(self) -> bool:
        """The hand-over needs more force, more time or an override."""
        return (
            self.extra_n > BLOCKED_N
            or self.extra_s > BLOCKED_S
            or bool(np.isfinite(self.held.overrode_s))
        )

    @property
    def extra_n(self) -> float:
        """Force of the other person beyond what the bare hand asks for, N."""
        return self.held.peak_n - self.bare.peak_n

    @property
    def extra_s(self) -> float:
        """Time until the object has left, beyond that of the bare hand, s."""
        return self.held.lost_s - self.bare.lost_s

    @property
    def excess_n_s(self) -> float:
        """Integral over time of the grip beyond what is needed, N s."""
        one = self.held
        t_s = one.begin_s + np.arange(len(one.grip_n)) / one.rate_hz
        risky = one.trial.action in RISKY_ACTIONS
        needed_n = needed_grip_n(one.trial) if risky else 0.0
        least_n = np.where(
            t_s >= one.onset_s, max(needed_n, one.trial.grip_n), one.trial.grip_n
        )
        beyond_n = np.maximum(one.grip_n - least_n, 0.0)[t_s < one.lost_s]
        return float(beyond_n.sum() / one.rate_hz)

    @property
    def friction_error(self) -> float:
        """Relative error of the friction estimate against the kinetic friction; nan without one."""
        return abs(self.held.mu_hat / max(self.held.trial.kinetic_friction, 1e-9) - 1.0)


@dataclass(frozen=True)
class LoopFigures:
    """One controller on one set; shares from 0 to 1, `_ci` their exact 95 % intervals.

    saved: of the preventable drops. slip_mm_p50: travel of what was saved. put_downs: disturbed as
    a hand-over is blocked. grip_excess: N s a trial beyond what is needed. tightenings_per_min:
    before any action, and in disturbed holds. mu_error_p50: where a slip has shown friction.
    """

    trials: int
    drops: int
    preventable: int
    saved: int
    saved_share: float | None
    saved_share_ci: Interval | None
    slip_mm_p50: float | None
    handovers: int
    blocked: int
    blocked_share: float | None
    blocked_share_ci: Interval | None
    extra_force_n_p50: float | None
    extra_delay_ms_p50: float | None
    extra_delay_ms_p95: float | None
    put_downs: int
    disturbed_share: float | None
    disturbed_share_ci: Interval | None
    fragile: int
    crushed_share: float | None
    crushed_share_ci: Interval | None
    grip_excess: float
    tightenings_per_min: float | None
    new_drops: int
    mu_observed: int
    mu_error_p50: float | None

    def to_json(self) -> Json:
        """As a JSON object."""
        return asdict(self)


def loop_figures(runs: Sequence[ThreeRuns]) -> LoopFigures:
    """The figures of one controller on one set."""
    preventable = [one for one in runs if one.preventable]
    kept = [one for one in preventable if not one.held.dropped]
    passes = [
        one for one in runs if one.bare.trial.action == "pass" and _completes(one)
    ]
    downs = [
        one for one in runs if one.bare.trial.action == "put-down" and _completes(one)
    ]
    fragile = [one for one in runs if one.bare.trial.object.crush_n > 0.0]
    saved, blocked = (
        share([not one.held.dropped for one in preventable]),
        _blocked(passes),
    )
    disturbed, crushed = _blocked(downs), share([one.held.crushed for one in fragile])
    errors = [e for one in preventable if np.isfinite(e := one.friction_error)]
    return LoopFigures(
        trials=len(runs),
        drops=sum(one.bare.dropped for one in runs),
        preventable=len(preventable),
        saved=len(kept),
        saved_share=saved.share,
        saved_share_ci=saved.share_ci,
        slip_mm_p50=_percentile([one.held.slip_mm for one in kept], 50),
        handovers=len(passes),
        blocked=sum(one.blocked for one in passes),
        blocked_share=blocked.share,
        blocked_share_ci=blocked.share_ci,
        extra_force_n_p50=_percentile([one.extra_n for one in passes], 50),
        extra_delay_ms_p50=_percentile([1e3 * one.extra_s for one in passes], 50),
        extra_delay_ms_p95=_percentile([1e3 * one.extra_s for one in passes], 95),
        put_downs=len(downs),
        disturbed_share=disturbed.share,
        disturbed_share_ci=disturbed.share_ci,
        fragile=len(fragile),
        crushed_share=crushed.share,
        crushed_share_ci=crushed.share_ci,
        grip_excess=float(np.mean([one.excess_n_s for one in runs])) if runs else 0.0,
        tightenings_per_min=_tightenings_per_min(runs),
        new_drops=sum(one.held.dropped and not one.bare.dropped for one in runs),
        mu_observed=len(errors),
        mu_error_p50=_percentile(errors, 50),
    )


def _completes(one: ThreeRuns) -> bool:
    """The bare hand hands the object over, after the action began."""
    return one.bare.act_s <= one.bare.lost_s < np.inf


def _blocked(runs: Sequence[ThreeRuns]) -> Any:
    return share([one.blocked for one in runs])


def _percentile(values: Sequence[float], percent: float) -> float | None:
    finite = [value if np.isfinite(value) else 1e6 for value in values]
    return float(np.percentile(finite, percent)) if finite else None


def _tightenings_per_min(runs: Sequence[ThreeRuns]) -> float | None:
    """How often the grip rises by TIGHTER_N before any action, or in a disturbed hold."""
    count, seconds = 0, 0.0
    for one in (run.held for run in runs):
        until_s = one.opens_s if one.trial.action == "hold" else one.act_s
        t_s = one.begin_s + np.arange(len(one.grip_n)) / one.rate_hz
        tight = (one.grip_n > one.trial.grip_n + TIGHTER_N)[
            t_s < min(until_s, one.lost_s)
        ]
        count += int((tight[1:] & ~tight[:-1]).sum())
        seconds += len(tight) / one.rate_hz
    return 60.0 * count / seconds if seconds else None
