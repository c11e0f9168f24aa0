"""What a grip controller is worth on a set: drops saved, hand-overs blocked, and what it costs.

Each trial is run three times: in a hand that does nothing (bare), by the oracle, and by the
controller. A drop is preventable where the bare hand loses the object in a pull or a fall and the
oracle keeps it. A hand-over is blocked where the receiver needs over 5 N more than from the bare
hand, gets the object over 0.3 s later, or needs an override. All figures are simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import UsageError
from holdfast.core.reading import Json
from holdfast.core.trial_layout import RISKY_ACTIONS
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.edge_runtime.grip import CONTROLLERS, AnswerRules
from holdfast.edge_runtime.monitor import require_fit
from holdfast.edge_runtime.supervisor import Limits
from holdfast.evaluation.jobs import Workers
from holdfast.evaluation.statistics import share
from holdfast.simulation.closed_loop import (
    LoopSettings,
    Make,
    batches,
    managed,
    model_of,
    needed_grip_n,
    oracle,
    run_batch,
    vibration,
)
from holdfast.simulation.drive import Drive
from holdfast.simulation.effect import effect_named
from holdfast.simulation.loop_people import Habits, LoopOutcome
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.figures import Interval

ORACLE = "oracle"
VIBRATION = "vibration"
CHOICES = (*CONTROLLERS, VIBRATION, ORACLE)
BARE = "none"
"""The controller of the bare hand, which never adds to the wearer's command."""
BLOCKED_N = 5.0
BLOCKED_S = 0.3
"""A hand-over that needs more force, or more time, than this is blocked."""
TIGHTER_N = 1.0
"""A hand that grips by so much more than its wearer commands is tightened."""


@dataclass(frozen=True)
class LoopSet:
    """Trials of a card: all of it, or so many in its proportions.

    changes: values of every row. noise: times that of the card's chips; 1: the card as it is.
    """

    card: str
    trials: int | None
    seed: int
    changes: tuple[tuple[str, object], ...] = ()
    noise: float = 1.0


@dataclass(frozen=True)
class LoopRequest:
    """One controller with a setting (None: its default) on a set, with a drive."""

    name: str
    setting: float | None = None
    lag_ms: float = 50.0
    delay_samples: int = 0
    rules: AnswerRules | None = None
    habits: Habits = field(default_factory=Habits)


@dataclass(frozen=True)
class ThreeRuns:
    """One trial in three hands."""

    bare: LoopOutcome
    oracle: LoopOutcome
    held: LoopOutcome

    @property
    def preventable(self) -> bool:
        """The bare hand drops it in the action, the oracle does not."""
        # The bare hand and the oracle bound what any controller can change.
        bare = self.bare
        # What falls before the action began was a weak grip, and no slip to be prevented.
        in_action = bare.lost_s >= bare.act_s
        if bare.trial.action not in RISKY_ACTIONS or not in_action:
            return False
        return bare.dropped and not self.oracle.dropped

    @property
    def completes(self) -> bool:
        """The bare hand hands the object over, after the action began."""
        return self.bare.act_s <= self.bare.lost_s < np.inf

    @property
    def blocked(self) -> bool:
        """The hand-over needs more force, more time or an override."""
        # An override frees the object, yet the wearer had to see that the hand was wrong.
        overrides = bool(np.isfinite(self.held.overrode_s))
        return self.extra_n > BLOCKED_N or self.extra_s > BLOCKED_S or overrides

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
        held = self.held
        trial = self.held.trial
        t_s = _times_s(held)

        # What the wearer commands is taken as needed, also where less would do.
        needed_n = trial.grip_n
        if trial.action in RISKY_ACTIONS:
            needed_n = max(needed_grip_n(trial), trial.grip_n)
        # Before load onset nothing beyond the wearer's command is needed.
        least_n = np.where(t_s >= held.onset_s, needed_n, trial.grip_n)
        beyond_n = np.maximum(held.grip_n - least_n, 0.0)
        # After the object is gone the grip costs nothing.
        while_held_n = beyond_n[t_s < held.lost_s]
        return float(while_held_n.sum() / held.rate_hz)

    @property
    def friction_error(self) -> float:
        """Relative error of the friction estimate against the kinetic friction; nan without one."""
        # The estimate is made while the object slides, so it is kinetic friction that it measures.
        true = max(self.held.trial.kinetic_friction, 1e-9)
        return abs(self.held.mu_hat / true - 1.0)


def _times_s(of: LoopOutcome) -> FloatArray:
    """[T] times of the grip."""
    rows = np.arange(len(of.grip_n))
    times_s: FloatArray = of.begin_s + rows / of.rate_hz
    return times_s


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
        """As a JSON object, in the order of the fields."""
        return asdict(self)


def loop_figures(runs: Sequence[ThreeRuns]) -> LoopFigures:
    """The figures of one controller on one set."""
    preventable = []
    kept = []
    passes = []
    put_downs = []
    fragile = []
    drops = 0
    new_drops = 0
    for run in runs:
        drops += run.bare.dropped
        new_drops += run.held.dropped and not run.bare.dropped
        if run.preventable:
            preventable.append(run)
            if not run.held.dropped:
                kept.append(run)
        # A hand-over that the bare hand does not finish has nothing to compare with.
        if run.completes and run.bare.trial.action == "pass":
            passes.append(run)
        if run.completes and run.bare.trial.action == "put-down":
            put_downs.append(run)
        # Only fragile objects can be crushed, so only they are in the denominator.
        if run.bare.trial.object.crush_n > 0.0:
            fragile.append(run)

    saved = share([not run.held.dropped for run in preventable])
    blocked = share([run.blocked for run in passes])
    disturbed = share([run.blocked for run in put_downs])
    crushed = share([run.held.crushed for run in fragile])

    delays_ms = [1e3 * run.extra_s for run in passes]
    excess_n_s = [run.excess_n_s for run in runs]
    # Without a slip the controller has no estimate of friction, and no error.
    errors = [run.friction_error for run in preventable]
    known_errors = [error for error in errors if np.isfinite(error)]

    # Medians are of the cases that a share counts, so both describe the same trials.
    return LoopFigures(
        trials=len(runs),
        drops=drops,
        preventable=len(preventable),
        saved=len(kept),
        saved_share=saved.share,
        saved_share_ci=saved.share_ci,
        slip_mm_p50=_percentile([run.held.slip_mm for run in kept], 50),
        handovers=len(passes),
        blocked=sum(run.blocked for run in passes),
        blocked_share=blocked.share,
        blocked_share_ci=blocked.share_ci,
        extra_force_n_p50=_percentile([run.extra_n for run in passes], 50),
        extra_delay_ms_p50=_percentile(delays_ms, 50),
        extra_delay_ms_p95=_percentile(delays_ms, 95),
        put_downs=len(put_downs),
        disturbed_share=disturbed.share,
        disturbed_share_ci=disturbed.share_ci,
        fragile=len(fragile),
        crushed_share=crushed.share,
        crushed_share_ci=crushed.share_ci,
        grip_excess=float(np.mean(excess_n_s)) if runs else 0.0,
        tightenings_per_min=_tightenings_per_min(runs),
        new_drops=new_drops,
        mu_observed=len(known_errors),
        mu_error_p50=_percentile(known_errors, 50),
    )


def _percentile(values: Sequence[float], percent: float) -> float | None:
    if not values:
        return None
    # What never happened is later than all else, and keeps the percentile finite.
    finite = np.where(np.isfinite(values), values, 1e6)
    return float(np.percentile(finite, percent))


def _tightenings_per_min(runs: Sequence[ThreeRuns]) -> float | None:
    """How often the grip rises by TIGHTER_N before any action, or in a disturbed hold."""
    count = 0
    seconds = 0.0
    for run in runs:
        held = run.held
        # In an action more grip may be right, so only the time before it is watched.
        until_s = held.opens_s if held.trial.action == "hold" else held.act_s
        # A disturbed hold has no action: it is watched until the hand opens.
        watched = _times_s(held) < min(until_s, held.lost_s)
        is_tight = held.grip_n > held.trial.grip_n + TIGHTER_N
        tight = is_tight[watched]
        # One rise above the limit counts once, however long the grip stays there.
        begins = tight[1:] & ~tight[:-1]
        count += int(begins.sum())
        seconds += len(tight) / held.rate_hz

    return 60.0 * count / seconds if seconds else None


@lru_cache(maxsize=16)
def scene_of(of: LoopSet) -> tuple[Scene, tuple[PlannedTrial, ...]]:
    """The scene of a set and its trials with an object."""
    card = read_scene_file(of.card)
    rows = []
    for row in card.rows:
        # A row without an object has none of the values to change.
        changes = {} if row.action == "nothing" else dict(of.changes)
        values = {**row.values, **changes}
        rows.append(replace(row, values=values))

    effects = dict(card.effects)
    if of.noise != 1.0:
        # A chip that averages a quarter of the conversions is twice as noisy.
        chip = effects["hall_noise"]
        usual = effect_named("hall_noise").parameters["averages"].default
        # The noise of a mean falls with the root of the conversions that it averages.
        averages = chip.get("averages", usual) / of.noise**2
        effects["hall_noise"] = {**chip, "averages": averages}

    changed = replace(card, rows=tuple(rows), controller=None, effects=effects)
    # Without the controller that the scene names: the request brings its own.
    scene = Scene(changed, of.seed)
    trials = scene.trials(of.trials)
    return scene, tuple(trial for trial in trials if trial.action != "nothing")


def require_runnable(model: OpenedModel, card_name: str) -> None:
    """Raise what does not fit between a card and a model, and CardError."""
    card = read_scene_file(card_name)
    require_fit(
        model.card,
        n_channels=3 * card.hand.n_sensors,
        unit=card.unit,
        rate_hz=card.rate_hz,
        where=card_name,
    )


def run_part(
    model: ModelChoice,
    of: LoopSet,
    request: LoopRequest,
    batch: list[int],
    onset_s: Mapping[int, float],
) -> dict[int, LoopOutcome]:
    """Outcomes of some trials of a set, by their places in it."""
    # Made again in every process and kept there: a scene is small to name and large to send.
    scene, trials = scene_of(of)

    drive = Drive(lag_ms=request.lag_ms)
    settings = LoopSettings(drive, request.habits, delay_samples=request.delay_samples)
    # A controller has a state, so every batch gets controllers of its own.
    make = _maker(scene, request, onset_s)
    return run_batch(scene, trials, batch, model_of(model), make, settings)


def _maker(scene: Scene, request: LoopRequest, onset_s: Mapping[int, float]) -> Make:
    if request.name == ORACLE:
        # The oracle tightens at each true onset, up to the force that the drive can give.
        return oracle(dict(onset_s), Drive().ceiling_n)

    # No controller: the wearer feels a vibration and reacts to it.
    if request.name == VIBRATION:
        return vibration(scene.seed)
    if request.name not in CONTROLLERS:
        raise UsageError(
            f"no controller {request.name!r}",
            next_step=f"choose from {', '.join(CHOICES)}",
        )

    return managed(scene, request.name, request.setting, request.rules, Limits())


Run = tuple[LoopSet, LoopRequest]


class LoopRuns:
    """Runs requests on sets, each once; done: called with the share of the work that is done."""

    def __init__(
        self,
        model: ModelChoice,
        workers: Workers,
        done: Callable[[float], None],
    ) -> None:
        self.model = model
        self.workers = workers
        self.done = done
        self._outcomes: dict[Run, dict[int, LoopOutcome]] = {}

    def run(self, wanted: Sequence[Run]) -> None:
        """Run all of them, with the bare hands and oracles that their figures need."""
        bare = []
        best = []
        for of, request in wanted:
            # All figures are differences from the bare hand, or shares of what the oracle keeps.
            bare.append(_bare(of))
            best.append(_best(of, request))

        total = len({*bare, *best, *wanted})
        share_bare = len(set(bare)) / total
        # The oracle acts at the load onset of the bare hand, so that is run first.
        self._run(bare, 0.0, share_bare)
        self._run([*best, *wanted], share_bare, 1.0)

    def _run(self, wanted: Sequence[Run], from_share: float, to_share: float) -> None:
        jobs = []
        runs = []
        # Each once, in the order in which they were asked for.
        for run in dict.fromkeys(wanted):
            # Bare hands are shared by all requests on a set.
            if run in self._outcomes:
                continue
            self._outcomes[run] = {}
            of, request = run
            # Only the oracle is told the onsets, which the other controllers have to detect.
            onset_s = self._onset_s(of) if request.name == ORACLE else {}
            # Batches are the unit of work: a process simulates many trials at a time.
            _, trials = scene_of(of)
            for batch in batches(trials):
                runs.append(run)
                jobs.append(partial(run_part, self.model, of, request, batch, onset_s))

        results = self.workers.run(jobs)
        for number, (run, outcomes) in enumerate(zip(runs, results, strict=True), 1):
            # Batches of one run come one after another and are put together here.
            self._outcomes[run] |= outcomes
            self.done(from_share + (to_share - from_share) * number / len(runs))

    def _onset_s(self, of: LoopSet) -> dict[int, float]:
        """Trial's number -> load onset in the bare hand."""
        bare = self._outcomes[_bare(of)].values()
        return {outcome.trial.number: outcome.onset_s for outcome in bare}

    def figures(self, of: LoopSet, request: LoopRequest) -> LoopFigures:
        """Figures of a request on a set."""
        bare = self._outcomes[_bare(of)]
        best = self._outcomes[_best(of, request)]
        held = self._outcomes[of, request]
        # Batches hold trials of similar length, so outcomes are not in the order of the set.
        runs = []
        for k in sorted(held):
            runs.append(ThreeRuns(bare[k], best[k], held[k]))
        return loop_figures(runs)


def _bare(of: LoopSet) -> Run:
    """The run of a set in a hand that does nothing."""
    return of, LoopRequest(BARE)


def _best(of: LoopSet, request: LoopRequest) -> Run:
    """The run of a set by the oracle, with the drive of a request."""
    # The same lag: the oracle shall show what this drive could do, not what a faster one could.
    return of, LoopRequest(ORACLE, lag_ms=request.lag_ms)
