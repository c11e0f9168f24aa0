"""Grip controllers on scenes in a closed loop: what is run, and how often.

A set is run once in a hand that does nothing, and together with it by every controller: a trial is
one hand for all of them until their commands differ. Where the bare hand drops the object, an
oracle tries several closures of the drive; the gentlest that keeps it counts. What they are worth
is in benchmarks/loop_figures.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path

from benchmarks.loop_baselines import CLOSURES, oracle, vibration
from benchmarks.loop_figures import LoopFigures, ThreeRuns, loop_figures
from holdfast.core.contract import Json
from holdfast.core.errors import UsageError
from holdfast.core.locked import locked_sets
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.edge_runtime.grip import AnswerRules
from holdfast.edge_runtime.monitor import require_fit
from holdfast.edge_runtime.supervisor import Limits
from holdfast.evaluation.jobs import Workers
from holdfast.simulation.actions import EMPTY_HANDED
from holdfast.simulation.loop.closed_loop import (
    Between,
    LoopSettings,
    Make,
    batches,
    managed,
    model_of,
    run_together,
)
from holdfast.simulation.loop.drive import Drive, Opening
from holdfast.simulation.loop.people import Habits, LoopOutcome
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from studies.shared_control.published import CONTROLLERS

ORACLE = "oracle"
VIBRATION = "vibration"
CHOICES = (*CONTROLLERS, VIBRATION, ORACLE)
BARE = "none"
"""The controller of the bare hand, which never adds to the wearer's command."""
BEFORE_ORACLES = 0.9
"""About the share of a study's work that is done before the oracles begin."""


@dataclass(frozen=True)
class LoopSet:
    """Trials of a card: all of it, or so many in its proportions.

    changes: values of every row, two numbers for all between them. tremor_m_s2: amplitude of the
    hand's trembling; 0: the card as it is. actions: only rows of these; none given: all.
    """

    card: str
    trials: int | None
    seed: int
    changes: tuple[tuple[str, object], ...] = ()
    tremor_m_s2: float = 0.0
    actions: tuple[str, ...] = ()


@dataclass(frozen=True)
class LoopRequest:
    """One controller with a setting (None: its default) on a set, with a drive.

    The setting of an oracle is how far it closes, one of CLOSURES; knows_after_s: by so much later
    than load onset it knows. rules: names and values of AnswerRules that differ from those that
    come with the model.
    """

    name: str
    setting: float | None = None
    lag_ms: float = 50.0
    opening: Opening = "wearer"
    delay_samples: int = 0
    rules: tuple[tuple[str, object], ...] = ()
    habits: Habits = field(default_factory=Habits)
    between: Between | None = None
    knows_after_s: float = 0.0


@lru_cache(maxsize=16)
def scene_of(of: LoopSet) -> tuple[Scene, tuple[PlannedTrial, ...]]:
    """The scene of a set and its trials with an object."""
    card = read_scene_file(of.card)
    rows = []
    for row in card.rows:
        if of.actions and row.action not in of.actions:
            continue
        # A row without an object has none of the values to change.
        changes: dict[str, object] = {}
        if row.action not in EMPTY_HANDED:
            for name, value in of.changes:
                if isinstance(value, tuple):
                    value = {"uniform": list(value)}
                changes[name] = value
        values = {**row.values, **changes}
        rows.append(replace(row, values=values))

    effects = dict(card.effects)
    if of.tremor_m_s2:
        # Each trial's frequency and directions are drawn as the effect has them.
        tremor = dict(effects.get("tremor", {}))
        effects["tremor"] = {**tremor, "amplitude_m_s2": of.tremor_m_s2}

    changed = replace(card, rows=tuple(rows), effects=effects)
    scene = Scene(changed, of.seed)
    trials = scene.trials(of.trials)
    return scene, tuple(trial for trial in trials if trial.holds_object)


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


def _require_seen(card_name: str, seed: int) -> None:
    """Raise UsageError for a style that no choice may see, at a seed that is not locked."""
    sha256 = read_scene_file(card_name).sha256
    sets = locked_sets()
    for style in sets.styles:
        same = style.sha256 == sha256 or style.scene == Path(card_name).stem
        if same and sets.lock_of_seed(seed) is None:
            raise UsageError(
                f"{style.scene} is a style that no choice may see, and seed {seed} is not locked",
                next_step="choose on other scenes; this one runs in reports, at a locked seed",
            )


def run_part(
    model: ModelChoice,
    of: LoopSet,
    wanted: Sequence[tuple[LoopRequest, list[int]]],
    onset_s: Mapping[int, float],
) -> list[dict[int, LoopOutcome]]:
    """Outcomes of some trials of a set for each request, by their places in it.

    Requests that run together differ in their controllers only. onset_s: for oracles.
    """
    # Made again in every process and kept there: a scene is small to name and large to send.
    scene, trials = scene_of(of)

    request = wanted[0][0]
    drive = Drive(lag_ms=request.lag_ms)
    settings = LoopSettings(
        drive, request.opening, request.habits, request.delay_samples
    )
    settings = replace(settings, between=request.between)
    # A controller has a state, so every batch gets controllers of its own.
    opened = model_of(model)
    makes = []
    for one, batch in wanted:
        rules = AnswerRules.of(opened.card.decision, **dict(one.rules))
        makes.append((batch, _maker(scene, one, onset_s, rules)))
    return run_together(scene, trials, makes, opened, settings)


def _surroundings(request: LoopRequest) -> LoopRequest:
    """The request without what is of its controller alone: those with the same run together."""
    return replace(request, name=BARE, setting=None, rules=(), knows_after_s=0.0)


def _maker(
    scene: Scene,
    request: LoopRequest,
    onset_s: Mapping[int, float],
    rules: AnswerRules,
) -> Make:
    if request.name == ORACLE:
        # The oracle tightens at each true onset, up to the force that the drive can give.
        closure = CLOSURES[0] if request.setting is None else request.setting
        ceiling_n = Drive().ceiling_n
        return oracle(dict(onset_s), ceiling_n, closure, request.knows_after_s)

    # No controller: the wearer feels a vibration and reacts to it.
    if request.name == VIBRATION:
        return vibration(scene.seed, rules.from_p)
    if request.name not in CONTROLLERS:
        raise UsageError(
            f"no controller {request.name!r}",
            next_step=f"choose from {', '.join(CHOICES)}",
        )

    return managed(scene, CONTROLLERS[request.name], request.setting, rules, Limits())


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
        # What each run made of each trial, by its place in the set.
        self._outcomes: dict[Run, dict[int, LoopOutcome]] = {}

    def run(self, wanted: Sequence[Run]) -> None:
        """Run all of them, with the bare hands and oracles that their figures need."""
        # All figures are differences from the bare hand, or shares of what the oracle keeps.
        runs: dict[Run, None] = {}
        for of, request in wanted:
            needed = (_bare(of), _best(of, request), _held(of, request))
            runs |= dict.fromkeys(needed)
        # What several requests share is run once.
        left = [run for run in runs if run not in self._outcomes]
        oracles = [run for run in left if run[1].name == ORACLE]
        whole = {}
        for run in left:
            if run[1].name != ORACLE:
                self._outcomes[run] = {}
                whole[run] = list(range(len(scene_of(run[0])[1])))

        # The oracle acts at the load onset of the bare hand, so that is run first.
        self._run_places(whole, 0.0, BEFORE_ORACLES)
        self._try(oracles, BEFORE_ORACLES)

    def _try(self, oracles: Sequence[Run], share: float) -> None:
        """Run all closures of oracles; the gentlest that prevents a drop is what they know."""
        places = {}
        for of, request in oracles:
            bare = self._outcomes[_bare(of)]
            # A hand that knows what will come does nothing where the bare hand keeps the object.
            lost = [k for k in sorted(bare) if ThreeRuns(*[bare[k]] * 3).drop]
            self._outcomes[of, request] = dict(bare)
            for closure in CLOSURES if lost else ():
                places[of, replace(request, setting=closure)] = lost

        # They are one hand up to where the gentlest stops closing, so all together cost little
        # more than one.
        self._outcomes |= {run: {} for run in places}
        self._run_places(places, share, 1.0)
        for (of, request), lost in places.items():
            tried = self._outcomes.pop((of, request))
            known = self._outcomes[of, replace(request, setting=None)]
            first = request.setting == CLOSURES[0]
            known |= {k: tried[k] for k in lost if first or known[k].dropped}

    def _run_places(
        self, places: Mapping[Run, list[int]], from_share: float, to_share: float
    ) -> None:
        """Run some trials of sets, by their places in them: the same for all that run together."""
        together: dict[Run, list[Run]] = {}
        for of, request in places:
            together.setdefault((of, _surroundings(request)), []).append((of, request))
        jobs = []
        runs = []
        for (of, _), alike in together.items():
            # Only the oracle knows the onsets, which the other controllers have to detect.
            onset_s = self._onset_s(*alike[0])
            # Batches are the unit of work: a process simulates many trials at a time, each with
            # all of its controllers.
            _, trials = scene_of(of)
            some = places[alike[0]]
            for batch in batches([trials[k] for k in some], len(alike)):
                at = [some[k] for k in batch]
                wanted = [(request, at) for _, request in alike]
                runs.append(alike)
                jobs.append(partial(run_part, self.model, of, wanted, onset_s))

        results = self.workers.run(jobs)
        for number, (alike, found) in enumerate(zip(runs, results, strict=True), 1):
            # Batches of one run come one after another and are put together here.
            for run, outcomes in zip(alike, found, strict=True):
                self._outcomes[run] |= outcomes
            self.done(from_share + (to_share - from_share) * number / len(runs))

    def _onset_s(self, of: LoopSet, request: LoopRequest) -> dict[int, float]:
        """Trial's number -> the onset that an oracle has of it; nothing for any other."""
        if request.name != ORACLE:
            return {}
        bare = self._outcomes[_bare(of)].values()
        return {one.trial.number: one.onset_s for one in bare}

    def runs(self, of: LoopSet, request: LoopRequest) -> list[ThreeRuns]:
        """Every trial of a set in its three hands, in the order of the set."""
        bare = self._outcomes[_bare(of)]
        best = self._outcomes[_best(of, request)]
        held = self._outcomes[_held(of, request)]
        # Batches hold trials of similar length, so outcomes are not in the order of the set.
        places = sorted(held)
        return [ThreeRuns(bare[k], best[k], held[k]) for k in places]

    def figures(self, of: LoopSet, request: LoopRequest) -> LoopFigures:
        """Figures of a request on a set."""
        return loop_figures(self.runs(of, request))


def _bare(of: LoopSet) -> Run:
    """The run of a set in a hand that does nothing."""
    return of, LoopRequest(BARE)


def _best(of: LoopSet, request: LoopRequest) -> Run:
    """The run of a set by the oracle, with the drive of a request."""
    # The same lag: the oracle shall show what this drive could do, not what a faster one could.
    return of, LoopRequest(ORACLE, lag_ms=request.lag_ms)


def _held(of: LoopSet, request: LoopRequest) -> Run:
    """The run of a set by the controller of a request."""
    if request.name != ORACLE:
        return of, request
    # An oracle differs from the best one only in when it knows.
    best = _best(of, request)[1]
    return of, replace(best, knows_after_s=request.knows_after_s)


FiguresByCard = dict[str, dict[str, LoopFigures]]
"""Scene -> controller -> its figures."""
RunsByCard = dict[str, dict[str, list[ThreeRuns]]]
"""Scene -> controller -> its trials."""


@dataclass(frozen=True)
class LoopComparison:
    """Which controllers run on which scenes.

    setting: of every controller, None for the default of each. lag_ms: of the hand's drive.
    trials: how many of a scene, None for all. opening: who decides when the wearer opens.
    """

    model: ModelChoice
    cards: tuple[str, ...]
    controllers: tuple[str, ...]
    setting: float | None
    lag_ms: float
    trials: int | None
    seed: int
    opening: Opening = "wearer"

    def require_runnable(self) -> None:
        """Raise what would stop a run: UsageError, CardError, or a model that does not fit."""
        for name in self.controllers:
            if name not in CHOICES:
                raise UsageError(
                    f"--controller {name!r:.40} does not exist",
                    next_step=f"choose from {', '.join(CHOICES)}",
                )

        model = model_of(self.model)
        for card in self.cards:
            require_runnable(model, card)
            _require_seen(card, self.seed)

    def run(
        self, workers: Workers, done: Callable[[float], None]
    ) -> tuple[FiguresByCard, RunsByCard]:
        """Run every controller on every scene. done: gets the share of the work that is done."""
        runs = LoopRuns(self.model, workers, done)
        wanted = []
        for card in self.cards:
            loop_set = LoopSet(card, self.trials, self.seed)
            for name in self.controllers:
                request = LoopRequest(name, self.setting, self.lag_ms, self.opening)
                wanted.append((loop_set, request))

        # All at once: scenes and bare hands that several requests need are run once.
        runs.run(wanted)

        figures: FiguresByCard = {}
        trials: RunsByCard = {}
        for loop_set, request in wanted:
            # By the name of the scene: a path would differ from machine to machine.
            name = Path(loop_set.card).stem
            of_request = runs.figures(loop_set, request)
            figures.setdefault(name, {})[request.name] = of_request
            trials.setdefault(name, {})[request.name] = runs.runs(loop_set, request)

        return figures, trials

    def to_json(self, figures: FiguresByCard) -> Json:
        """The figures with all that they depend on."""
        sets = {}
        for card, of_card in figures.items():
            sets[card] = {name: one.to_json() for name, one in of_card.items()}

        return {
            "kind": "simulated",
            "model": model_of(self.model).card.model_id,
            "engine": self.model.engine,
            "lag_ms": self.lag_ms,
            "opening": self.opening,
            "seed": self.seed,
            "trials": self.trials,
            "setting": self.setting,
            "sets": sets,
        }
