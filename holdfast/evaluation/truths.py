"""What the truth beside a recording says of each grasp: style, action, object, disturbance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from holdfast.core.contract import NOTHING, RISKY_SLIP, SAFE_SLIP
from holdfast.core.reading import Json
from holdfast.core.trial_layout import read_json, truth_path
from holdfast.training.recording import Recording
from holdfast.training.timeline import Phase, RiskyEvent

DISTURBANCES = {"dFn": "grip_change", "dFt": "load_n", "dq": "motor_mm"}
SAME_MOMENT_S = 0.02


@dataclass(frozen=True)
class Grasp:
    """One simulated grasp. truth: its JSON as the scene writes it, empty without a truth."""

    truth: Json

    @property
    def style(self) -> str:
        """The range of parameters of the person who acts, or ""."""
        return str(self.truth.get("style", ""))

    @property
    def action(self) -> str:
        """pass, pull, fall, put-down, hold, nothing, or ""."""
        return str(self.truth.get("action", ""))

    @property
    def disturbance(self) -> str | None:
        """dFn (grip), dFt (load) or dq (motor), where one of them disturbed the hold."""
        drawn = self.truth.get("drawn", {})
        return next(
            (name for name, key in DISTURBANCES.items() if drawn.get(key)), None
        )


@dataclass(frozen=True)
class VoluntaryAction:
    """A voluntary hand-over or put-down, rows [first, stop).

    Its safe slips have nothing but holding between them.
    """

    first: int
    stop: int


def grasps_beside(
    root: Path, recordings: Sequence[Recording]
) -> list[tuple[Grasp, ...]]:
    """The grasps of every recording of a folder; one empty grasp where there is no truth."""
    return [_grasps(truth_path(root / f"{one.trial_id}.csv")) for one in recordings]


def _grasps(path: Path) -> tuple[Grasp, ...]:
    truth = read_json(path)
    return tuple(Grasp(one) for one in truth.get("trials", [truth]))


def style_of(grasps: tuple[Grasp, ...]) -> str:
    """The one style of a recording, or "" where there are several or none."""
    styles = {one.style for one in grasps}
    return styles.pop() if len(styles) == 1 else ""


def grasp_of(event: RiskyEvent, grasps: tuple[Grasp, ...]) -> Grasp | None:
    """The grasp whose contact was lost as this event ended."""
    for one in grasps:
        lost_s = one.truth.get("contact_lost_s")
        if lost_s is not None and abs(float(lost_s) - event.end_s) < SAME_MOMENT_S:
            return one
    return None


def voluntary_actions(recording: Recording) -> list[VoluntaryAction]:
    """The voluntary actions of a recording, in order.

    Actions within a grip that fails, and the end of a hold, are none.
    """
    if recording.action == "hold":
        return []
    spans = [
        (event.onset_s * recording.rate_hz, event.end_s * recording.rate_hz)
        for event in recording.events
    ]
    return [
        one
        for one in actions_of(recording.phases)
        if not any(
            first < one.stop - 1 and one.first < stop - 1 for first, stop in spans
        )
    ]


def actions_of(phases: Sequence[Phase]) -> list[VoluntaryAction]:
    """Safe slips, those with nothing but holding between them as one.

    >>> actions_of([Phase(0, 5, 1), Phase(5, 8, 2), Phase(8, 10, 1), Phase(10, 12, 2)])
    [VoluntaryAction(first=5, stop=12)]
    """
    actions: list[VoluntaryAction] = []
    continues = False
    for phase in phases:
        if phase.situation == SAFE_SLIP and continues:
            actions[-1] = VoluntaryAction(actions[-1].first, phase.stop)
        elif phase.situation == SAFE_SLIP:
            actions.append(VoluntaryAction(phase.first, phase.stop))
            continues = True
        elif phase.situation in (NOTHING, RISKY_SLIP):
            continues = False
    return actions
