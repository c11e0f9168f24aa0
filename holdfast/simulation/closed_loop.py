"""B trials in a closed loop: physics, sensors, the model file, controller, drive, once a sample.

    forces at a sample -> sensors -> bias, graph -> controller and supervisor -> target of the drive
    -> physics until the next sample

The target of a sample acts from that sample on; delay_samples more are the cost of a slower
computer or bus. The loop of a trial begins a little before the hand closes, so that the model has
settled, and ends a while after the action.

A grip controller decides (managed), or what a study puts in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.edge_runtime.batch import Batch, ManyHands
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.edge_runtime.grip import AnswerRules, Controller, GripSense, Holdfast
from holdfast.edge_runtime.grip_control import GripLoop
from holdfast.edge_runtime.supervisor import Limits
from holdfast.simulation.drive import Actuator, Drive, Opening
from holdfast.simulation.loop_people import Habits, LoopOutcome, Wearer, outcome_of
from holdfast.simulation.loop_physics import HandsAndObjects, loop_end_s, spans_of
from holdfast.simulation.loop_sensing import Between, HandModels, LoopSensors
from holdfast.simulation.magnet import shear_gain_in
from holdfast.simulation.protocol import Trials
from holdfast.simulation.scene import Scene
from holdfast.simulation.script_times import Times

ROWS_TO_SPARE = 5
"""Rows by which the loop begins earlier than bias and model need."""
MOST_TOGETHER = 500
"""Trials in a loop together: fewer waste time on calls, more on memory."""


@lru_cache(maxsize=2)
def model_of(choice: ModelChoice) -> OpenedModel:
    """A model file, opened once a process. Raises a ModelError, or UsageError."""
    return choice.open()


@dataclass(frozen=True)
class LoopTruth:
    """What only a simulation knows at a sample: t_s [B], and the grip of the drive, grip_n [B]."""

    t_s: FloatArray
    grip_n: FloatArray


class LoopController(Protocol):
    """Decides for B hands. mu_hat [B]: the last friction estimates, nan where there is none."""

    mu_hat: FloatArray

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] target, N a side; 0 for none."""
        ...


Make = Callable[[Trials, float], LoopController]
"""Makes the controller of a batch: (trials, rate in Hz)."""


@dataclass(frozen=True)
class LoopSettings:
    """What a loop adds to its scene.

    drive          of the hand
    opening        who decides when the wearer opens the hand, of OPENINGS
    habits         of the people
    delay_samples  by so many samples later than they could do targets act
    between        what changes the readings before the model gets them; None: nothing does
    """

    drive: Drive = field(default_factory=Drive)
    opening: Opening = "wearer"
    habits: Habits = field(default_factory=Habits)
    delay_samples: int = 0
    between: Between | None = None


USUAL = LoopSettings()


def run_loops(
    scene: Scene,
    trials: Trials,
    model: OpenedModel,
    make: Make,
    settings: LoopSettings = USUAL,
) -> list[LoopOutcome]:
    """Outcomes of trials in their order."""
    outcomes: dict[int, LoopOutcome] = {}
    for batch in batches(trials):
        outcomes |= run_batch(scene, trials, batch, model, make, settings)
    return [outcomes[k] for k in range(len(trials))]


def batches(trials: Trials) -> list[list[int]]:
    """Places of the trials that run together: those of similar length, MOST_TOGETHER at most."""
    habits = Habits()
    lasts_s = [loop_end_s(trial, habits) - Times.of(trial).close for trial in trials]

    # A batch steps on until its longest trial has ended, so similar lengths waste least.
    order = sorted(range(len(trials)), key=lasts_s.__getitem__)

    # As few batches as can be, of equal size; -(-a // b) rounds up.
    count = max(1, -(-len(order) // MOST_TOGETHER))
    return [part.tolist() for part in np.array_split(order, count) if part.size]


def run_batch(
    scene: Scene,
    trials: Trials,
    batch: Sequence[int],
    model: OpenedModel,
    make: Make,
    settings: LoopSettings = USUAL,
) -> dict[int, LoopOutcome]:
    """Outcomes of one batch, by their places among the trials."""
    # A single trial runs twice, because numpy sums one in another order than many.
    places = batch if len(batch) > 1 else [*batch, *batch]
    loop = ClosedLoop(scene, [trials[k] for k in places], model, make, settings)
    return dict(zip(places, loop.run(), strict=True))


class ClosedLoop:
    """One batch of two trials or more with an object, ready to run.

    spans       samples at which each trial begins and ends
    actuator    the drives of the hands
    world       the physics
    sensors     from forces to readings
    models      from readings to answers
    wearer      signals to open, and overrides
    controller  from answers to targets
    """

    def __init__(
        self,
        scene: Scene,
        trials: Trials,
        model: OpenedModel,
        make: Make,
        settings: LoopSettings = USUAL,
    ) -> None:
        self.trials = trials
        self.rate_hz = scene.file.rate_hz
        preparation = model.card.preparation
        habits = settings.habits

        # When the hand begins to close, the bias must be known and the filters of the model
        # settled.
        before = model.card.settle_samples + preparation.bias_rows + ROWS_TO_SPARE
        self.spans = spans_of(scene, trials, before, habits)

        self.actuator = Actuator(settings.drive, trials, settings.opening)
        steps = scene.step_settings_of(trials)
        self.world = HandsAndObjects(trials, steps, self.spans, self.actuator, habits)

        self.sensors: Any = LoopSensors(scene, trials, self.spans.counts)
        if settings.between is not None:
            self.sensors = settings.between(self.sensors, trials, self.spans.counts)
        self.models = HandModels(model, len(trials))
        self.evidence_p = AnswerRules.of(model.card.decision).from_p

        self.wearer = Wearer(trials, habits, scene.seed)
        self.controller = make(trials, self.rate_hz)

        # Commands on their way: at first none.
        self._late = [np.zeros(len(trials))] * settings.delay_samples
        self._agents_n = self.world.all.state.agents_n.copy()
        self._p_risky = np.zeros(len(trials))
        # What outcomes have of every sample, in single precision to save memory.
        self._noted = np.zeros((4, self.spans.periods, len(trials)), np.float32)

    def run(self) -> list[LoopOutcome]:
        """Run to the end."""
        for period in range(self.spans.periods):
            target_n = self.decide(period)
            self.note(period, target_n)
            self.world.advance(period, target_n)
        return [self.outcome(k) for k in range(len(self.trials))]

    def note(self, period: int, target_n: FloatArray) -> None:
        """Write down one sample period, before the world goes on."""
        drive = self.actuator
        levels = (drive.grip_n, drive.wearers_n, target_n, self._p_risky)
        self._noted[:, period] = levels

    def decide(self, period: int) -> FloatArray:
        """[B] targets of the drives at a sample, 0 for none."""
        # A trial that has ended repeats its last sample.
        rows = np.minimum(self.spans.begins + period, self.spans.counts - 1)
        readings = self.sensors.read(rows, self.world.forces_n)
        values = readings.values.reshape(len(self.trials), -1)

        # Only the wearer, and a baseline of a study, use the truth.
        now = LoopTruth(rows / self.rate_hz, self.actuator.grip_n)
        opening = now.t_s >= self.wearer.signal_s
        overridden = self._overridden(now)
        sense = self.models.answer(values, readings.valid, opening, overridden)
        self._p_risky = np.where(sense.known, sense.p_risky, 0.0)
        # A queue: what is decided now acts delay_samples later.
        self._late.append(self.controller.step(sense, now))
        return self._late.pop(0)

    def _overridden(self, now: LoopTruth) -> BoolArray:
        """[B] whether the wearer's override lasts; it lasts until the end of the trial."""
        agents_n = self.world.all.state.agents_n
        # Force on the object before the action, which resistance is measured against.
        before = now.t_s < self.wearer.act_s
        self._agents_n = np.where(before, agents_n, self._agents_n)
        change_n = agents_n - self._agents_n
        pulled_n = np.sqrt((change_n * change_n).sum(axis=0))

        # Only the grip beyond that of the wearer counts as resistance of the hand.
        own_n = self.actuator.wearers_n
        extra_n = now.grip_n - own_n
        self.wearer.resist(now.t_s, own_n, extra_n, pulled_n, 1.0 / self.rate_hz)
        return now.t_s >= self.wearer.overrode_s

    def outcome(self, k: int) -> LoopOutcome:
        """What became of trial k."""
        begin = int(self.spans.begins[k])
        end = int(self.spans.ends[k])
        names = ("grip_n", "own_n", "target_n", "p_risky")
        levels = dict(zip(names, self._noted[:, : end - begin, k], strict=True))
        return outcome_of(
            self.trials[k],
            self.world.motion(k),
            **levels,
            overrode_s=float(self.wearer.overrode_s[k]),
            begin_s=begin / self.rate_hz,
            rate_hz=self.rate_hz,
            mu_hat=float(self.controller.mu_hat[k]),
            gives_up_s=float(self.world.script.gives_up_s[k]),
            evidence_p=self.evidence_p,
        )


class Managed:
    """A grip controller behind margin and supervisor, for B hands."""

    def __init__(self, grip: GripLoop, batch: int) -> None:
        self.grip = grip
        self.target_n = np.zeros(batch)
        self.mu_hat = np.full(batch, np.nan)

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] target, N a side; 0 for none."""
        self.target_n = self.grip.step(sense)
        observed = self.grip.margin.mu_hat
        # The last estimate stays.
        self.mu_hat = np.where(observed > 0.0, observed, self.mu_hat)
        return self.target_n


def managed(
    scene: Scene,
    kind: type[Controller] = Holdfast,
    setting: float | None = None,
    rules: AnswerRules | None = None,
    limits: Limits | None = None,
) -> Callable[[Trials, float], Managed]:
    """A maker of a controller; setting, rules: None for the usual."""
    gain = shear_gain_in(scene.file.effects)

    def make(trials: Trials, rate_hz: float) -> Managed:
        batch: Batch = ManyHands(len(trials))
        controller = kind(batch, rate_hz, setting, rules)
        grip = GripLoop(batch, rate_hz, controller, limits, gain)
        return Managed(grip, len(trials))

    return make
