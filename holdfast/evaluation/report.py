"""The report of one evaluation: answer, trials over time, tables beside baselines, limits."""

from __future__ import annotations

import html
from pathlib import Path

from holdfast.evaluation import pictures as draw
from holdfast.evaluation.closing_hand import KeptObjects
from holdfast.evaluation.figures import Evaluation
from holdfast.evaluation.formats import interval, number, percent, percent_interval
from holdfast.evaluation.methods import MethodFigures
from holdfast.evaluation.page import (
    DEPLOYED,
    ORACLE,
    key,
    median,
    p_cell,
    shown,
    write_page,
)
from holdfast.evaluation.real_sets import RealFigures, RealSetsMissing
from holdfast.evaluation.report_data import (
    SIMULATED,
    data_section,
    how_made,
    real_section,
)
from holdfast.evaluation.report_methods import (
    actions_section,
    camera_section,
    methods_section,
)
from holdfast.evaluation.report_parts import heading, kind_of
from holdfast.evaluation.report_states import (
    closing_section,
    outcomes_section,
    states_section,
)
from holdfast.evaluation.style import SITUATION_COLOURS
from holdfast.training.splits import PLURAL

CLOSE = """<style>table.close th{white-space:normal} table.close .note{font-size:.7rem}
table.close td{vertical-align:top}
table.close th,table.close td{padding:.3rem} table.close td:first-child{min-width:7rem}
.answer{gap:2rem}</style>"""
"""Wide tables: heads may break, intervals stand in small below their values."""


def write_event_report(
    path: Path,
    evaluation: Evaluation,
    real: RealFigures | RealSetsMissing | None = None,
) -> Path:
    """Write the report; OutputError where that cannot be done. real: of real recordings, if any."""
    sections = [
        _answer(evaluation),
        _timelines(evaluation),
        methods_section(evaluation),
        _distributions(evaluation),
        camera_section(evaluation),
        actions_section(evaluation),
        closing_section(evaluation),
        states_section(evaluation),
        outcomes_section(evaluation),
        real_section(real),
        data_section(evaluation),
        how_made(evaluation),
    ]
    return write_page(path, "Holdfast, evaluation", [CLOSE, *filter(None, sections)])


def _answer(of: Evaluation) -> str:
    row, kind = of.rows[of.thresholds.headline], html.escape(kind_of(of))
    trained_on = html.escape(of.model.trained_on or "data that its card does not name")
    return f"""<h1>Does the model tell a failing grip from a voluntary action? Whole streams, {kind}
</h1>
<p><strong>{_events_sentence(row)} {_closing_sentence(row.closing)}</strong></p>
<div class=answer>{_boxes(row, kind)}</div>
<p>Threshold: {html.escape(of.thresholds.how())}.{_as_deployed(of)}{_better_baselines(of)}</p>
<p class=note>Model {of.model.model_id} at {of.model.rate_hz:g} Hz, trained on {trained_on};
{len(of.sets)} sets, {row.minutes:.0f} minutes, every sample answered by the file itself from a
fresh state. {html.escape(SIMULATED) if "simulated" in kind else ""} Intervals are 95 %, over
{_resampled(of)} (bootstrap) or exact (shares of actions).</p>
{_warnings(of)}"""


def _resampled(of: Evaluation) -> str:
    """What the intervals resample, such as people, or people and trials of several sets."""
    kinds = sorted({one.card.group_kind for one in of.sets.values()})
    return " and ".join(PLURAL[kind] for kind in kinds)


def _boxes(row: MethodFigures, kind: str) -> str:
    called = row.safe_acts_called
    boxes = (
        (
            percent(row.recall),
            f"recall of {row.events} risky events",
            percent_interval(row.recall_ci),
        ),
        (
            number(row.false_per_min),
            "false alarms a minute",
            interval(row.false_per_min_ci),
        ),
        (
            percent(called.share),
            f"of {called.n} voluntary actions called risky",
            percent_interval(called.share_ci),
        ),
        (median(row.delay_ms), "ms from load onset to act", "median"),
    )
    return "".join(
        f"<div><b>{value}</b>{label}<br><span class=note>"
        f"{' &middot; '.join(filter(None, (below, kind)))}</span></div>"
        for value, label, below in boxes
    )


def _as_deployed(of: Evaluation) -> str:
    if of.thresholds.headline == DEPLOYED:
        return ""
    row = of.rows[DEPLOYED]
    return (
        f" As deployed (no threshold of its own) its recall is {percent(row.recall)} at "
        f"{number(row.false_per_min)} false alarms a minute."
    )


def _better_baselines(of: Evaluation) -> str:
    """Every baseline with a higher recall, the oracle apart."""
    ours = of.rows[of.thresholds.headline].recall or 0.0
    return "".join(
        f" <strong>The {html.escape(shown(name))} has a higher recall:</strong> "
        f"{percent(row.recall)} at {number(row.false_per_min)} false alarms a minute and "
        f"{percent(row.safe_acts_called.share)} of the voluntary actions called risky "
        f"(McNemar p {p_cell(of.mcnemar[name])})."
        for name, row in of.rows.items()
        if name in of.mcnemar and name != ORACLE and (row.recall or 0.0) > ours
    )


def _warnings(of: Evaluation) -> str:
    seen = [
        (name, one.card)
        for name, one in of.sets.items()
        if one.card.trained_on_recordings
    ]
    return "".join(
        f"<p class=note><strong>Warning:</strong> the model was trained on "
        f"{card.trained_on_recordings} of the {card.recordings} recordings of "
        f"{html.escape(name)}; its figures flatter.</p>"
        for name, card in seen
    )


def _events_sentence(row: MethodFigures) -> str:
    if not row.events:
        return (
            "No grip fails in these streams; an act was requested "
            f"{row.false_alarms} times without a cause."
        )
    delay = row.delay_ms
    when = f", a median of {delay.p50:.0f} ms after load onset" if delay else ""
    return (
        f"Of {row.events} grips that fail, an act is requested in {row.found} "
        f"({percent(row.recall)}){when}, at {number(row.false_per_min)} false alarms a minute; "
        f"{percent(row.safe_acts_called.share)} of the hand-overs and put-downs are called risky."
    )


def _closing_sentence(closing: KeptObjects | None) -> str:
    if closing is None or not closing.modelled:
        return "These recordings do not show whether a closing hand would have held the objects."
    return (
        "A hand that closes like a Michelangelo hand would still hold "
        f"{closing.kept} of the {closing.preventable} objects that it can hold at all; "
        f"{closing.not_preventable} of {closing.modelled} it would lose even if it acted at load "
        "onset."
    )


def _timelines(of: Evaluation) -> str:
    if not of.shown:
        return ""
    first, kind = next(iter(of.sets)), kind_of(of)
    parts = "".join(
        f"<h3>{html.escape(title)}</h3>{draw.timelines(rows, kind)}"
        for title, rows in of.shown.items()
    )
    return f"""{heading(of, "Trials over time")}
<p class=key>The first trials of {html.escape(first)}, objects interleaved, one row a trial.
Behind, in pale colour: the truth. In front: the state at every sample (hatched: unknown, while the
filters settle). A triangle: an act is requested. {key(SITUATION_COLOURS)}</p>{parts}"""


def _distributions(of: Evaluation) -> str:
    if not of.times:
        return ""
    return f"""{heading(of, "Delay, and the lead that was left")}
<p>Of the events that were detected: from load onset to the first sample called risky_slip, and to
the request to act. The lead from load onset to gross slip, and what was left of it at the request
(below 0: the object slid already).</p>
{draw.distributions(of.times, kind_of(of))}"""
