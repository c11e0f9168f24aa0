"""The states of the model on whole streams: delay, stability, calibration and confusion.

Everything counts samples of labelled phases, in natural proportion. A state is the answer to a
single sample, before the decision's debounce and hold.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import RISKY_SLIP, SITUATIONS, BoolArray
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.alarms import EventMatch, event_scores, match_alarms
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.evaluation.statistics import Spread, share
from holdfast.evaluation.trials import voluntary_actions, without_samples
from holdfast.training.figures import Interval, Share
from holdfast.training.metrics import situation_scores
from holdfast.training.timeline import Phase

BINS = 15
"""Equal bins of the probability, as in Guo et al. (ICML 2017)."""
States = npt.NDArray[np.int64]
"""[T] a situation at every sample; below 0 where there is none."""


@dataclass(frozen=True)
class CalibrationBin:
    """n samples in a bin. said: mean predicted probability. was: share that came true."""

    n: int
    said: float
    was: float


@dataclass(frozen=True)
class CalibrationFigures:
    """Expected calibration error of the most probable situation, and of risky_slip alone."""

    n: int
    bins: int
    ece: float
    ece_risky: float
    reliability_risky: list[CalibrationBin]


@dataclass(frozen=True)
class ConfusionFigures:
    """counts: truth (rows) by answer (columns, the last unknown); F1 with intervals over groups."""

    classes: tuple[str, ...]
    counts: list[list[int]]
    macro_f1: float | None
    macro_f1_ci: Interval | None
    f1: dict[str, float | None]
    f1_ci: dict[str, Interval | None]


@dataclass(frozen=True)
class StateFigures:
    """Everything a report shows of the states. confusion: of the four situations, as "four"."""

    per: str
    to_risky_state_ms: Spread | None
    risky_state_recall: float | None
    safe_acts_state_called: Share
    unknown_share: float | None
    changes_per_s: float | None
    true_changes_per_s: float | None
    calibration: CalibrationFigures | None
    confusion: dict[str, ConfusionFigures]


def risky_states(outputs: Sequence[ModelOutputs], permille: int) -> list[EventMatch]:
    """The state itself as an alarm: risky_slip with this confidence, without debounce or hold."""
    matches = []
    for one in outputs:
        # The same confidence as the decision's, so that both differ by debounce and hold alone.
        confident = one.risky_permille >= permille
        risky = (one.situation == RISKY_SLIP) & confident
        matches.append(match_alarms(without_samples(one.recording), risky))
    return matches


def state_figures(
    outputs: Sequence[ModelOutputs],
    permille: int,
    seed: int,
    untold: Collection[str] = (),
) -> StateFigures:
    """All figures of the states. untold: situations that the model cannot tell."""
    # Matched like alarms, so the state's delay compares with that of the request.
    delay = event_scores(risky_states(outputs, permille), seed=seed)
    states = [one.situation for one in outputs]
    labels = []
    called = []
    for one in outputs:
        # Between labelled phases there is no truth: these samples count nowhere.
        labels.append(labels_everywhere(one.recording.phases, len(one.situation)))
        for action in voluntary_actions(one.recording):
            # One risky sample is enough: it would be shown to the wearer.
            during = one.situation[action.first : action.stop]
            called.append(bool((during == RISKY_SLIP).any()))

    unknown_share = None
    if states:
        # Of all samples, also those between labelled phases: an unknown state helps at none.
        is_unknown = np.concatenate(states) == UNKNOWN
        unknown_share = float(is_unknown.mean())

    return StateFigures(
        per="sample of a labelled phase",
        to_risky_state_ms=delay.delay_ms,
        risky_state_recall=delay.recall,
        safe_acts_state_called=share(called),
        unknown_share=unknown_share,
        changes_per_s=changes_per_s(states, outputs),
        true_changes_per_s=changes_per_s(labels, outputs),
        calibration=calibration(outputs, labels),
        confusion={"four": confusion(outputs, labels, seed, untold)},
    )


def labels_everywhere(phases: Sequence[Phase], n: int) -> States:
    """[T] the situation of every sample, UNKNOWN in no phase."""
    label = np.full(n, UNKNOWN)
    for phase in phases:
        label[phase.first : phase.stop] = phase.situation
    return label


def changes_per_s(
    states: Sequence[States], outputs: Sequence[ModelOutputs]
) -> float | None:
    """Changes a second from one known state to another."""
    changes = 0
    seconds = 0.0
    for state, one in zip(states, outputs, strict=True):
        # A state that comes back after an unknown stretch has not changed.
        known = state[state != UNKNOWN]
        changes += int((np.diff(known) != 0).sum())
        seconds += len(known) / one.recording.rate_hz

    return changes / seconds if seconds else None


def calibration(
    outputs: Sequence[ModelOutputs], labels: Sequence[States]
) -> CalibrationFigures | None:
    """Calibration in BINS equal bins; None without a sample that has an answer and a label.

    Guo et al., ICML 2017: sum over bins of their share of the samples times |mean probability -
    share that came true|.
    """
    # Without a recording there is nothing to join.
    if not outputs:
        return None
    state = np.concatenate([one.situation for one in outputs])
    p = np.concatenate([one.p_situation for one in outputs])
    label = np.concatenate(labels)

    answered = (state != UNKNOWN) & (label != UNKNOWN)
    p = p[answered]
    label = label[answered]
    if not len(p):
        return None

    right = p.argmax(axis=1) == label
    top = _bins(p.max(axis=1), right)
    # Apart: risky slips are rare, and would hardly show among the most probable situations.
    risky = _bins(p[:, RISKY_SLIP], label == RISKY_SLIP)

    return CalibrationFigures(
        n=len(p),
        bins=BINS,
        ece=_ece(top),
        ece_risky=_ece(risky),
        reliability_risky=risky,
    )


def _bins(
    probability: npt.NDArray[np.float32], true: BoolArray
) -> list[CalibrationBin]:
    # A probability of exactly 1 belongs to the last bin.
    bin_of = (BINS * probability).astype(np.int64)
    place = np.minimum(bin_of, BINS - 1)

    counts = np.bincount(place, minlength=BINS)
    said = np.bincount(place, weights=probability, minlength=BINS)
    was = np.bincount(place, weights=true, minlength=BINS)
    bins = []
    for k in np.flatnonzero(counts).tolist():
        n = int(counts[k])
        mean_said = float(said[k]) / n
        share_true = float(was[k]) / n
        bins.append(CalibrationBin(n, mean_said, share_true))

    return bins


def _ece(bins: list[CalibrationBin]) -> float:
    total = sum(one.n for one in bins)
    error = 0.0
    for one in bins:
        # Weighted by samples: a nearly empty bin hardly counts.
        error += one.n / total * abs(one.said - one.was)
    return error


def confusion(
    outputs: Sequence[ModelOutputs],
    labels: Sequence[States],
    seed: int,
    untold: Collection[str] = (),
) -> ConfusionFigures:
    """Count the truth against the answer over all recordings, and score it.

    Samples without a label (below 0) are left out; withheld answers count.
    """
    n = len(SITUATIONS)
    was = np.concatenate(labels)
    answered = np.concatenate([one.situation for one in outputs])
    lengths = [len(label) for label in labels]
    # The interval draws whole groups, since samples of one recording are alike.
    groups = np.repeat([one.recording.group for one in outputs], lengths)

    labelled = was >= 0
    was = was[labelled]
    answered = answered[labelled]
    groups = groups[labelled]
    # A withheld answer has a column of its own, and misses whatever was there.
    answered = np.where(answered < 0, n, answered)
    pair = (n + 1) * was + answered
    cells = np.bincount(pair, minlength=n * (n + 1))

    scores = situation_scores(
        was, answered, groups, classes=SITUATIONS, untold=untold, seed=seed
    )

    return ConfusionFigures(
        classes=(*SITUATIONS, "unknown"),
        counts=cells.reshape(n, n + 1).tolist(),
        macro_f1=scores.macro_f1,
        macro_f1_ci=scores.macro_f1_ci,
        f1=scores.f1,
        f1_ci=scores.f1_ci,
    )
