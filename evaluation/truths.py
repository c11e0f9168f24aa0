"""What the truth beside a recording says beyond its phases: how each grasp in it was done, with
what, by whom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge_runtime.contract import NOTHING, RISKY_SLIP, SAFE_SLIP
from edge_runtime.trial_layout import truth_path
from training.objects import read_json
from training.recording import Recording
from training.timeline import Phase, RiskyEvent

DISTURBANCES = {"dFn": "grip_change", "dFt": "load_n", "dq": "motor_mm"}
SAME_MOMENT_S = 0.02


@dataclass(frozen=True)
class Grasp:
    """One simulated grasp: what the truth says of it (keys as the scene writes them), empty without
    a truth."""

    told: dict[str, Any]

    @property
    def style(self) -> str:
        """Whose range of parameters, or "" where nobody says."""
        return str(self.told.get("style", ""))

    @property
    def action(self) -> str:
        """pass, pull, fall, put-down, hold, nothing, or "" where nobody says."""
        return str(self.told.get("action", ""))

    @property
    def disturbance(self) -> str | None:
        """dFn, dFt or dq, where the hold was disturbed by one of them."""
        drawn = self.told.get("drawn", {})
        return next((name for name, key in DISTURBANCES.items() if drawn.get(key)), None)


@dataclass(frozen=True)
class VoluntaryAction:
    """A voluntary hand-over or put-down, rows [first, stop): safe slips with nothing but holding
    between them."""

    first: int
    stop: int


def grasps_beside(root: Path, recordings: Sequence[Recording]) -> list[tuple[Grasp, ...]]:
    """The grasps of every recording of a folder in the thesis' layout; one empty grasp where there
    is no truth."""
    return [_grasps(truth_path(root / f"{one.trial_id}.csv")) for one in recordings]


def _grasps(path: Path) -> tuple[Grasp, ...]:
    told = read_json(path)
    return tuple(Grasp(one) for one in told.get("trials", [told]))


def style_of(grasps: tuple[Grasp, ...]) -> str:
    """The one style of a recording, or "" where there are several or none."""
    styles = {one.style for one in grasps}
    return styles.pop() if len(styles) == 1 else ""


def grasp_of(event: RiskyEvent, grasps: tuple[Grasp, ...]) -> Grasp | None:
    """The grasp that ended in this event: the one whose contact was lost as the event ended."""
    for one in grasps:
        lost_s = one.told.get("contact_lost_s")
        if lost_s is not None and abs(float(lost_s) - event.end_s) < SAME_MOMENT_S:
            return one
    return None


def safe_acts(recording: Recording) -> list[VoluntaryAction]:
    """The voluntary acts of a recording, in order: none that belongs to a grip that fails, nor the
    end of a hold."""
    if recording.action == "hold":
        return []
    spans = [
        (event.onset_s * recording.rate_hz, event.end_s * recording.rate_hz)
        for event in recording.events
    ]
    acts = acts_of(recording.phases)
    return [
        act
        for act in acts
        if not any(first < act.stop - 1 and act.first < stop - 1 for first, stop in spans)
    ]


def acts_of(phases: Sequence[Phase]) -> list[VoluntaryAction]:
    """Safe slips, those with nothing but holding between them as one.

    >>> acts_of([Phase(0, 5, 1), Phase(5, 8, 2), Phase(8, 10, 1), Phase(10, 12, 2), Phase(12, 20, 0)])
    [VoluntaryAction(first=5, stop=12)]
    """
    acts: list[VoluntaryAction] = []
    going_on = False
    for phase in phases:
        if phase.situation == SAFE_SLIP and going_on:
            acts[-1] = VoluntaryAction(acts[-1].first, phase.stop)
        elif phase.situation == SAFE_SLIP:
            acts.append(VoluntaryAction(phase.first, phase.stop))
            going_on = True
        elif phase.situation in (NOTHING, RISKY_SLIP):
            going_on = False
    return acts
