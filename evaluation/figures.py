"""Figures of what was asked of the hand and of the states it was told, on whole streams; every one
a JSON object.

Shares of things that happen once a trial (a voluntary act, a hold) bear exact binomial intervals
(Clopper & Pearson, Biometrika 26, 1934): a bootstrap of a share of one says 1 to 1. Events and
false alarms bear bootstrap intervals over trials (or people), and over styles where there are
several.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest

from edge_runtime.contract import RISKY_SLIP, SITUATIONS, BoolArray
from edge_runtime.decision import UNKNOWN
from evaluation.camera import Seen, camera_figures
from evaluation.closing_hand import Droppable
from evaluation.event_scores import COLLAR_S, COLLARS_S, EventMatch, event_scores, match_alarms
from evaluation.model_outputs import NO_CLASS, ModelOutputs
from evaluation.scores import LEVELS, labels_at
from evaluation.truths import DISTURBANCES, Grasp, safe_acts, style_of
from training.metrics import Labels, situation_scores
from training.recording import Recording
from training.timeline import Phase

BINS = 15


@dataclass(frozen=True)
class LabelledTrial:
    """One recording with the grasps its truth tells of, and what a camera saw of it, without its
    samples."""

    recording: Recording
    grasps: tuple[Grasp, ...]
    seen: tuple[Seen, ...] = ()


def without_samples(recording: Recording) -> Recording:
    """The same recording, as light as its labels."""
    return replace(recording, samples=recording.samples[:0], valid=recording.valid[:0])


@dataclass(frozen=True)
class MethodResult:
    """One line of every table: what it asked of the hand in each recording.

    by_collar: collar in s -> the streams as they were heard. acts_called, holds: see below.
    """

    by_collar: dict[float, list[EventMatch]]
    acts_called: list[tuple[str, str, bool]]
    holds: list[tuple[str, bool, bool]]

    @property
    def matches(self) -> list[EventMatch]:
        """At the narrower collar, which every figure without a collar of its own uses."""
        return self.by_collar[COLLAR_S]

    def found(self) -> BoolArray:
        """[E] whether each event was found."""
        return np.array(
            [o.alarm_s is not None for one in self.matches for o in one.outcomes], dtype=np.bool_
        )

    def asked_s(self) -> list[float | None]:
        """[E] s from load onset to the alarm."""
        return [o.delay_s for one in self.matches for o in one.outcomes]


def line(told: Sequence[LabelledTrial], asked: Sequence[BoolArray]) -> MethodResult:
    """What was asked [T] of each recording, matched with its truth."""
    return MethodResult(
        {
            collar: [
                match_alarms(t.recording, on, collar) for t, on in zip(told, asked, strict=True)
            ]
            for collar in COLLARS_S
        },
        [act for t, on in zip(told, asked, strict=True) for act in _acts_called(t, on)],
        [hold for t, on in zip(told, asked, strict=True) for hold in _holds(t, on)],
    )


def _acts_called(told: LabelledTrial, asked: BoolArray) -> list[tuple[str, str, bool]]:
    """(style, action, asked at any sample of it) of every voluntary act."""
    of = style_of(told.grasps), told.recording.action or ""
    return [(*of, bool(asked[act.first : act.stop].any())) for act in safe_acts(told.recording)]


def _holds(told: LabelledTrial, asked: BoolArray) -> list[tuple[str, bool, bool]]:
    """(disturbance, held to the end, no alarm at all) of every disturbed hold."""
    kinds = [one.disturbance for one in told.grasps if one.disturbance]
    held, quiet = not told.recording.events, not bool(asked.any())
    return [(kind, held, quiet) for kind in kinds]


def together(lines: Sequence[MethodResult]) -> MethodResult:
    """Several sets as one."""
    return MethodResult(
        {collar: [one for part in lines for one in part.by_collar[collar]] for collar in COLLARS_S},
        [act for part in lines for act in part.acts_called],
        [hold for part in lines for hold in part.holds],
    )


def line_figures(
    of: MethodResult, told: Sequence[LabelledTrial], drops: Droppable | None, seed: int
) -> dict[str, Any]:
    """Everything a table says of a line."""
    figures = event_scores(of.matches, seed=seed)
    wide = event_scores(of.by_collar[COLLARS_S[1]], seed=seed)
    keys = (
        "recall",
        "recall_ci",
        "false_per_min",
        "false_per_min_ci",
        "already_on",
        "false_alarms",
    )
    figures["collar_40_ms"] = {key: wide[key] for key in keys}
    figures["by_style"] = by_style(of, told, seed)
    figures["safe_acts_called"] = share([called for *_, called in of.acts_called])
    actions = sorted({action for _, action, _ in of.acts_called})
    figures["safe_acts_by_action"] = {
        a: share([c for _, b, c in of.acts_called if a == b]) for a in actions
    }
    figures["specificity"] = specificity(of.holds)
    figures["closing"] = None if drops is None else drops.figures(of.asked_s())
    figures["camera"] = camera_figures(of.matches, [one.seen for one in told])
    return figures


def by_style(of: MethodResult, told: Sequence[LabelledTrial], seed: int) -> dict[str, Any] | None:
    """Recall and false alarms by style, and their intervals over styles; None without two
    styles."""
    styles = [style_of(one.grasps) for one in told]
    names = sorted(set(styles) - {""})
    if len(names) < 2:
        return None
    known = [(style, one) for style, one in zip(styles, of.matches, strict=True) if style]
    grouped = [replace(one, recording=replace(one.recording, group=style)) for style, one in known]
    whole = event_scores(grouped, seed=seed)
    each = {
        name: event_scores([one for style, one in known if style == name], seed=seed)
        for name in names
    }
    keys = ("events", "recall", "recall_ci", "false_per_min", "false_per_min_ci", "minutes")
    return {
        "recall_ci": whole["recall_ci"],
        "false_per_min_ci": whole["false_per_min_ci"],
        "styles": {
            name: {key: one[key] for key in keys}
            | {"safe_acts_called": share([c for style, _, c in of.acts_called if style == name])}
            for name, one in each.items()
        },
    }


def specificity(holds: Sequence[tuple[str, bool, bool]]) -> dict[str, Any] | None:
    """Disturbance -> share of the holds that held and brought no alarm; failed: those that did not
    hold."""
    if not holds:
        return None
    figures = {}
    for name in DISTURBANCES:
        here = [(held, quiet) for kind, held, quiet in holds if kind == name]
        figures[name] = share([quiet for held, quiet in here if held]) | {
            "failed": sum(not held for held, _ in here)
        }
    return figures


def share(hits: Sequence[bool]) -> dict[str, Any]:
    """share, its exact 95 % interval and n."""
    n = len(hits)
    if not n:
        return {"share": None, "share_ci": None, "n": 0}
    interval = binomtest(sum(hits), n).proportion_ci(0.95, method="exact")
    return {"share": sum(hits) / n, "share_ci": [float(interval.low), float(interval.high)], "n": n}


def mcnemar(ours: BoolArray, theirs: BoolArray) -> dict[str, Any]:
    """Events only one of two found, and how likely so uneven a split is where both are as good
    (exact, two-sided)."""
    only_ours, only_theirs = int((ours & ~theirs).sum()), int((theirs & ~ours).sum())
    n = only_ours + only_theirs
    return {
        "only_ours": only_ours,
        "only_theirs": only_theirs,
        "both": int((ours & theirs).sum()),
        "neither": int((~ours & ~theirs).sum()),
        "p": float(binomtest(only_ours, n, 0.5).pvalue) if n else 1.0,
    }


def state_line(said: Sequence[ModelOutputs], permille: int) -> list[EventMatch]:
    """The state itself as an alarm: risky_slip with at least so much confidence, without debounce
    or hold."""
    asked = [(one.situation == RISKY_SLIP) & (one.risky_permille >= permille) for one in said]
    return [
        match_alarms(without_samples(one.recording), on)
        for one, on in zip(said, asked, strict=True)
    ]


def state_figures(
    said: Sequence[ModelOutputs], permille: int, heavy: Sequence[bool | None], seed: int
) -> dict[str, Any]:
    """Delay to the first risky state, instability, calibration and confusion, per sample of every
    labelled phase.

    heavy: of each recording's object; None where there is none or nobody says.
    """
    delay = event_scores(state_line(said, permille), seed=seed)
    labels = [labels_everywhere(one.recording.phases, len(one.situation)) for one in said]
    return {
        "per": "sample of a labelled phase",
        "to_risky_state_ms": delay["delay_ms"],
        "risky_state_recall": delay["recall"],
        "safe_acts_state_called": share([hit for one in said for hit in _states_called(one)]),
        "unknown_share": _mean([one.situation == UNKNOWN for one in said]),
        "changes_per_s": instability([one.situation for one in said], said),
        "true_changes_per_s": instability(labels, said),
        "calibration": calibration(said, labels),
        "confusion": confusions(said, labels, heavy, seed),
    }


def labels_everywhere(phases: Sequence[Phase], n: int) -> npt.NDArray[np.int64]:
    """[T] the situation of every sample, UNKNOWN in no phase."""
    label = np.full(n, UNKNOWN)
    for phase in phases:
        label[phase.first : phase.stop] = phase.situation
    return label


def _states_called(said: ModelOutputs) -> list[bool]:
    acts = safe_acts(said.recording)
    return [bool((said.situation[act.first : act.stop] == RISKY_SLIP).any()) for act in acts]


def _mean(flags: Sequence[BoolArray]) -> float | None:
    return float(np.concatenate(flags).mean()) if flags else None


def instability(
    states: Sequence[npt.NDArray[np.int64]], said: Sequence[ModelOutputs]
) -> float | None:
    """Changes of state a second, from one known state to another."""
    changes, seconds = 0, 0.0
    for state, one in zip(states, said, strict=True):
        known = state[state != UNKNOWN]
        changes += int((np.diff(known) != 0).sum())
        seconds += len(known) / one.recording.rate_hz
    return changes / seconds if seconds else None


def calibration(
    said: Sequence[ModelOutputs], labels: Sequence[npt.NDArray[np.int64]]
) -> dict[str, Any] | None:
    """Expected calibration error of the most probable situation, and of risky_slip alone, in BINS
    equal bins.

    Guo et al., ICML 2017: sum over bins of their share of the samples times |mean probability -
    share that was so|.
    """
    asked = [
        (one.situation != UNKNOWN) & (label != UNKNOWN)
        for one, label in zip(said, labels, strict=True)
    ]
    p = np.concatenate(
        [one.p_situation[here] for one, here in zip(said, asked, strict=True)] or [np.zeros((0, 4))]
    )
    label = np.concatenate(
        [one[here] for one, here in zip(labels, asked, strict=True)] or [np.zeros(0, np.int64)]
    )
    if not len(p):
        return None
    top, risky = (
        _bins(p.max(axis=1), p.argmax(axis=1) == label),
        _bins(p[:, RISKY_SLIP], label == RISKY_SLIP),
    )
    return {
        "n": len(p),
        "bins": BINS,
        "ece": _ece(top),
        "ece_risky": _ece(risky),
        "reliability_risky": risky,
    }


def _bins(probability: npt.NDArray[Any], so: BoolArray) -> list[dict[str, float]]:
    place = np.minimum((BINS * probability).astype(np.int64), BINS - 1)
    counts = np.bincount(place, minlength=BINS)
    said, was = (np.bincount(place, weights=w, minlength=BINS) for w in (probability, so))
    full = zip(counts.tolist(), said.tolist(), was.tolist(), strict=True)
    return [{"n": n, "said": s / n, "was": w / n} for n, s, w in full if n]


def _ece(bins: list[dict[str, float]]) -> float:
    total = sum(one["n"] for one in bins)
    return sum(one["n"] / total * abs(one["said"] - one["was"]) for one in bins)


def confusions(
    said: Sequence[ModelOutputs],
    labels: Sequence[npt.NDArray[np.int64]],
    heavy: Sequence[bool | None],
    seed: int,
) -> dict[str, Any]:
    """Counts was (rows) by answered (columns, the last unknown), macro F1 and its interval over
    groups, by level.

    Eight and seven classes only where the model votes for eight and the object's weight is known.
    """
    groups = [one.recording.group for one in said]
    figures = {
        "four": _confusion(SITUATIONS, labels, [one.situation for one in said], groups, seed)
    }
    weighed = [
        k for k, one in enumerate(said) if heavy[k] is not None and (one.eight != NO_CLASS).any()
    ]
    if not weighed:
        return figures
    eight = [_weigh(labels[k], bool(heavy[k])) for k in weighed]
    seven = [np.where(label == UNKNOWN, UNKNOWN, labels_at(label, "seven")) for label in eight]
    groups = [groups[k] for k in weighed]
    figures["eight"] = _confusion(
        LEVELS["eight"], eight, [said[k].eight for k in weighed], groups, seed
    )
    figures["seven"] = _confusion(
        LEVELS["seven"], seven, [said[k].seven for k in weighed], groups, seed
    )
    return figures


def _confusion(
    classes: tuple[str, ...],
    truth: Sequence[Labels],
    answer: Sequence[Labels],
    group: Sequence[str],
    seed: int,
) -> dict[str, Any]:
    """truth, answer: [T] of each recording; samples without a label (below 0) are left out,
    withheld answers count."""
    n = len(classes)
    there = [label >= 0 for label in truth]
    was = np.concatenate([label[here] for label, here in zip(truth, there, strict=True)])
    answered = np.concatenate([label[here] for label, here in zip(answer, there, strict=True)])
    answered = np.where(answered < 0, n, answered)
    matrix = np.bincount((n + 1) * was + answered, minlength=n * (n + 1)).reshape(n, n + 1)
    groups = np.repeat(group, [int(here.sum()) for here in there])
    scores = situation_scores(was, answered, groups, classes=classes, seed=seed)
    return {"classes": [*classes, "unknown"], "counts": matrix.tolist(), **scores}


def _weigh(situation: npt.NDArray[np.int64], heavy: bool) -> npt.NDArray[np.int64]:
    return np.where(situation == UNKNOWN, UNKNOWN, 2 * situation + int(heavy))
