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
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, IntArray
from holdfast.edge_runtime.batch import Batch, ManyHands
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.edge_runtime.grip import AnswerRules, Controller, GripSense, Holdfast
from holdfast.edge_runtime.grip_control import GripLoop
from holdfast.edge_runtime.supervisor import Limits
from holdfast.simulation.effects.magnet import shear_gain_in
from holdfast.simulation.loop.drive import Actuator, Drive, Opening
from holdfast.simulation.loop.people import Habits, LoopOutcome, Wearer, outcome_of
from holdfast.simulation.loop.physics import HandsAndObjects, loop_end_s, spans_of
from holdfast.simulation.loop.sensing import Between, HandModels, LoopSensors
from holdfast.simulation.physics.solver import two_at_least
from holdfast.simulation.scenes.protocol import Trials
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.script_times import Times
from holdfast.simulation.scenes.stepper import WORTH_LEAVING, TrialMotion, some_trials

SENSES = GripSense.__struct_fields__
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


def batches(trials: Trials, lanes: int = 1) -> list[list[int]]:
    """Places of the trials that run together: those of similar length.

    MOST_TOGETHER at most, each counted as often as it has lanes.
    """
    habits = Habits()
    lasts_s = [loop_end_s(trial, habits) - Times.of(trial).close for trial in trials]

    # A batch steps on until its longest trial has ended, so similar lengths waste least.
    order = sorted(range(len(trials)), key=lasts_s.__getitem__)

    # As few batches as can be, of equal size; -(-a // b) rounds up.
    count = max(1, -(-len(order) * lanes // MOST_TOGETHER))
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
    (outcomes,) = run_together(scene, trials, [(batch, make)], model, settings)
    return outcomes


def run_together(
    scene: Scene,
    trials: Trials,
    wanted: Sequence[tuple[Sequence[int], Make]],
    model: OpenedModel,
    settings: LoopSettings = USUAL,
) -> list[dict[int, LoopOutcome]]:
    """Outcomes of some trials with each of several controllers, by their places among the trials.

    A trial that several controllers have runs as one hand for as long as they say the same.
    """
    # A single trial runs twice, because numpy sums one in another order than many.
    if sum(len(places) for places, _ in wanted) == 1:
        wanted = [([*places, *places], make) for places, make in wanted]

    lanes = [trials[k] for places, _ in wanted for k in places]
    stops = np.cumsum([len(places) for places, _ in wanted]).tolist()
    make = _side_by_side([make for _, make in wanted], stops)
    # What a study puts between sensors and model cannot be copied, nor can a compiled model.
    branches = settings.between is None and HandModels(model, 1).can_branch
    kind = BranchingLoop if branches else ClosedLoop
    outcomes = kind(scene, lanes, model, make, settings).run()

    found = []
    for (places, _), stop in zip(wanted, stops, strict=True):
        part = outcomes[stop - len(places) : stop]
        found.append(dict(zip(places, part, strict=True)))
    return found


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
        self.evidence_p = AnswerRules.of(model.card.decision).from_p
        self._take_hands(scene, trials, model, settings, np.arange(len(trials)))
        self.spans = self.world.spans
        self.controller = make(trials, self.rate_hz)

        # Commands on their way: at first none.
        self._late = [np.zeros(len(trials))] * settings.delay_samples
        self._p_risky = np.zeros(len(trials))
        # What outcomes have of every sample, in single precision to save memory.
        self._noted = np.zeros((4, self.spans.periods, len(trials)), np.float32)

    def _take_hands(
        self,
        scene: Scene,
        trials: Trials,
        model: OpenedModel,
        settings: LoopSettings,
        columns: IntArray,
    ) -> None:
        """A hand for each of these trials; columns: theirs of the tape."""
        preparation = model.card.preparation
        habits = settings.habits

        # When the hand begins to close, the bias must be known and the filters of the model
        # settled.
        before = model.card.settle_samples + preparation.bias_rows + ROWS_TO_SPARE
        spans = spans_of(scene, trials, before, habits)

        self.actuator = Actuator(settings.drive, trials, settings.opening)
        steps = scene.step_settings_of(trials)
        self.world = HandsAndObjects(
            trials, steps, spans, self.actuator, habits, len(self.trials), columns
        )

        self.sensors: Any = LoopSensors(scene, trials, spans.counts)
        if settings.between is not None:
            self.sensors = settings.between(self.sensors, trials, spans.counts)
        self.models = HandModels(model, len(trials))
        self.wearer = Wearer(trials, habits, scene.seed)
        self._agents_n = self.world.all.state.agents_n.copy()

    def run(self) -> list[LoopOutcome]:
        """Every period in turn, then the outcome of each trial."""
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
        sense, now = self.feel(period)
        self._p_risky = np.where(sense.known, sense.p_risky, 0.0)
        # A queue: what is decided now acts delay_samples later.
        self._late.append(self.controller.step(sense, now))
        return self._late.pop(0)

    def feel(self, period: int) -> tuple[GripSense, LoopTruth]:
        """What controllers get at a sample, and what only a simulation knows."""
        # A trial that has ended repeats its last sample.
        spans = self.world.spans
        rows = np.minimum(spans.begins + period, spans.counts - 1)
        readings = self.sensors.read(rows, self.world.forces_n)
        values = readings.values.reshape(len(rows), -1)

        # Only the wearer, and a baseline of a study, use the truth.
        now = LoopTruth(rows / self.rate_hz, self.actuator.grip_n)
        opening = now.t_s >= self.wearer.signal_s
        overridden = self._overridden(now)
        sense = self.models.answer(values, readings.valid, opening, overridden)
        return sense, now

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
        return self._outcome(
            k,
            self.world.motion(k),
            overrode_s=float(self.wearer.overrode_s[k]),
            mu_hat=float(self.controller.mu_hat[k]),
            gives_up_s=float(self.world.script.gives_up_s[k]),
        )

    def _outcome(self, k: int, motion: TrialMotion, **known: float) -> LoopOutcome:
        begin = int(self.spans.begins[k])
        end = int(self.spans.ends[k])
        names = ("grip_n", "own_n", "target_n", "p_risky")
        levels = dict(zip(names, self._noted[:, : end - begin, k], strict=True))
        return outcome_of(
            self.trials[k],
            motion,
            **levels,
            **known,
            begin_s=begin / self.rate_hz,
            rate_hz=self.rate_hz,
            evidence_p=self.evidence_p,
        )


class BranchingLoop(ClosedLoop):
    """A closed loop whose lanes share a hand for as long as their commands agree.

    A lane is a trial with a controller. Every lane of a trial has the same past until a command
    differs, so till then one hand is simulated for all of them; then the hand becomes two, with the
    same past. A hand whose lanes have ended is left. Nothing of this changes an outcome.

    hand_of  [lanes] each lane's hand, -1 for one that has ended
    lead     [hands] a lane of each; its column of the tape is that of the hand
    """

    def __init__(
        self,
        scene: Scene,
        trials: Trials,
        model: OpenedModel,
        make: Make,
        settings: LoopSettings = USUAL,
    ) -> None:
        super().__init__(scene, trials, model, make, settings)
        self._gives_up_s = self.world.script.gives_up_s[self.hand_of]
        self._overrode_s = np.full(len(trials), np.inf)
        self._mu_hat = np.full(len(trials), np.nan)
        self.spans = self.spans.some(self.hand_of)

    def _take_hands(
        self,
        scene: Scene,
        trials: Trials,
        model: OpenedModel,
        settings: LoopSettings,
        columns: IntArray,
    ) -> None:
        """One hand for all lanes of a trial."""
        first: dict[int, int] = {}
        for lane, trial in enumerate(trials):
            first.setdefault(id(trial), lane)
        self._column_of = np.array([first[id(trial)] for trial in trials])
        self.lead = two_at_least(np.unique(self._column_of))
        self.hand_of = self._hands()
        hands = [trials[lane] for lane in self.lead]
        super()._take_hands(scene, hands, model, settings, self.lead)

    def _hands(self) -> IntArray:
        """The hand of each lane, [lanes]; -1 where it has none."""
        hands = np.full(len(self.trials), -1)
        hands[self.lead] = np.arange(len(self.lead))
        return hands[self._column_of]

    def run(self) -> list[LoopOutcome]:
        for period in range(self.spans.periods):
            self._leave(period)
            target_n = self.decide(period)
            self.note(period, target_n)
            self._end(period)
            self._advance(period, target_n)
        return [self.outcome(k) for k in range(len(self.trials))]

    def feel(self, period: int) -> tuple[GripSense, LoopTruth]:
        """As of every lane; one that has ended gets what some other feels."""
        sense, now = super().feel(period)
        lanes = [getattr(sense, name)[self.hand_of] for name in SENSES]
        return GripSense(*lanes), LoopTruth(
            now.t_s[self.hand_of], now.grip_n[self.hand_of]
        )

    def note(self, period: int, target_n: FloatArray) -> None:
        """Write down one sample period."""
        drive = self.actuator
        grip_n, own_n = drive.grip_n[self.hand_of], drive.wearers_n[self.hand_of]
        self._noted[:, period] = (grip_n, own_n, target_n, self._p_risky)

    def _end(self, period: int) -> None:
        """Keep what is known of the lanes whose last sample this is."""
        ends = self.spans.ends - self.spans.begins == period + 1
        self._overrode_s[ends] = self.wearer.overrode_s[self.hand_of[ends]]
        self._mu_hat[ends] = self.controller.mu_hat[ends]

    def _leave(self, period: int) -> None:
        """Leave the hands that have ended, where that is worth the copying."""
        spans = self.world.spans
        goes_on = spans.begins + period < spans.ends
        ended = len(goes_on) - int(goes_on.sum())
        if ended >= max(1, len(goes_on) // WORTH_LEAVING) and len(goes_on) > 2:
            which = np.flatnonzero(goes_on)
            self._keep(which, self.lead[which], period)

    def _advance(self, period: int, target_n: FloatArray) -> None:
        """One sample period; a hand whose lanes differ becomes several."""
        wanted = self.world.wanted(period)
        # A command below the wearer's own grip is none, nor is one that does not count.
        least_n = np.minimum(self.actuator.own_n, wanted.own_n.min(axis=0))
        counts_n = self.actuator.obeyed_n(
            target_n, self.world.opens(period)[self.hand_of]
        )
        counts_n = np.where(counts_n <= least_n[self.hand_of], 0.0, counts_n)

        differs = counts_n != counts_n[self.lead[self.hand_of]]
        differs &= self.hand_of >= 0
        if differs.any():
            # The first lane that differs leads the new hand.
            lead: dict[tuple[int, float], int] = {}
            for lane in np.flatnonzero(differs).tolist():
                key = int(self.hand_of[lane]), float(counts_n[lane])
                self._column_of[lane] = lead.setdefault(key, lane)
            old = np.arange(len(self.lead))
            which = np.concatenate([old, [hand for hand, _ in lead]])
            columns = np.concatenate([self.lead, list(lead.values())])
            wanted = wanted.some(self._keep(which, columns, period))
        self.world.advance(period, counts_n[self.lead], wanted)

    def _keep(self, which: IntArray, columns: IntArray, period: int) -> IntArray:
        """Go on with some hands, which may repeat; columns: the lanes that lead them.

        Returns which, with a single one twice.
        """
        which, columns = two_at_least(which), two_at_least(columns)
        n = len(self.lead)
        self.lead = columns
        self.hand_of = self._hands()

        self.actuator = some_trials(self.actuator, which, n)
        self.world.keep(which, columns, self.actuator, period)
        self.sensors = self.sensors.some(which)
        self.models = self.models.some(which)
        self.wearer = some_trials(self.wearer, which, n)
        self._agents_n = np.take(self._agents_n, which, axis=1)
        return which

    def outcome(self, k: int) -> LoopOutcome:
        """What became of lane k."""
        return self._outcome(
            k,
            self.world.motion(int(self._column_of[k])),
            overrode_s=float(self._overrode_s[k]),
            mu_hat=float(self._mu_hat[k]),
            gives_up_s=float(self._gives_up_s[k]),
        )


class _SideBySide:
    """Controllers of neighbouring lanes as one; stops: where the lanes of each end."""

    def __init__(
        self, controllers: Sequence[LoopController], stops: Sequence[int]
    ) -> None:
        self._lanes = [slice(a, b) for a, b in pairwise([0, *stops])]
        self._controllers = controllers
        self.mu_hat = np.full(stops[-1], np.nan)

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[lanes] target, N a side; 0 for none."""
        target_n = np.empty(len(self.mu_hat))
        for controller, lanes in zip(self._controllers, self._lanes, strict=True):
            felt = GripSense(*[getattr(sense, name)[lanes] for name in SENSES])
            truth = LoopTruth(now.t_s[lanes], now.grip_n[lanes])
            target_n[lanes] = controller.step(felt, truth)
            self.mu_hat[lanes] = controller.mu_hat
        return target_n


def _side_by_side(makes: Sequence[Make], stops: Sequence[int]) -> Make:
    """A maker of several controllers, one after another."""

    def make(trials: Trials, rate_hz: float) -> LoopController:
        controllers = []
        for one, (start, stop) in zip(makes, pairwise([0, *stops]), strict=True):
            controllers.append(one(trials[start:stop], rate_hz))
        return _SideBySide(controllers, stops)

    return make


class ManagedGrip:
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
) -> Callable[[Trials, float], ManagedGrip]:
    """A maker of a controller; setting, rules: None for the usual."""
    gain = shear_gain_in(scene.file.effects)

    def make(trials: Trials, rate_hz: float) -> ManagedGrip:
        batch: Batch = ManyHands(len(trials))
        controller = kind(batch, rate_hz, setting, rules, gain)
        return ManagedGrip(GripLoop(batch, rate_hz, controller, limits), len(trials))

    return make
