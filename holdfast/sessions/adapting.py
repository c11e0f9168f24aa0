"""Adapting a model file to one person from a short recording: a correction and when it acts.

An adaptation starts from the file itself, or from the base inside an adapted file. Recordings with
slips, which a person does not have to record, are simulated if none are given.

The operating point is chosen on trials that its correction has not seen: the correction is fitted
in turn without a part of all trials and answers that part. Among the operating points that keep the
recall on the others' slips, the one is taken that calls fewest of the person's samples. (Eight
hand-overs called or not are too coarse a measure to choose by.)
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.core.contract import RISKY_SLIP, BoolArray
from holdfast.core.errors import TooLittleToAdapt, UsageError, WorseThanBase, count_of
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import ModelCard, votes_in_all
from holdfast.evaluation.alarms import Answers, act_requests, match_alarms
from holdfast.evaluation.trials import voluntary_actions
from holdfast.export.changed import Adaptation
from holdfast.export.heads import Correction, FloatRows
from holdfast.sessions.slip_evidence import (
    LabelWeights,
    PersonCounts,
    Stream,
    contradicted,
    corrected,
    counts_of,
    fit_correction,
    label_weights,
    moved,
    streams_of,
    warn_of_contradicted,
)
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import load
from holdfast.training.progress import Part, Say, ignored
from holdfast.training.recording import DataSet

LEAST_HAND_OVERS = 8
"""As many as the adaptation protocol asks for."""
LEAST_HOLDING_S = 40.0
"""Of a grip without a slip, in which nothing may be called."""
LEAST_SLIPS = 40
"""Of so many, a single missed slip already falls below LEAST_RECALL."""
LEAST_RECALL = 0.99
"""Of the others' slips, with the trial held out; or the base's own recall where that is less."""
MOST_RECALL_LOST = 0.01 + 1e-9
"""More makes a file that is worse than its base; a hair more, for 1 - 0.99 in binary."""
FOLDS = 4
"""Parts of all trials; each is answered by a correction fitted without it."""
NATS = (-1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
"""How far the logit of a correction is moved."""
PERMILLE = (400, 500, 600, 700)
FINER = tuple(range(400, 1000, 50))
"""Thresholds with a correction, whose place moves more finely, and without one."""
LONGER = (0, 1)
"""Samples that an act needs beyond the base's."""
SCENE = "thesis"
TRIALS = 300
SEED = 1
"""Of simulated slips. Models are trained on seed 0."""


@dataclass(frozen=True)
class HeldOutFigures:
    """What an operating point reaches on held-out trials.

    recall, before_gross_slip: of all slips, the others' and the person's. slips, found: of the
    person alone. hand_overs, called: of the person's voluntary actions, put-downs too.
    called_samples: of the person, at which an act may begin.
    """

    recall: float
    before_gross_slip: float
    slips: int
    found: int
    hand_overs: int
    called: int
    called_samples: int

    def worse_than(self, base: HeldOutFigures) -> list[str]:
        """In which ways these figures are worse than the base's on the same trials; empty: none."""
        worse = []
        if self.recall < base.recall - MOST_RECALL_LOST:
            worse.append(f"recall {self.recall:.3f}, of the base {base.recall:.3f}")
        if self.found < base.found - MOST_RECALL_LOST * base.slips:
            counts = f"{self.found} of {self.slips} found, by the base {base.found}"
            worse.append(f"slips of the person: {counts}")
        if self.called > base.called:
            counts = f"{self.called} of {self.hand_overs}, by the base {base.called}"
            worse.append(f"voluntary actions called: {counts}")
        return worse


@dataclass(frozen=True)
class OperatingPoint:
    """nats: how far the correction's logit is moved, None without a correction."""

    nats: float | None
    rules: DecisionRules
    reached: HeldOutFigures


@dataclass(frozen=True)
class Fitted:
    """An adaptation, the held-out figures of its operating point, and what it was fitted on.

    base: what the base reaches on the same trials. contradicted: trials of the person whose labels
    the base contradicts.
    """

    adaptation: Adaptation
    point: OperatingPoint
    base: HeldOutFigures
    contradicted: list[str]
    streams: list[Stream]

    def require_no_worse(self) -> None:
        """Raise WorseThanBase where the base answers held-out trials better."""
        worse = self.point.reached.worse_than(self.base)
        if worse:
            raise WorseThanBase(
                f"adapted, it would be worse on trials held out: {'; '.join(worse)}",
                cause="labels that are wrong, or hand-overs that look like slips",
                next_step="correct the labels or record again; --force writes the file anyway",
            )

    def rows(self) -> FloatRows:
        """[N, F] features of all samples that a correction may change, to verify on."""
        return np.concatenate([one.features for one in self.streams])


def adapt(
    model: Model,
    person: DataSet,
    others_of: Callable[[], DataSet],
    say: Say = ignored,
    part: Part = ignored,
) -> Fitted:
    """Adapt a base model to a person. others_of: reads recordings with slips, of any person.

    Warns (ContradictedLabels) before anything is fitted. Raises TooLittleToAdapt; ChannelError,
    UnitError or RateError where a set does not fit.
    """
    counts = counts_of(person.recordings)
    require_enough(counts)
    others = others_of()
    require_slips(others)
    say(f"running the model on {count_of(counts.trials, 'trial')} of the person")
    of_person = streams_of(model, person, part)
    rules = model.card.decision
    against = contradicted(of_person, rules)
    warn_of_contradicted(against, len(of_person))
    slips = (
        f"{count_of(len(others.recordings), 'recording')} with slips ({others.name})"
    )
    say(f"running the model on {slips}")
    of_others = streams_of(model, others, part)
    say("fitting the correction, each trial held out in turn")
    in_all = votes_in_all(model.card.raw["heads"]["situation"])
    weights = label_weights(model)
    # Without a sample that may be called risky, only the decision's parameters can be adapted.
    has_rows = any(len(stream.row) for stream in of_person)
    base = base_figures(of_person, of_others, rules, weights)
    point = choose(of_person, of_others, rules, weights, in_all if has_rows else None)
    correction = correction_at(point, of_person, of_others, in_all)
    # Counts and figures only: no name of a person or a folder goes into a model file.
    about = {
        "person": asdict(counts),
        "others": {
            "recordings": len(of_others),
            "slips": sum(len(stream.recording.events) for stream in of_others),
        },
        "held_out": asdict(point.reached),
        "base_held_out": asdict(base),
    }
    adaptation = Adaptation(correction, point.rules, about)

    return Fitted(adaptation, point, base, against, [*of_person, *of_others])


# -- the operating point


def choose(
    person: Sequence[Stream],
    others: Sequence[Stream],
    base: DecisionRules,
    weights: LabelWeights,
    votes_in_all: int | None,
) -> OperatingPoint:
    """The operating point. votes_in_all: of the model; None for decision parameters alone."""
    trials = _Trials(person, others, base, weights)
    as_it_is: list[Correction | None] = [None] * FOLDS

    points: list[OperatingPoint] = []
    if votes_in_all is None:
        points += trials.points(as_it_is, None, FINER)
    else:
        fits = []
        for fold in range(FOLDS):
            seen = _without(person, fold)
            # A trial of the others must not judge a correction that has seen it either.
            seen_others = _without(others, fold)
            fits.append(fit_correction(seen, seen_others, votes_in_all))
        for nats in NATS:
            corrections = [moved(fit, nats) for fit in fits]
            points += trials.points(corrections, nats, PERMILLE)

    # The base itself, with its own threshold and duration, sets the recall to keep.
    before = base_figures(person, others, base, weights)
    least = min(LEAST_RECALL, before.recall)
    enough = [point for point in points if point.reached.recall >= least]
    # No point may keep the recall where the person's hand-overs look like slips.
    if not enough:
        return max(points, key=lambda point: point.reached.recall)

    return min(enough, key=_cost)


def base_figures(
    person: Sequence[Stream],
    others: Sequence[Stream],
    base: DecisionRules,
    weights: LabelWeights,
) -> HeldOutFigures:
    """What the base reaches on the same trials; it has seen none of them."""
    trials = _Trials(person, others, base, weights)
    as_it_is: list[Correction | None] = [None] * FOLDS
    (point,) = trials.points(as_it_is, None, (base.min_risky_permille,), (0,))
    return point.reached


def correction_at(
    point: OperatingPoint,
    person: Sequence[Stream],
    others: Sequence[Stream],
    votes_in_all: int,
) -> Correction | None:
    """The correction of an operating point, fitted on all trials; None without one."""
    if point.nats is None:
        return None
    return moved(fit_correction(person, others, votes_in_all), point.nats)


def _cost(point: OperatingPoint) -> tuple[float, ...]:
    reached = point.reached
    return reached.called_samples, -reached.before_gross_slip, -reached.recall


def _without(streams: Sequence[Stream], fold: int) -> list[Stream]:
    return [stream for k, stream in enumerate(streams) if k % FOLDS != fold]


@dataclass(frozen=True)
class _Trials:
    """The trials that operating points are judged on, and the rules that they start from."""

    person: Sequence[Stream]
    others: Sequence[Stream]
    base: DecisionRules
    weights: LabelWeights

    def points(
        self,
        corrections: Sequence[Correction | None],
        nats: float | None,
        permille: Sequence[int],
        longer: Sequence[int] = LONGER,
    ) -> Iterator[OperatingPoint]:
        """All thresholds and durations; corrections: for the trials of each fold."""
        answers = self._answers(self.person, corrections)
        # The person's trials come first, so that their samples can be counted alone.
        of_person = len(answers)
        answers += self._answers(
            self.others, corrections, only=lambda stream: bool(stream.recording.events)
        )

        for more in longer:
            # A threshold that is lower may need a run that is longer.
            rules = replace(self.base, act_samples=self.base.act_samples + more)
            # All thresholds of one duration in one pass: the decision is stepped once for all of
            # them.
            requests = act_requests(answers, rules, permille)
            for k, least in enumerate(permille):
                samples = _called_samples(answers[:of_person], rules, least)
                on_k = [on[:, k] for on in requests]
                reached = _reached(answers, on_k, samples, of_person)
                at_least = replace(rules, min_risky_permille=least)
                yield OperatingPoint(nats, at_least, reached)

    def _answers(
        self,
        streams: Sequence[Stream],
        corrections: Sequence[Correction | None],
        only: Callable[[Stream], bool] = lambda stream: True,
    ) -> list[Answers]:
        """Each trial's, by the correction that has not seen it."""
        answers = []
        for k, stream in enumerate(streams):
            if only(stream):
                correction = corrections[k % FOLDS]
                answers.append(corrected(stream, correction, self.weights))

        return answers


def _called_samples(
    answers: Sequence[Answers], rules: DecisionRules, permille: int
) -> int:
    """Samples that are risky, together with others, for as long as an act needs."""
    needed = np.ones(rules.act_samples)
    total = 0
    for one in answers:
        risky = (one.situation == RISKY_SLIP) & (one.risky_permille >= permille)
        # A run shorter than an act needs calls nothing, and does not count.
        lasting = np.convolve(risky, needed, "valid") >= len(needed)
        # The second convolution gives back all samples of every run that lasts.
        total += int((np.convolve(lasting, needed) > 0).sum())

    return total


def _reached(
    answers: Sequence[Answers],
    requests: Sequence[BoolArray],
    called_samples: int,
    of_person: int,
) -> HeldOutFigures:
    """Figures of slips, and of hand-overs in trials without one.

    of_person: how many answers, from the first, are the person's.
    """
    acted: list[bool] = []
    before: list[bool] = []
    called: list[bool] = []
    n_own = 0
    for k, (one, on) in enumerate(zip(answers, requests, strict=True)):
        for outcome in match_alarms(one.recording, on).outcomes:
            acted.append(outcome.alarm_s is not None)
            in_time = outcome.lead_s is not None and outcome.lead_s > 0.0
            before.append(acted[-1] and in_time)
        if k < of_person:
            n_own = len(acted)
        # In a trial with a slip an act request may be right, so its hand-overs do not count.
        if not one.recording.events:
            for action in voluntary_actions(one.recording):
                called.append(bool(on[action.first : action.stop].any()))

    return HeldOutFigures(
        recall=sum(acted) / max(1, len(acted)),
        before_gross_slip=sum(before) / max(1, len(before)),
        slips=n_own,
        found=sum(acted[:n_own]),
        hand_overs=len(called),
        called=sum(called),
        called_samples=called_samples,
    )


# -- what it needs


def require_enough(counts: PersonCounts) -> None:
    """Raise TooLittleToAdapt that says what to record."""
    missing = []
    if counts.hand_overs < LEAST_HAND_OVERS:
        missing.append(f"{counts.hand_overs} hand-overs of {LEAST_HAND_OVERS}")
    if counts.holding_s < LEAST_HOLDING_S:
        missing.append(f"{counts.holding_s:.0f} s of holding of {LEAST_HOLDING_S:.0f}")
    if missing:
        raise TooLittleToAdapt(
            " and ".join(missing),
            cause="an adaptation from less would follow chance; without a mark of the load onset "
            "a hand-over has no label",
            next_step="holdfast record --source URL --out DIR --person p01 --protocol "
            "simulation/cards/adapt.toml",
        )


def require_slips(others: DataSet) -> None:
    """Raise TooLittleToAdapt where the recordings that keep the recall have too few slips."""
    slips = sum(len(one.events) for one in others.recordings)
    if slips < LEAST_SLIPS:
        raise TooLittleToAdapt(
            f"{slips} risky slips of {LEAST_SLIPS} in {others.name}",
            cause="the correction must be shown what it has to keep",
            next_step="holdfast simulate thesis --trials 300 --seed 1 --out slips, then --slips "
            "slips",
        )


def of_person(data: DataSet, person: str) -> DataSet:
    """The recordings of a person; all of them where the set names no person. Raises UsageError."""
    people = sorted({one.person for one in data.recordings if one.person is not None})
    # A folder without people is taken as one person's recordings.
    if not people:
        return data
    if person not in people:
        raise UsageError(
            f"--person {person}: no recording in {data.name} is of this person",
            next_step=f"choose from {', '.join(people)}",
        )

    kept = [k for k, one in enumerate(data.recordings) if one.person == person]
    recordings = [data.recordings[k] for k in kept]
    tasks = {name: rows.of_trials(kept) for name, rows in data.tasks.items()}
    return replace(data, recordings=recordings, tasks=tasks)


def simulated_slips(
    card: ModelCard, trials: int = TRIALS, part: Part = ignored
) -> DataSet:
    """Trials of the thesis' protocol at the model's rate. Raises UsageError for another hand."""
    if card.unit != "N" or card.n_channels != 18:
        raise UsageError(
            "--slips is needed: scenes have six sensors in N, this model has "
            f"{card.n_channels // 3} in {card.unit}",
            next_step="--slips FOLDER, with recordings of pulls and falls by any person",
        )

    scene = Scene(read_scene_file(SCENE, rate_hz=card.rate_hz), SEED)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / SCENE

        def report(n: float) -> None:
            part(min(1.0, n / trials))

        write_set(scene, out, trials, report)
        # Read within the block: the folder is gone after it.
        return load(out, windows="none")
