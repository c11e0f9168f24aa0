"""The whole evaluation of a model file: thresholds, baselines, every set, all sets together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from holdfast.core.errors import SetLocked, UsageError, count_of
from holdfast.core.locked import require_open, require_open_people
from holdfast.core.progress import Part, Say, ignored
from holdfast.core.trial_layout import read_json
from holdfast.data.datasets import find, load
from holdfast.data.recording import DataSet, Recording
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.evaluation import MOST_FALSE_PER_MIN
from holdfast.evaluation.alarms import choose_confidence
from holdfast.evaluation.baselines import (
    Baseline,
    ChosenConfidence,
    Thresholds,
    baselines,
    find_thresholds,
    raw_forest,
)
from holdfast.evaluation.jobs import Workers
from holdfast.evaluation.model_outputs import (
    OUTPUTS,
    ModelOutputs,
    everywhere,
    heads_with_task,
    read_outputs,
    require_model_fits,
    steps_with,
    window_figures,
)
from holdfast.evaluation.scored_set import Evaluation, ScoredSet, all_sets, score_set
from holdfast.step.spec import StepSpec


@dataclass(frozen=True)
class EvaluationRequest:
    """The options of an evaluation.

    data: sets to score. choose: sets to choose the confidence on, if any. train: a set to train the
    raw-window forest on. people: these only, if any.
    """

    data: Sequence[str]
    choose: Sequence[str] = ()
    train: str | None = None
    people: frozenset[str] = frozenset()
    most_false_per_min: float = MOST_FALSE_PER_MIN
    seed: int = 0


ALONE = Workers()


def evaluate_events(
    model: ModelChoice,
    request: EvaluationRequest,
    say: Say = ignored,
    part: Part = ignored,
    workers: Workers = ALONE,
) -> Evaluation:
    """Evaluate a file on sets.

    say: receives what begins. part: receives the share of it that is done. workers: where the sets
    are scored; each is a job.

    Raises what reading the sets raises, and ChannelError, UnitError or RateError where one does not
    fit the model.
    """
    # Before anything long is computed.
    _require_apart(request)
    run = _Run(model.open(), request, say, part)
    forest = run.forest()
    found = run.baselines(forest)
    # Chosen once for all sets; without other streams each set is matched on itself.
    chosen = run.chosen(found) if request.choose else None

    # In this process baselines and their kept signals are shared, and progress is shown.
    if workers.here:
        sets = [run.scored(name, found, chosen) for name in request.data]
    else:
        say(f"scoring {count_of(len(request.data), 'set')}")
        # Sessions cannot be sent to another process, so a job opens the model again.
        job = partial(_scored, model, request, forest, chosen)
        jobs = [partial(job, name) for name in request.data]
        sets = list(workers.run(jobs))

    say("figures of all sets together")
    # As deployed the confidence is the same for all sets; only the baselines' settings differ.
    thresholds = chosen or sets[0].figures.thresholds
    assert thresholds is not None
    # Name -> set; a second set of the same name has a number behind it.
    scored: dict[str, ScoredSet] = {}
    for one in sets:
        label = one.figures.card.name
        # The same scene with two seeds gives two sets of one name.
        if label in scored:
            label = f"{label} ({len(scored) + 1})"
        scored[label] = one
    return all_sets(run.model.card, scored, thresholds, request.seed)


def _scored(
    model: ModelChoice,
    request: EvaluationRequest,
    forest: bytes | None,
    chosen: Thresholds | None,
    name: str,
) -> ScoredSet:
    """One set, scored by any process."""
    run = _Run(model.open(), request, ignored, ignored)
    return run.scored(name, run.baselines(forest), chosen)


def _require_apart(request: EvaluationRequest) -> None:
    """Raise DataNotFound for a missing folder, UsageError for one to choose on and to score."""
    scored = {find(name).resolve() for name in request.data}
    if request.train:
        # A missing training folder is an error here, before any stage begins.
        require_open(find(request.train), "a forest")

    for name in request.choose:
        require_open(find(name), "a threshold")
        # Resolved, so that the same folder is found out under another name.
        if find(name).resolve() in scored:
            raise UsageError(
                f"{name} is given both to --choose and to --data",
                cause="a threshold that is scored on the streams it was chosen on flatters",
                next_step="simulate another set with another --seed, or leave --choose out",
            )


@dataclass(frozen=True)
class _Run:
    """What the parts of one evaluation share."""

    model: OpenedModel
    request: EvaluationRequest
    say: Say
    part: Part

    @property
    def spec(self) -> StepSpec:
        return StepSpec.from_json(self.model.card.raw["spec"])

    def forest(self) -> bytes | None:
        """The thesis' forest as a step graph; None without a set to train it on."""
        if self.request.train is None:
            return None
        self.say(f"training the raw-window forest on {self.request.train}")
        data = load(
            self.request.train,
            channels=self.model.card.n_channels,
            rate_hz=self.model.card.rate_hz,
            seed=self.request.seed,
            windows="thesis",
        )
        # Before a forest is trained in vain on other channels or another rate.
        require_model_fits(self.model, data)
        return raw_forest(data, self.spec, self.request.seed)

    def baselines(self, forest: bytes | None) -> list[Baseline]:
        """The baselines of this model."""
        return baselines(self.spec, self.model.card.decision, forest)

    def chosen(self, baselines: Sequence[Baseline]) -> Thresholds:
        """Thresholds from streams that are not scored."""
        # Several sets are read as one: the budget of false alarms is for all their minutes.
        names = self.request.choose
        card = self.model.card
        self.say(f"reading {', '.join(names)}, to choose the confidence on")
        recordings = []
        labels = []
        for name in names:
            data = self._load(name)
            require_open_people(data.name, data.people(), "a threshold")
            recordings += data.recordings
            labels.append(_label(name, data))

        _, outputs = self._answered(recordings)
        most = self.request.most_false_per_min
        # The budget of false alarms is fixed first; recall is what comes out.
        permille = choose_confidence(outputs, card.decision, most)
        self.say(
            f"confidence {permille} of 1000 chosen; matching {len(baselines)} baselines"
        )
        chosen = ChosenConfidence(permille, most)
        return find_thresholds(
            card, recordings, outputs, baselines, labels, chosen, self.part
        )

    def scored(
        self, name: str, baselines: Sequence[Baseline], chosen: Thresholds | None
    ) -> ScoredSet:
        """One set, scored; baselines are matched on it where nothing was chosen elsewhere."""
        self.say(f"reading {name}")
        data = self._load(name)
        # Heads without labels in this set cost time and cannot be scored.
        heads = heads_with_task(self.model, data.with_situations())
        # One pass gives both the states and what the windows are scored by.
        computed, outputs = self._answered(data.recordings, heads)
        windows = window_figures(self.model, data, computed, seed=self.request.seed)
        # The outputs of a long set take much memory, and are read by now.
        del computed

        thresholds = chosen
        if thresholds is None:
            self.say(f"{data.name}: matching {len(baselines)} baselines")
            names = [_label(name, data)]
            card = self.model.card
            thresholds = find_thresholds(
                card, data.recordings, outputs, baselines, names, part=self.part
            )

        self.say(f"{data.name}: scoring the model and {len(baselines)} baselines")

        return score_set(
            find(name),
            data,
            self.model.card,
            outputs,
            thresholds,
            baselines,
            windows,
            self.request.seed,
            self.part,
        )

    def _answered(
        self, recordings: list[Recording], heads: Sequence[str] = ()
    ) -> tuple[list[Outputs], list[ModelOutputs]]:
        """What the model computes at every sample, and its answers."""
        self.say(f"running the model on {count_of(len(recordings), 'recording')}")
        steps = steps_with(self.model, [*OUTPUTS, *heads])
        computed = everywhere(steps, recordings, self.part)
        return computed, read_outputs(self.model, recordings, computed)

    def _load(self, name: str) -> DataSet:
        data = load(
            name,
            channels=self.model.card.n_channels,
            rate_hz=self.model.card.rate_hz,
            seed=self.request.seed,
            windows="natural",
        )
        # Before a set is run, which takes minutes.
        require_model_fits(self.model, data)
        # Unseen people alone, where the model was trained on others of the set.
        if self.request.people:
            data = data.of_groups(self.request.people)
        _require_unseen(self.model.card, data)
        return data


def _require_unseen(card: ModelCard, data: DataSet) -> None:
    """Raise SetLocked for people of a set that the model has learned from, at whatever rate."""
    for learned in card.raw["training"].get("sets", []):
        seen = sorted(set(learned["people"]) & set(data.people()))
        if learned["name"] == data.name and seen:
            raise SetLocked(
                f"the model has learned from {', '.join(seen)} of {data.name}",
                where=data.name,
                cause="its figures on people that it knows would flatter",
                next_step="evaluate it on a folder of other people; figures with these people left "
                "out: python -m studies people",
            )


def _label(name: str, data: DataSet) -> str:
    """A set's name with the seed it was made from, if any: two sets of one card differ by it."""
    # A recorded set has no seed, and needs none to be told apart.
    made_from = read_json(find(name) / "meta.json").get("seed")
    return data.name if made_from is None else f"{data.name}, seed {made_from}"
