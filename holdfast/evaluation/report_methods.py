"""Sections of a report that set this model beside the baselines."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping

from holdfast.evaluation.camera import CameraFigures
from holdfast.evaluation.figures import Evaluation
from holdfast.evaluation.formats import interval, number, percent, percent_interval
from holdfast.evaluation.methods import MethodFigures
from holdfast.evaluation.outcomes import STYLES
from holdfast.evaluation.page import (
    BASELINES,
    ORACLE,
    Row,
    is_this_model,
    kept_cell,
    median,
    p_cell,
    percent_spread_cell,
    percent_with_interval,
    share_cell,
    shown,
    spread_cell,
    table,
    with_interval,
)
from holdfast.evaluation.report_parts import heading, kind_of
from holdfast.evaluation.statistics import McNemar

DETECTION = (
    "method",
    "risky events",
    "recall",
    "false alarms a minute",
    "false alarms an hour",
    "load onset to act, ms",
    "lead left, ms",
    "acted before gross slip",
)
CONSEQUENCES = (
    "method",
    "share of the lead used",
    "false alarms on voluntary actions",
    "drops prevented",
    "McNemar p",
)
EXPLAINED = """<p class=note>Recall: share of the risky events with an alarm. Lead left: from the
request to gross slip (below 0: it slid already); median, below it 5 to 95 %. Share of the lead
used: of the time from load onset to gross slip. False alarms on voluntary actions: hand-overs and
put-downs in which an act was requested. Drops prevented: by the closing hand below, of those
that it can prevent. McNemar p: exact test, event by event, against the first method.</p>"""
Parts = Mapping[str, tuple[Mapping[str, MethodFigures], Mapping[str, McNemar]]]
"""Title -> rows of a set by method, and their comparisons."""


def methods_section(of: Evaluation) -> str:
    """Recall, false alarms and times of every method, by set."""
    alone = len(of.sets) == 1
    parts = {} if alone else {"all sets": (of.rows, of.mcnemar)}
    parts |= {name: (one.rows, one.mcnemar) for name, one in of.sets.items()}
    sets = html.escape(", ".join(of.thresholds.matched_on))
    return f"""{heading(of, "This model beside the baselines")}
<p>An alarm detects an event if it begins between load onset and the loss of contact, give or take
20 ms. An alarm that was on before detects nothing. The baselines act at once, through the same
decision, only while something is held. Each is matched to this model's rate of false alarms on
{sets}; its rate may differ here.</p>
<p class=note>{_settings(of)}.</p>
{method_tables(parts)}
{_wide_collar(of)}"""


def method_tables(parts: Parts) -> str:
    """Both tables of methods, with what their columns mean."""
    first = table(DETECTION, _rows(parts, _detection))
    return f"{first}\n{table(CONSEQUENCES, _rows(parts, _consequences))}\n{EXPLAINED}"


def _rows(parts: Parts, cells: object) -> Iterator[Row]:
    assert callable(cells)
    for title, (rows, mcnemar) in parts.items():
        yield Row([html.escape(title)])
        for name, row in rows.items():
            style = (
                "ours" if is_this_model(name) else "warning" if name == ORACLE else ""
            )
            yield Row([html.escape(shown(name)), *cells(row, mcnemar.get(name))], style)


def _detection(row: MethodFigures, _: McNemar | None) -> list[str]:
    return [
        f"{row.events}",
        percent_with_interval(row.recall, row.recall_ci),
        with_interval(row.false_per_min, row.false_per_min_ci),
        number(row.false_per_hour, 0),
        spread_cell(row.delay_ms),
        spread_cell(row.lead_ms),
        percent(row.in_time),
    ]


def _consequences(row: MethodFigures, against: McNemar | None) -> list[str]:
    return [
        percent_spread_cell(row.lead_used),
        share_cell(row.safe_acts_called),
        kept_cell(row.closing),
        p_cell(against),
    ]


def _settings(of: Evaluation) -> str:
    return "; ".join(
        f"<b>{html.escape(shown(one.name))}</b>: "
        f"{html.escape(BASELINES[one.name])}, here {one.setting:.3g}"
        + ("" if one.fits else ", which still has too many false alarms")
        for one in of.thresholds.baselines
    )


def _wide_collar(of: Evaluation) -> str:
    rows = "; ".join(
        f"{html.escape(shown(name))} {percent(row.collar_40_ms.recall)} at "
        f"{number(row.collar_40_ms.false_per_min)}"
        for name, row in of.rows.items()
    )
    note = "With a collar of 40 ms, recall and false alarms a minute, all sets"
    return f"<p class=note>{note}: {rows}.</p>"


def camera_section(of: Evaluation) -> str:
    """Alarms against the slip as a camera saw it, beside the truth of the scene."""
    seen = [
        (name, method, row.camera)
        for name, one in of.sets.items()
        for method, row in one.rows.items()
        if row.camera is not None
    ]
    if not seen:
        return ""
    heads = (
        "set: method",
        "events detected",
        "camera: act after start",
        "camera: lead left",
        "truth: act after first sliding",
        "truth: lead left",
        "camera minus truth, start",
        "camera minus truth, gross slip",
    )
    rows = [
        Row(
            [f"{html.escape(name)}: {html.escape(shown(method))}", *_camera_cells(row)],
            "ours" if is_this_model(method) else "",
        )
        for name, method, row in seen
    ]
    headline = of.thresholds.headline
    sd = ", ".join(
        f"{html.escape(name)} {median(row.start_sd_ms)} ms"
        for name, method, row in seen
        if method == headline
    )
    return f"""{heading(of, "Alarms against a camera")}
<p>A camera beside the hand saw the object begin to move in it, and move a fixed distance ("gross
slip"); no tactile sample is used for that. "Truth" is the scene's: the first part that slid, and
gross slip. All times in ms, median and 5 to 95 %. A delay below 0 is an alarm before the object
moved. Standard deviation of the camera's start (median): {sd}. Soft pads let an object move before
anything slips, so its start may come early, and the lead look short.</p>
{table(heads, rows)}"""


def _camera_cells(of: CameraFigures) -> list[str]:
    truth = of.truth
    found = (
        f"{of.found} of {of.events}<br><span class=note>{of.onsets} onsets seen</span>"
    )
    by_truth = (
        [truth.delay_ms, truth.lead_ms, truth.start_off_ms, truth.gross_off_ms]
        if truth
        else [None] * 4
    )
    return [found, *(spread_cell(one) for one in (of.delay_ms, of.lead_ms, *by_truth))]


def actions_section(of: Evaluation) -> str:
    """False alarms on voluntary actions, by style, and on disturbed holds."""
    name = of.thresholds.headline
    rows = [
        Row(
            [
                html.escape(which),
                html.escape(action or "not stated"),
                f"{one.n}",
                percent(one.share),
                percent_interval(one.share_ci),
            ]
        )
        for which, figures in of.sets.items()
        for action, one in figures.rows[name].safe_acts_by_action.items()
    ]
    heads = ("set", "action", "actions", "called risky", "95 %, exact")
    return f"""{heading(of, "False alarms on voluntary actions")}
<h3>Hand-overs and put-downs called risky</h3>
<p>{html.escape(shown(name))}: an act was requested at some sample of the action.</p>
{table(heads, rows)}{_styles(of)}{_disturbed(of)}"""


def _styles(of: Evaluation) -> str:
    by = of.rows[of.thresholds.headline].by_style
    if by is None:
        return ""
    rows = [
        Row(
            [
                html.escape(STYLES.get(name, name)),
                f"{one.events}",
                percent_with_interval(one.recall, one.recall_ci),
                with_interval(one.false_per_min, one.false_per_min_ci),
                share_cell(one.safe_acts_called),
            ]
        )
        for name, one in by.styles.items()
    ]
    heads = (
        "style, all sets",
        "risky events",
        "recall",
        "false alarms a minute",
        "voluntary actions called risky",
    )
    return f"""<h3>By style</h3><p>Over styles instead of trials, the interval of the recall is
{percent_interval(by.recall_ci)} %, that of the false alarms a minute
{interval(by.false_per_min_ci)}. Below each value: its interval over the trials of the style.</p>
{table(heads, rows)}"""


def _disturbed(of: Evaluation) -> str:
    holds = of.rows[of.thresholds.headline].specificity
    if not holds:
        return ""
    rows = [
        Row(
            [
                html.escape(shown(name)),
                *(share_cell(one) for one in row.specificity.values()),
            ]
        )
        for name, row in of.rows.items()
        if row.specificity
    ]
    kinds = [
        f"{kind}: {one.n} held, {one.failed} failed" for kind, one in holds.items()
    ]
    return f"""<h3>Holds that are disturbed</h3>
<p>Grip (dFn), load (dFt) or motor (dq) is disturbed three times. Shown: share of the holds that
held in which there was no alarm from the first sample to the last. Holds that failed are events,
not false alarms.</p>
{table((f"no alarm ({html.escape(kind_of(of))})", *kinds), rows)}"""
