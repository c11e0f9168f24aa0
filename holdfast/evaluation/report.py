"""The reports of an evaluation and of a training run: their pictures, and what templates show.

The templates are templates/evaluation.html and templates/training.html; the order of a template's
sections is the order of its report.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import RISKY_SLIP, SITUATIONS, not_learned_in_words
from holdfast.core.errors import count_of
from holdfast.data.metrics import (
    PLURAL,
    HeadFigures,
    in_words,
    situation_lines,
    with_interval,
)
from holdfast.data.recording import DataSet
from holdfast.evaluation import pictures as draw
from holdfast.evaluation.formats import (
    DEPLOYED,
    LAWS,
    ORACLE,
    display_name,
    onsets_in_words,
)
from holdfast.evaluation.methods import MethodFigures
from holdfast.evaluation.model_outputs import WindowFigures
from holdfast.evaluation.scored_set import Evaluation
from holdfast.evaluation.style import labelled, svg, write_page
from holdfast.evaluation.trials import AnsweredTrial, LabelledTrial, central_trial
from holdfast.step.spec import window_samples
from holdfast.training.crossval import main_task
from holdfast.training.fitting import TrainedModel
from holdfast.training.judging import CurvePoint

# An evaluation as lines for people, with the caveats that belong to its figures.

RISKY = SITUATIONS[RISKY_SLIP]


def evaluation_lines(of: Evaluation) -> list[str]:
    """The figures as lines for people, with the caveats that belong to them."""
    not_learned = of.model.not_learned
    lines: list[str] = []
    for one in of.sets.values():
        lines += _windows_in_words(one.windows, not_learned)
    lines += not_learned_in_words(not_learned)

    headline = of.thresholds.headline
    rows = {name: one.rows[headline] for name, one in of.sets.items()}
    # Of one set, all sets together would be the same line again.
    if len(rows) > 1:
        rows["all sets"] = of.rows[headline]
    for name, row in rows.items():
        # Requests of such a model answer something else than a risky slip.
        if RISKY in not_learned:
            lines.append(f"{name}: cannot tell risky slip, so no event can be found")
            continue
        if name in of.sets and not of.sets[name].card.timed:
            requests = (
                f"none of {count_of(row.false_alarms, 'request')} to act is judged"
            )
            lines.append(f"{name}: no label has a time, so {requests}")
            continue
        lines.append(_events_in_words(f"{name}, {display_name(headline)}", row))
        lines += _kinds_in_words(name, row)

    for name, one in of.sets.items():
        onsets = onsets_in_words(one.card.onsets_by)
        if onsets:
            lines.append(f"{name}: {onsets}")

    return [*lines, f"threshold: {of.thresholds.how()}"]


def _events_in_words(name: str, row: MethodFigures) -> str:
    # Without an event there is no recall, and the false alarms are all there is to report.
    if not row.events:
        alarms = count_of(row.false_alarms, "false alarm")
        return f"{name}: no risky event; {alarms} in {row.minutes:.1f} min"
    delay = row.delay_ms
    when = f", act {delay.p50:.0f} ms after load onset (median)" if delay else ""
    return (
        f"{name}: recall {row.found} of {count_of(row.events, 'risky event')}{when}; "
        f"{row.false_per_min:.2f} false alarms a minute in {row.minutes:.1f} min"
    )


def _kinds_in_words(name: str, row: MethodFigures) -> list[str]:
    """Events acted on before gross slip, of all actions and of each; nothing without an event."""
    if not row.with_enough_time.in_time.n or len(row.by_action) < 2:
        return []
    kinds = {"all actions": row.with_enough_time, **row.by_action}
    lines = [f"{name}, slips of 15 ms and more that were acted on before gross slip:"]
    for kind, figures in kinds.items():
        in_time = figures.in_time
        if in_time.n:
            acted = round((in_time.share or 0.0) * in_time.n)
            lines.append(f"  {kind:<12} {acted} of {in_time.n}")
    return lines


def _windows_in_words(
    figures: WindowFigures, not_learned: Collection[str]
) -> list[str]:
    heads = figures.heads
    kind = heads.group_kind
    trials = _trials_in_words(heads)
    lines = [f"{figures.data} ({figures.kind}): {trials}"]
    # Before the figures: a reader who stops at the first must not take it for a judgement.
    lines += _warnings(figures)
    lines += situation_lines(heads.situations, kind, not_learned)

    ahead = heads.predict_250ms
    if ahead is not None:
        auc = with_interval(ahead.auc, ahead.auc_ci, kind)
        precision = with_interval(
            ahead.average_precision, ahead.average_precision_ci, kind
        )
        lines.append(f"0.25 s prediction: AUC          {auc}")
        lines.append(f"  average precision {precision}")

    return [*lines, figures.caveat]


def _warnings(figures: WindowFigures) -> list[str]:
    """What makes the figures of a set better or worse than they look."""
    warnings = []
    if figures.unknown_windows:
        warnings.append(
            f"WARNING: the state is unknown at {count_of(figures.unknown_windows, 'window')} (lost "
            "or unsettled sensors); they count as misses."
        )

    if figures.trained_on_recordings:
        warnings.append(
            f"WARNING: the model was trained on {figures.trained_on_recordings} of these "
            f"{count_of(figures.heads.n_trials, 'recording')}; these figures flatter it. "
            "Held-out figures are in its card, and in the report of holdfast train --report."
        )

    return warnings


def _trials_in_words(of: HeadFigures) -> str:
    trials = in_words(of.n_trials, "trial")
    if of.group_kind == "trial":
        return trials
    return f"{trials}, {in_words(of.n_groups, of.group_kind)}"


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
        central_picture=_drawn(of.central, kind),
        distributions=draw.distributions(of.times, kind),
        calibration=_calibration(of, kind),
        onsets_in_words=onsets_in_words,
    )


def _drawn(central: AnsweredTrial | None, kind: str) -> str:
    return draw.trial(central.trial.recording, kind, central) if central else ""


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
    path: Path, data: DataSet, trained: TrainedModel, artifact: Path
) -> Path:
    """Write the report; OutputError where that cannot be done."""
    figures = trained.figures
    points = trained.curve
    kind = figures.group_kind
    # A joined set may be held out by several kinds.
    groups = PLURAL.get(kind, "groups")
    n_groups = count_of(figures.n_groups, kind if kind in PLURAL else "group", groups)

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
        curve=_curve(points, data.kind, groups) if points else "",
        central=central,
        central_picture=_drawn(central, data.kind),
        points=points,
        artifact=artifact,
    )


def held_out_trial(data: DataSet, trained: TrainedModel) -> AnsweredTrial | None:
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
            if point.macro_f1_ci:
                axes.vlines(x[-1], *point.macro_f1_ci, color="#0072b2", alpha=0.4)
        axes.plot(x, y, "o-", color="#0072b2", markersize=4)
        axes.set(xlabel=f"trials of the {groups}", ylabel="macro F1, held out")
        axes.set_ylim(0.0, 1.02)
        return svg(figure)
