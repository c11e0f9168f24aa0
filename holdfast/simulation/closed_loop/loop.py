"""B trials in a closed loop: physics, sensors, the model file, controller, drive, once a sample.

    forces at a sample -> sensors -> bias, graph -> controller and supervisor -> target of the drive
    -> physics until the next sample

The target of a sample acts from that sample on; delay_samples more are the cost of a slower
computer or bus. The loop of a trial begins a little before the hand closes, so that the model has
settled, and ends a while after the action.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.trial_layout import RISKY_ACTIONS
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.grip import GripSense
from holdfast.simulation.closed_loop.answers import HandModels
from holdfast.simulation.closed_loop.drive import Actuator, Drive
from holdfast.simulation.closed_loop.people import (
    Habits,
    LaneRecord,
    LoopOutcome,
    Wearer,
    outcome_of,
)
from holdfast.simulation.closed_loop.physics import HandsAndObjects, Spans
from holdfast.simulation.closed_loop.sensing import LoopSensors
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.run import Done
from holdfast.simulation.scene import Scene
from holdfast.simulation.script import SETTLE_S, Times, grid_of

ROWS_TO_SPARE = 5
LANES = 500
"""Trials in a loop together: fewer waste time on calls, more on memory."""
FALL_S = 1.0
"""A fall is watched at least this long: in it the object is gone, or at rest."""


class LoopController(Protocol):
    """Decides for B hands. mu_hat [B]: the last friction estimates, nan where there is none."""

    mu_hat: FloatArray

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] target, N a side; 0 for none."""
        ...


@dataclass(frozen=True)
class LoopTruth:
    """What only a simulation knows at a sample: t_s [B], and the grip of the drive, grip_n [B]."""

    t_s: FloatArray
    grip_n: FloatArray


Make = Callable[[Sequence[PlannedTrial], float], LoopController]
"""Makes the controller of a batch: (trials, rate in Hz)."""


@dataclass(frozen=True)
class LoopSettings:
    """The hand's drive, the people, and how many samples later than they could targets act.

    whole_trials: go on to the end of every trial, for a recording; else until nothing more happens.
    """

    drive: Drive = field(default_factory=Drive)
    habits: Habits = field(default_factory=Habits)
    delay_samples: int = 0
    whole_trials: bool = False


def run_loops(
    scene: Scene,
    trials: Sequence[PlannedTrial],
    model: OpenedModel,
    make: Make,
    settings: LoopSettings | None = None,
    done: Done = lambda trials: None,
) -> list[LoopOutcome]:
    """Outcomes of trials in their order."""
    outcomes: dict[int, LoopOutcome] = {}
    for batch in batches(trials):
        outcomes |= run_batch(scene, trials, batch, model, make, settings)
        done(len(outcomes))
    return [outcomes[k] for k in range(len(trials))]


def batches(trials: Sequence[PlannedTrial]) -> list[list[int]]:
    """Places of the trials that run together: those of similar length, LANES at most."""
    order = sorted(range(len(trials)), key=lambda k: _length_s(trials[k]))
    size = max(1, -(-len(order) // max(1, -(-len(order) // LANES))))
    return [order[start : start + size] for start in range(0, len(order), size)]


def run_batch(
    scene: Scene,
    trials: Sequence[PlannedTrial],
    batch: Sequence[int],
    model: OpenedModel,
    make: Make,
    settings: LoopSettings | None = None,
) -> dict[int, LoopOutcome]:
    """Outcomes of one batch, by their places among the trials."""
    lanes = (
        batch if len(batch) > 1 else [*batch, *batch]
    )  # numpy sums a single lane otherwise
    loop = ClosedLoop(scene, [trials[k] for k in lanes], model, make, settings)
    return dict(zip(lanes, loop.run(), strict=True))


def _length_s(trial: PlannedTrial) -> float:
    return loop_end_s(trial, Habits()) - Times.of(trial).close


def loop_end_s(trial: PlannedTrial, habits: Habits) -> float:
    """When nothing more is decided: the person has given up, or the hand is open."""
    times = Times.of(trial)
    if trial.action == "pull":
        return times.act + habits.pull_gives_up_s + habits.lets_go_s + SETTLE_S
    if trial.action == "fall":
        return times.act + max(trial.drawn["watch_s"], FALL_S)
    return times.open + trial.drawn["opening_s"] + SETTLE_S


class ClosedLoop:
    """One batch of two trials or more with an object, ready to run."""

    def __init__(
        self,
        scene: Scene,
        trials: Sequence[PlannedTrial],
        model: OpenedModel,
        make: Make,
        settings: LoopSettings | None = None,
    ) -> None:
        self.settings = settings or LoopSettings()
        self.trials, self.rate_hz = trials, scene.card.rate_hz
        card, habits = model.card, self.settings.habits
        before = card.settle_samples + card.preparation.bias_rows + ROWS_TO_SPARE
        self.spans = _spans(scene, trials, before, self.settings)
        self.actuator = Actuator(self.settings.drive, trials)
        self.world = HandsAndObjects(
            trials, scene.step_settings_of(trials), self.spans, self.actuator, habits
        )
        self.sensors = LoopSensors(scene, trials, self.spans.counts)
        self.models = HandModels(model, self.spans.ends - self.spans.begins)
        self.wearer = Wearer(trials, habits, scene.seed)
        self.controller = make(trials, self.rate_hz)
        self._late = [self.actuator.own_n.copy()] * self.settings.delay_samples
        self._agents_n = self.world.state.agents_n.copy()

    def run(self) -> list[LoopOutcome]:
        """Run to the end."""
        periods = self.spans.periods
        grip_n = np.zeros((periods, len(self.trials)), dtype=np.float32)
        for period in range(periods):
            target_n = self.decide(period)
            grip_n[period] = self.actuator.grip_n
            self.world.advance(period, target_n)
        return [
            self._outcome(lane, grip_n[:, lane]) for lane in range(len(self.trials))
        ]

    def decide(self, period: int) -> FloatArray:
        """[B] targets of the drives at a sample: never less than the wearer's own grip."""
        rows = np.minimum(self.spans.begins + period, self.spans.counts - 1)
        readings, lost = self.sensors.read(rows, self.world.forces_n)
        lanes = len(self.trials)
        valid = readings.valid & ~lost[:, None]
        sense = self.models.answer(readings.values.reshape(lanes, -1), valid)
        now = LoopTruth(rows / self.rate_hz, self.actuator.grip_n)
        sense = replace(
            sense,
            opening=self.wearer.opening(now.t_s),
            overridden=self._overridden(now),
        )
        wanted_n = self.controller.step(sense, now)
        self._late.append(np.maximum(wanted_n, self.actuator.own_n))
        return self._late.pop(0)

    def _overridden(self, now: LoopTruth) -> BoolArray:
        """[B] whether the wearer's override lasts; it lasts until the end of the trial."""
        agents_n = self.world.state.agents_n
        self._agents_n = np.where(now.t_s < self.wearer.act_s, agents_n, self._agents_n)
        change_n = agents_n - self._agents_n
        pulled_n = np.sqrt((change_n * change_n).sum(axis=0))
        extra_n = now.grip_n - self.actuator.own_n
        self.wearer.resist(now.t_s, extra_n, pulled_n, 1.0 / self.rate_hz)
        overridden: BoolArray = now.t_s >= self.wearer.overrode_s
        return overridden

    def _outcome(self, lane: int, grip_n: npt.NDArray[np.float32]) -> LoopOutcome:
        motion = self.world.motion(lane, np.zeros((2, 1, 3)), np.zeros((2, 3)))
        moves = int(self.spans.ends[lane] - self.spans.begins[lane])
        kept = LaneRecord(
            overrode_s=float(self.wearer.overrode_s[lane]),
            begin_s=float(self.spans.begins[lane]) / self.rate_hz,
            rate_hz=self.rate_hz,
            mu_hat=float(self.controller.mu_hat[lane]),
            grip_n=grip_n[:moves],
        )
        return outcome_of(self.trials[lane], motion, kept)


def _spans(
    scene: Scene, trials: Sequence[PlannedTrial], before: int, settings: LoopSettings
) -> Spans:
    """A pull or a fall goes on until its outcome is known, be it after the end of the trial."""
    rate_hz = scene.card.rate_hz
    grids = [grid_of(trial, rate_hz, scene.card.step_s) for trial in trials]
    moves = np.array([round(grid.start_s * rate_hz) for grid in grids])
    last = [
        int(np.ceil(loop_end_s(trial, settings.habits) * rate_hz)) for trial in trials
    ]
    whole = np.array([int(grid.sample[-1]) for grid in grids])
    risky = [trial.action in RISKY_ACTIONS for trial in trials]
    ends = np.where(risky, last, np.minimum(last, whole))
    ends = np.maximum(ends, whole) if settings.whole_trials else ends
    counts = np.maximum([grid.n_samples for grid in grids], ends + 1)
    return Spans(np.maximum(moves - before, 0), moves, ends, counts)
