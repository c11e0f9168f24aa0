"""Scores at windows: macro F1, what an observer that is late would reach, objects left out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from sklearn.metrics import f1_score

from holdfast.core.reading import Json
from holdfast.evaluation.trials import LabelledTrial
from holdfast.export.network import IntArray
from studies.fast_handover.ideas import Idea
from studies.fast_handover.sets import Labelled, Streams, without


def macro_f1(streams: Streams, situation: IntArray, past_s: float = 0.0) -> float:
    """Over the situations in the truth, at the windows at least past_s after a change of phase."""
    kept = np.concatenate(
        [
            _since_change_s(one, n)
            for one, n in zip(streams.trials, streams.lengths, strict=True)
        ]
    )
    there = kept[streams.row] >= past_s
    return _macro_f1(streams.label[there], situation[streams.row[there]])


def _macro_f1(truth: IntArray, answered: IntArray) -> float:
    return float(f1_score(truth, answered, labels=np.unique(truth), average="macro"))


def _since_change_s(trial: LabelledTrial, n: int) -> npt.NDArray[np.float64]:
    """[T] s since the last change of phase."""
    since = np.full(n, np.inf)
    for phase in trial.recording.phases:
        since[phase.first : phase.stop] = (
            np.arange(phase.stop - phase.first) / trial.recording.rate_hz
        )
    return since


def bounds(streams: Streams) -> list[Json]:
    """Macro F1 of an observer that knows the truth, but some samples late, on the same windows."""
    starts = np.repeat(np.cumsum([0, *streams.lengths[:-1]]), streams.lengths)
    rows = []
    for late in range(5):
        seen = streams.truth[np.maximum(np.arange(len(starts)) - late, starts)]
        ms_late = 1e3 * late / streams.trials[0].recording.rate_hz
        f1 = macro_f1(streams, seen)
        rows.append({"samples_late": late, "ms_late": ms_late, "f1_author": f1})
    return rows


def objects_left_out(
    idea: Idea, part: Labelled, streams: Streams, seed: int
) -> dict[str, float]:
    """Object -> macro F1 on its windows from a learner trained without it."""
    objects = np.repeat(
        [one.recording.object_name or "" for one in streams.trials], streams.lengths
    )[streams.row]
    scores = {}
    for name in sorted(set(objects.tolist()) - {""}):
        learner = idea.learner()
        kept = without(part, name)
        learner.fit(kept.features, kept.label, seed)
        here = objects == name
        answered = learner.answer(np.asarray(streams.features[streams.row[here]]))[0]
        scores[name] = _macro_f1(streams.label[here], answered)
    return scores
