"""A model file for one person from a short recording: a correction and when it acts.

The correction is fitted in turn without a part of all trials and answers that part. Among the
operating points that keep the recall on the others' slips, the one is taken that calls fewest of
the person's samples. (Eight hand-overs called or not are too coarse a measure to choose by.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.core.contract import RISKY_SLIP, BoolArray
from holdfast.core.errors import TooLittleToAdapt, UsageError, WorseThanBase, count_of
from holdfast.core.locked import require_open
from holdfast.core.progress import Stages
from holdfast.data.datasets import find, load
from holdfast.data.recording import DataSet
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import read_sealed, votes_in_all
from holdfast.evaluation.alarms import RecordingAnswers, act_requests, match_alarms
from holdfast.evaluation.trials import voluntary_actions
from holdfast.export.changed import adapted, is_adapted, undone, verify_adapted
from holdfast.export.exporting import write_model
from holdfast.export.verify import AdaptedVerification
from holdfast.sessions.adapt_evidence import (
    CandidateRows,
    LabelWeights,
    PersonCounts,
    corrected,
    counts_of,
    fit_correction,
    label_weights,
    streams_of,
    with_offset,
)
from holdfast.step.heads import Correction

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
NO_CORRECTION: tuple[None, ...] = (None,) * FOLDS


# -- when it acts


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

    def no_better_than(self, base: HeldOutFigures) -> list[str]:
        """In which ways they are worse, or that nothing is better; empty where they are better."""
        better = self.called < base.called or self.found > base.found
        better |= self.recall > base.recall + MOST_RECALL_LOST
        if better or self.worse_than(base):
            return self.worse_than(base)
        called = f"{self.called} of {self.hand_overs} voluntary actions called"
        recall = f"recall {self.recall:.3f}"
        return [
            f"nothing is better: {called}, {recall}, by the base {base.called} and "
            f"{base.recall:.3f}"
        ]


@dataclass(frozen=True)
class OperatingPoint:
    """nats: how far the correction's logit is moved, None without a correction."""

    nats: float | None
    rules: DecisionRules
    reached: HeldOutFigures


@dataclass(frozen=True)
class PersonEvidence:
    """A person's trials and those of other slips; rules, weights and votes of the base."""

    person: Sequence[CandidateRows]
    others: Sequence[CandidateRows]
    rules: DecisionRules
    weights: LabelWeights
    votes_in_all: int

    def choose(self, *, threshold_only: bool = False) -> OperatingPoint:
        """The operating point. threshold_only: the decision's parameters without a correction."""
        points: list[OperatingPoint] = []
        if threshold_only:
            points += self._points(NO_CORRECTION, None, FINER)
        else:
            fits = [self._fitted_without(fold) for fold in range(FOLDS)]
            for nats in NATS:
                corrections = [with_offset(fit, nats) for fit in fits]
                points += self._points(corrections, nats, PERMILLE)

        # The base itself sets the recall to keep.
        least = min(LEAST_RECALL, self.base_figures().recall)
        enough = [point for point in points if point.reached.recall >= least]
        # No point may keep the recall where the person's hand-overs look like slips.
        if not enough:
            return max(points, key=lambda point: point.reached.recall)
        return min(enough, key=_cost)

    def base_figures(self) -> HeldOutFigures:
        """What the base reaches on the same trials; it has seen none of them."""
        own = (self.rules.min_risky_permille,)
        (point,) = self._points(NO_CORRECTION, None, own, (0,))
        return point.reached

    def correction(self, point: OperatingPoint) -> Correction | None:
        """The correction of an operating point, fitted on all trials; None without one."""
        if point.nats is None:
            return None
        fitted = fit_correction(self.person, self.others, self.votes_in_all)
        return with_offset(fitted, point.nats)

    def _fitted_without(self, fold: int) -> Correction:
        """A trial of the others must not judge a correction that has seen it either."""
        seen = [one for k, one in enumerate(self.person) if k % FOLDS != fold]
        seen_others = [one for k, one in enumerate(self.others) if k % FOLDS != fold]
        return fit_correction(seen, seen_others, self.votes_in_all)

    def _points(
        self,
        corrections: Sequence[Correction | None],
        nats: float | None,
        permille: Sequence[int],
        longer: Sequence[int] = LONGER,
    ) -> Iterator[OperatingPoint]:
        """All thresholds and durations; corrections: for the trials of each fold."""
        # The person's trials come first, so that their samples can be counted alone.
        answers = self._answers(self.person, corrections)
        of_person = len(answers)
        for one in self._answers(self.others, corrections):
            if one.recording.events:
                answers.append(one)

        for more in longer:
            # A threshold that is lower may need a run that is longer.
            rules = replace(self.rules, act_samples=self.rules.act_samples + more)
            # All thresholds of one duration in one pass: the decision is stepped once for all of
            # them.
            requests = act_requests(answers, rules, permille)
            for k, least in enumerate(permille):
                samples = _called_samples(answers[:of_person], rules, least)
                reached = _reached(
                    answers, [on[:, k] for on in requests], samples, of_person
                )
                at_least = replace(rules, min_risky_permille=least)
                yield OperatingPoint(nats, at_least, reached)

    def _answers(
        self, streams: Sequence[CandidateRows], corrections: Sequence[Correction | None]
    ) -> list[RecordingAnswers]:
        """Each trial's, by the correction that has not seen it."""
        answers = []
        for k, stream in enumerate(streams):
            answers.append(corrected(stream, corrections[k % FOLDS], self.weights))
        return answers


def _cost(point: OperatingPoint) -> tuple[float, ...]:
    reached = point.reached
    return reached.called_samples, -reached.before_gross_slip, -reached.recall


def _called_samples(
    answers: Sequence[RecordingAnswers], rules: DecisionRules, permille: int
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
    answers: Sequence[RecordingAnswers],
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


# -- the file


@dataclass(frozen=True)
class AdaptedFile:
    """What an adaptation was fitted on, and reaches beside its base on the same trials."""

    person: PersonCounts
    point: OperatingPoint
    base: HeldOutFigures
    verified: AdaptedVerification


def adapt_file(
    model_path: Path,
    data: str,
    person: str,
    slips: str,
    out: Path,
    begin: Stages,
    *,
    worse_too: bool = False,
) -> AdaptedFile:
    """Fit, build, verify and write. slips: recordings with slips, of any person.

    worse_too: write a file that is worse than
    its base too; else it raises WorseThanBase. Raises TooLittleToAdapt; UsageError for a file that
    is adapted already; ChannelError, UnitError or RateError where a set does not fit.
    """
    base = read_sealed(model_path)
    # Corrections do not stack.
    if is_adapted(base):
        raise UsageError(
            f"{model_path} is adapted already",
            next_step=f"holdfast adapt {model_path} --undo --out base.onnx, and adapt that",
        )
    model = Model(model_path)
    begin("reading the person's recordings")
    own = of_person(_read(data, model), person)
    counts = counts_of(own.recordings)
    require_enough(counts)
    begin(f"reading {slips}")
    others = _read(slips, model)
    require_slips(others)
    begin(f"running the model on {count_of(counts.trials, 'trial')} of the person")
    of_own = streams_of(model, own, begin.part)
    rules = model.card.decision
    n_others = count_of(len(others.recordings), "recording")
    begin(f"running the model on {n_others} with slips ({others.name})")
    of_others = streams_of(model, others, begin.part)

    begin("fitting the correction, each trial held out in turn")
    in_all = votes_in_all(model.card.raw["heads"]["situation"])
    evidence = PersonEvidence(of_own, of_others, rules, label_weights(model), in_all)
    # Without a sample that may be called risky, only the decision's parameters can be adapted.
    point = evidence.choose(threshold_only=not any(len(one.row) for one in of_own))
    of_base = evidence.base_figures()
    worse = point.reached.no_better_than(of_base)
    if worse and not worse_too:
        raise WorseThanBase(
            f"adapted, it would be no better on trials held out: {'; '.join(worse)}",
            cause="the base knows this person already, labels that are wrong, or hand-overs that "
            "look like slips",
            next_step="correct the labels or record again; --force writes the file anyway",
        )

    begin("building, verifying and sealing the file")
    # Counts and figures only: no name of a person or a folder goes into a model file.
    about = {
        "person": asdict(counts),
        "others": {
            "recordings": len(of_others),
            "slips": sum(len(stream.recording.events) for stream in of_others),
        },
        "held_out": asdict(point.reached),
        "base_held_out": asdict(of_base),
    }
    correction = evidence.correction(point)
    made = adapted(base, correction, point.rules, about)
    rows = np.concatenate([one.features for one in (*of_own, *of_others)])
    # Before it is written: a file that fails is never on the disk.
    verified = verify_adapted(base, made, correction, rows)
    write_model(out, made)
    return AdaptedFile(counts, point, of_base, verified)


def write_base(adapted_path: Path, out: Path) -> None:
    """The base of an adapted file, byte for byte."""
    write_model(out, undone(read_sealed(adapted_path), adapted_path))


# -- recordings


def _read(name: str, model: Model) -> DataSet:
    """The recordings of a set or folder. Raises SetLocked for a set that is kept for tests."""
    require_open(find(name), "a correction", styles=False)
    card = model.card
    return load(
        name,
        channels=card.n_channels,
        rate_hz=card.rate_hz,
        windows="none",
    )


def require_slips(others: DataSet) -> None:
    """Raise TooLittleToAdapt for recordings with too few slips to keep the recall by."""
    n_slips = sum(len(one.events) for one in others.recordings)
    if n_slips < LEAST_SLIPS:
        raise TooLittleToAdapt(
            f"{n_slips} risky slips of {LEAST_SLIPS} in {others.name}",
            cause="the correction must be shown what it has to keep",
            next_step="holdfast simulate thesis --trials 300 --seed 1 --out slips, then --slips "
            "slips",
        )


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


def of_person(data: DataSet, person: str) -> DataSet:
    """The recordings of a person; all of them where the set names no person. Raises UsageError."""
    people = sorted({one.person for one in data.recordings if one.person is not None})
    # A folder without people is taken as one person's recordings.
    if not people:
        return data
    kept = [one for one in data.recordings if one.person == person]
    if not kept:
        raise UsageError(
            f"--person {person}: no recording in {data.name} is of this person",
            next_step=f"choose from {', '.join(people)}",
        )
    return replace(data, recordings=kept, tasks={})
