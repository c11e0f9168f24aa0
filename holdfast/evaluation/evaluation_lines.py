"""An evaluation as lines for people, with the caveats that belong to its figures."""

from __future__ import annotations

from collections.abc import Collection

from holdfast.core.contract import RISKY_SLIP, SITUATIONS, not_learned_in_words
from holdfast.core.errors import count_of
from holdfast.evaluation.formats import display_name, onsets_in_words
from holdfast.evaluation.methods import MethodFigures
from holdfast.evaluation.model_outputs import WindowFigures
from holdfast.evaluation.scored_set import Evaluation
from holdfast.training.figures import (
    HeadFigures,
    in_words,
    situation_lines,
    with_interval,
)

RISKY = SITUATIONS[RISKY_SLIP]


def evaluation_lines(of: Evaluation) -> list[str]:
    """The figures as lines for people, with the caveats that belong to them."""
    not_learned = of.model.cannot_tell
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
