"""The reports of an evaluation and of a training run: their pictures, and what templates show.

The templates are templates/evaluation.html and templates/training.html; the order of a template's
sections is the order of its report.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.errors import count_of
from holdfast.evaluation import pictures as draw
from holdfast.evaluation.formats import DEPLOYED, LAWS, ORACLE, onsets_in_words
from holdfast.evaluation.html import write_page
from holdfast.evaluation.pictures import trial
from holdfast.evaluation.scored_set import Evaluation
from holdfast.evaluation.style import labelled, svg
from holdfast.evaluation.trials import AnsweredTrial, LabelledTrial, central_trial
from holdfast.export.spec import window_samples
from holdfast.training.crossval import main_task
from holdfast.training.figures import PLURAL, Interval, in_words
from holdfast.training.fitting import Trained
from holdfast.training.judging import CurvePoint, per_doubling
from holdfast.training.recording import DataSet


def write_event_report(path: Path, evaluation: Evaluation) -> Path:
    """Write the report of an evaluation; OutputError where that cannot be done."""
    of = evaluation
    headline = evaluation.thresholds.headline
    kind = kind_of(of)
    return write_page(
        path,
        "evaluation.html",
        of=of,
        kind=kind,
        headline=headline,
        deployed=DEPLOYED,
        oracle=ORACLE,
        laws=LAWS,
        ours=of.rows[headline],
        parts=_parts(of),
        cards={name: one.card for name, one in of.sets.items()},
        least_events=draw.LEAST_EVENTS,
        plural=PLURAL,
        timelines={
            title: draw.timelines(rows, kind) for title, rows in of.drawn.items()
        },
        central_picture=draw.trial(of.central, kind) if of.central else "",
        distributions=draw.distributions(of.times, kind),
        calibration=_calibration(of, kind),
        onsets_in_words=onsets_in_words,
    )


def kind_of(of: Evaluation) -> str:
    """The kind of the data (simulated, recorded), which stands next to every number."""
    kinds = [one.card.kind for one in of.sets.values()]
    # Each kind once, in the order of the sets.
    return ", ".join(dict.fromkeys(kinds))


def _parts(of: Evaluation) -> dict[str, Any]:
    """Title -> what has rows and comparisons: all sets together, then each set."""
    # All sets together are the same as the only one.
    if len(of.sets) == 1:
        return dict(of.sets)
    return {"all sets": of, **of.sets}


def _calibration(of: Evaluation, kind: str) -> str:
    """The picture of every set's calibration; a set without labelled samples has none."""
    bins = {}
    for name, one in of.sets.items():
        if one.states.calibration:
            bins[name] = one.states.calibration.reliability_risky
    return draw.reliability(bins, kind) if bins else ""


NOT_ANSWERED = -2
"""At samples in no window that was scored; no state has this number."""


def write_training_report(
    path: Path, data: DataSet, trained: Trained, artifact: Path
) -> Path:
    """Write the report; OutputError where that cannot be done."""
    figures = trained.figures
    points = trained.curve
    kind = figures.group_kind
    # A joined set may be held out by several kinds.
    groups = PLURAL.get(kind, "groups")
    n_groups = count_of(figures.n_groups, "group")
    if kind in PLURAL:
        n_groups = in_words(figures.n_groups, kind)

    curve = ""
    if trained.curve:
        curve = _curve(points, data.kind, groups)

    central = held_out_trial(data, trained)
    return write_page(
        path,
        "training.html",
        data=data,
        figures=figures,
        situations=figures.situations,
        not_learned=trained.cannot_tell,
        held_out_by=kind,
        not_held_out=trained.not_held_out,
        groups=groups,
        n_groups=n_groups,
        curve=curve,
        central=central,
        central_picture=trial(central, data.kind) if central else "",
        points=points,
        gain=per_doubling(points),
        artifact=artifact,
    )


def held_out_trial(data: DataSet, trained: Trained) -> AnsweredTrial | None:
    """A trial with its held-out answers, those at the windows that were scored."""
    task = data.tasks[main_task(data)]
    answers = trained.held_out.situations()

    rows: list[AnsweredTrial] = []
    for k, recording in enumerate(data.recordings):
        if not recording.phases:
            continue
        situation = np.full(len(recording.samples), NOT_ANSWERED)
        length = window_samples(recording.rate_hz)
        of_trial = np.flatnonzero(task.trial == k)
        for window in of_trial[np.argsort(task.row[of_trial])].tolist():
            # an answer is there at the end of its window, and is drawn for as long after it
            row = int(task.row[window])
            situation[row : row + length] = answers[window]
        no_requests = np.zeros(len(situation), dtype=np.bool_)
        rows.append(AnsweredTrial(LabelledTrial(recording, {}), situation, no_requests))
    return central_trial({"": rows}, data.recordings)


def _curve(points: list[CurvePoint], kind: str, groups: str) -> str:
    """Held-out macro F1 by the training data, with intervals."""
    with labelled(kind, 5.2, 3.0) as figure:
        axes = figure.subplots()
        x, y = [], []
        for point in points:
            if point.macro_f1 is None:
                continue
            x.append(point.n_trials)
            y.append(point.macro_f1)
            low, high = _ends(point.macro_f1_ci, point.macro_f1)
            axes.plot([point.n_trials] * 2, [low, high], color="#0072b2", alpha=0.4)
        axes.plot(x, y, "o-", color="#0072b2", markersize=4)
        axes.set(xlabel=f"trials of the {groups}", ylabel="macro F1, held out")
        axes.set_ylim(0.0, 1.02)
        return svg(figure)


def _ends(interval: Interval | None, value: float) -> Interval:
    """An interval, or the value itself where there is none."""
    return interval or (value, value)
