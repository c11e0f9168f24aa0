"""Runs of whole sets in a closed loop, many batches at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial

from holdfast.core.errors import UsageError
from holdfast.core.reading import Json
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.edge_runtime.grip import CONTROLLERS, AnswerRules
from holdfast.edge_runtime.monitor import require_fit
from holdfast.edge_runtime.supervisor import Limits
from holdfast.evaluation.jobs import Workers
from holdfast.evaluation.loop_scores import LoopFigures, ThreeRuns, loop_figures
from holdfast.simulation.closed_loop import (
    LoopSettings,
    Make,
    batches,
    managed,
    model_of,
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

ORACLE, VIBRATION = "oracle", "vibration"
CHOICES = (*CONTROLLERS, VIBRATION, ORACLE)
BARE = "none"


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


@lru_cache(maxsize=16)
def scene_of(one: LoopSet) -> tuple[Scene, tuple[PlannedTrial, ...]]:
    """The scene of a set and its trials with an object."""
    card = read_scene_file(one.card)
    rows = tuple(
        replace(row, values={**row.values, **_fitting(row, one)}) for row in card.rows
    )
    card = replace(
        card, rows=rows, controller=None, effects=_noisier(card.effects, one.noise)
    )
    scene = Scene(card, one.seed)
    return scene, tuple(t for t in scene.trials(one.trials) if t.action != "nothing")


def _noisier(effects: Mapping[str, Json], noise: float) -> dict[str, Json]:
    """The effects of a card whose chips average fewer conversions: a quarter of them, twice it."""
    if noise == 1.0:
        return dict(effects)
    chip, usual = (
        effects["hall_noise"],
        effect_named("hall_noise").parameters["averages"].default,
    )
    averages = chip.get("averages", usual) / noise**2
    return {**effects, "hall_noise": {**chip, "averages": averages}}


def _fitting(row: object, one: LoopSet) -> dict[str, object]:
    nothing = getattr(row, "action", "") == "nothing"
    return {} if nothing else dict(one.changes)


def require_runnable(model: OpenedModel, card_name: str) -> None:
    """Raise what does not fit between a card and a model, and CardError."""
    card = read_scene_file(card_name)
    contacts = 3 * card.hand.n_contacts
    require_fit(
        model.card,
        n_channels=contacts,
        unit=card.unit,
        rate_hz=card.rate_hz,
        where=card_name,
    )


def run_part(
    model: ModelChoice,
    one: LoopSet,
    request: LoopRequest,
    batch: list[int],
    onset_s: Mapping[int, float],
) -> dict[int, LoopOutcome]:
    """Outcomes of some trials of a set, by their places in it."""
    scene, trials = scene_of(one)
    settings = LoopSettings(
        Drive(lag_ms=request.lag_ms),
        request.habits,
        delay_samples=request.delay_samples,
    )
    make = _maker(scene, request, onset_s)
    return run_batch(scene, trials, batch, model_of(model), make, settings)


def _maker(scene: Scene, request: LoopRequest, onset_s: Mapping[int, float]) -> Make:
    if request.name == ORACLE:
        return oracle(dict(onset_s), Drive().ceiling_n)
    if request.name == VIBRATION:
        return vibration(scene.seed)
    if request.name not in CONTROLLERS:
        raise UsageError(
            f"no controller {request.name!r}",
            next_step=f"choose from {', '.join(CHOICES)}",
        )
    return managed(scene, request.name, request.setting, request.rules, Limits())


class LoopRuns:
    """Runs requests on sets, each once; done: called with the share of the work that is done."""

    def __init__(
        self,
        model: ModelChoice,
        workers: Workers,
        done: Callable[[float], None] = lambda share: None,
    ) -> None:
        self.model, self.workers, self.done = model, workers, done
        self._kept: dict[tuple[LoopSet, LoopRequest], dict[int, LoopOutcome]] = {}

    def run(self, wanted: Sequence[tuple[LoopSet, LoopRequest]]) -> None:
        """Run all of them, with the bare hands and oracles that their figures need."""
        drives = {(one, request.lag_ms): None for one, request in wanted}
        bare = [
            (one, LoopRequest(BARE)) for one in dict.fromkeys(one for one, _ in wanted)
        ]
        best = [(one, LoopRequest(ORACLE, lag_ms=lag_ms)) for one, lag_ms in drives]
        total = len({*bare, *best, *wanted})
        self._run(bare, 0.0, len(bare) / total)
        self._run([*best, *wanted], len(bare) / total, 1.0)

    def _run(
        self,
        wanted: Sequence[tuple[LoopSet, LoopRequest]],
        from_share: float,
        to_share: float,
    ) -> None:
        new = [pair for pair in dict.fromkeys(wanted) if pair not in self._kept]
        self._kept |= {pair: {} for pair in new}
        parts = [
            (one, request, batch)
            for one, request in new
            for batch in batches(scene_of(one)[1])
        ]
        jobs = [
            partial(
                run_part, self.model, one, request, batch, self._onsets(one, request)
            )
            for one, request, batch in parts
        ]
        results = self.workers.run(jobs)
        for number, ((one, request, _), outcomes) in enumerate(
            zip(parts, results, strict=True), 1
        ):
            self._kept[one, request] |= outcomes
            self.done(from_share + (to_share - from_share) * number / len(parts))

    def _onsets(self, one: LoopSet, request: LoopRequest) -> dict[int, float]:
        if request.name != ORACLE:
            return {}
        bare = self._kept[one, LoopRequest(BARE)].values()
        return {o.trial.number: o.onset_s for o in bare}

    def outcomes(self, one: LoopSet, request: LoopRequest) -> list[ThreeRuns]:
        """Each trial in three hands."""
        bare = self._kept[one, LoopRequest(BARE)]
        best = self._kept[one, LoopRequest(ORACLE, lag_ms=request.lag_ms)]
        held = self._kept[one, request]
        return [ThreeRuns(bare[k], best[k], held[k]) for k in sorted(held)]

    def figures(self, one: LoopSet, request: LoopRequest) -> LoopFigures:
        """Figures of a request on a set."""
        return loop_figures(self.outcomes(one, request))
