"""The report of one person: adverse events first, then recall, timelines, questionnaires."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.core.writing import write_whole
from holdfast.evaluation.formats import number
from holdfast.evaluation.outcomes import word
from holdfast.evaluation.page import Row, key, median, table, write_page
from holdfast.evaluation.pictures import timelines
from holdfast.evaluation.style import SITUATION_COLOURS
from holdfast.sessions.study.console import clock_text
from holdfast.sessions.study.outcome import StudyOutcome

if TYPE_CHECKING:
    from holdfast.evaluation.participant import ActionFigures, ParticipantFigures

REPORT, FIGURES = "report.html", "report.json"
LOOK = """<style>td:nth-child(n+2).text,table.words td{text-align:left;white-space:normal}
.adverse{border-left:.35rem solid #cb6e17;padding:.1rem 1rem;background:#fdf3ea}</style>"""
THESIS_WORDS = "ok: in every trial; part: in some; no: in none; -: without a label"


def write_report(home: Path, of: StudyOutcome) -> Path:
    """Write report.json and report.html of a person; returns the page. Raises OutputError."""
    write_whole(
        home / FIGURES, json.dumps(of.to_json(), indent=1, allow_nan=False) + "\n"
    )
    sections = [
        LOOK,
        _head(of),
        _adverse(of),
        _recall(of),
        _timelines(of),
        _questionnaires(of),
        _trials(of),
        _steps(of),
        _notes(of),
        _made(of),
    ]
    return write_page(
        home / REPORT, f"Study, {of.person}", [one for one in sections if one]
    )


def _head(of: StudyOutcome) -> str:
    kept, planned = (
        sum(getattr(one, n) for one in of.trials) for n in ("of_plan", "planned")
    )
    spent_s = sum(one.spent_s or 0.0 for one in of.parts if one.planned_s)
    planned_s = sum(one.planned_s for one in of.parts)
    boxes = [
        (f"{kept} of {planned}", "trials kept"),
        (
            f"{spent_s / 60.0:.1f} of {planned_s / 60.0:g}",
            "minutes of the planned steps",
        ),
        *_answer_boxes(of.figures),
        *(
            (number(one["score"], 1), f"{one['title']}, 0 to 100")
            for one in of.questionnaires
            if one["score"] is not None
        ),
    ]
    shown = "".join(
        f"<div><b>{value}</b>{html.escape(label)}</div>" for value, label in boxes
    )
    state = "" if of.finished else "<strong>The study is not finished.</strong> "
    rehearsal = (
        "<strong>A rehearsal without a participant: simulated trials, and every step took its "
        "planned time.</strong> "
        if of.rehearsal
        else ""
    )
    runs = "one run" if of.runs == 1 else f"{of.runs} runs"
    return f"""<h1>{html.escape(of.person)}: {html.escape(of.title)}</h1>
<p>{state}{rehearsal}{_when(of.began)} to {_when(of.ended)}, {runs}.</p>
<div class=answer>{shown}</div>"""


def _answer_boxes(figures: ParticipantFigures | None) -> list[tuple[str, str]]:
    if figures is None:
        return []
    whole, kind = figures.whole, figures.kind
    return [
        (f"{whole.recognised} of {whole.labelled}", f"actions recognised ({kind})"),
        (number(whole.false_per_min), f"false alarms a minute ({kind})"),
    ]


def _adverse(of: StudyOutcome) -> str:
    if not of.adverse:
        return "<p>No adverse event was noted.</p>"
    rows = "".join(
        f"<p><strong>{html.escape(one.severity or 'severity not given')}</strong>, "
        f"{_when(one.at)}, {_step(one.step)}{html.escape(one.title)}: "
        f"{html.escape(one.text) or 'no description was given'}</p>"
        for one in of.adverse
    )
    return f"<h2>Adverse events: {len(of.adverse)}</h2><div class=adverse>{rows}</div>"


def _recall(of: StudyOutcome) -> str:
    if of.figures is None:
        return f"<h2>Recall</h2><p>No figures: {html.escape(of.no_figures)}</p>"
    figures = of.figures
    rows = [_action_row(one) for one in figures.actions]
    rows.append(Row(["all", *_action_row(figures.whole).cells[1:]], "ours"))
    heads = [
        "action",
        "trials",
        "labelled",
        "recognised",
        "false alarms",
        "a minute",
        "delay, ms",
    ]
    return f"""<h2>Recall by action <em class=note>({html.escape(figures.kind)})</em></h2>
<p>A pull or fall is recognised where an act was requested in it and not before; a hand-over or
put-down where the state was safe slip in it and no act was requested. Delay: median, from load
onset to the request. {_labels(figures)}</p>{table(heads, rows)}
<h3>By object, as in the table of the thesis' chapter 6</h3><p class=note>{THESIS_WORDS}.</p>
{_cells(figures)}"""


def _action_row(one: ActionFigures) -> Row:
    cells = (one.action, one.trials, one.labelled, one.recognised, one.false_alarms)
    rest = (number(one.false_per_min), median(one.delay_ms))
    return Row([html.escape(str(cell)) for cell in (*cells, *rest)])


def _labels(figures: ParticipantFigures) -> str:
    """Where the labels come from, and what has none."""
    without = figures.whole.trials - figures.whole.labelled
    by = (
        ", ".join(f"{name} {count}" for name, count in figures.labels_by.items())
        or "none"
    )
    missing = (
        f" <strong>Trials without a label of their action: {without}</strong> (no key l, no "
        "camera). Whether these were recognised is not known, and an alarm in a pull or fall among "
        "them is neither right nor false."
        if without
        else ""
    )
    late = (
        " A pressed key is late by a person's reaction."
        if "key" in figures.labels_by
        else ""
    )
    return f"Labels of slips by: {html.escape(by)}.{late}{missing}"


def _cells(figures: ParticipantFigures) -> str:
    """Object by action: the thesis' word, and how many."""
    actions = [one.action for one in figures.actions]
    objects = list(dict.fromkeys(one.object for one in figures.cells))
    found = {(one.object, one.action): one for one in figures.cells}
    rows = [
        Row(
            [
                html.escape(name),
                *(_cell(found.get((name, action))) for action in actions),
            ]
        )
        for name in objects
        if name
    ]
    return table(["object", *map(html.escape, actions)], rows)


def _cell(one: ActionFigures | None) -> str:
    if one is None:
        return ""
    if not one.labelled:
        return "-"
    hits = [True] * one.recognised + [False] * (one.labelled - one.recognised)
    return f"{word(hits)} <span class=note>{one.recognised} of {one.labelled}</span>"


def _timelines(of: StudyOutcome) -> str:
    if of.figures is None:
        return ""
    pictures = "".join(
        f"<h3>{html.escape(action)}</h3>{timelines(rows, of.figures.kind)}"
        for action, rows in of.figures.shown.items()
    )
    return f"""<h2>Trials over time <em class=note>({html.escape(of.figures.kind)})</em></h2>
<p class=key>One row a trial. Behind, in pale colour: the labels, where there are any. In front: the
model's state at every sample (hatched: unknown, while the filters settle). A triangle: an act is
requested. {key(SITUATION_COLOURS)}</p>{pictures}"""


def _questionnaires(of: StudyOutcome) -> str:
    if not of.questionnaires:
        return ""
    parts = []
    for one in of.questionnaires:
        left_out = sum(value is None for value in one["ratings"].values())
        score = number(one["score"], 1) if one["score"] is not None else "no score"
        why = f" ({left_out} items left out)" if left_out else ""
        rows = [
            Row([html.escape(name), "left out" if value is None else str(value)])
            for name, value in one["ratings"].items()
        ]
        parts.append(
            f"<h3>{html.escape(one['title'])}: {score}{why}</h3>"
            f"<p class=note>{html.escape(one['source'])}</p>{table(['item', 'rating'], rows)}"
        )
    return f"<h2>Questionnaires</h2>{''.join(parts)}"


def _trials(of: StudyOutcome) -> str:
    heads = ["object, action", "planned", "kept", "filmed", "done again", "interrupted"]
    rows = [
        Row(
            [
                html.escape(f"{one.object}, {one.action}"),
                *map(
                    str,
                    (one.planned, one.kept, one.filmed, one.redone, one.interrupted),
                ),
            ],
            "warning" if one.kept < one.planned else "",
        )
        for one in of.trials
    ]
    return f"<h2>Trials</h2>{table(heads, rows)}"


def _steps(of: StudyOutcome) -> str:
    heads = ["step", "planned", "taken", "begun", "state"]
    rows = [
        Row(
            [
                _step(one.step) + html.escape(one.title),
                clock_text(one.planned_s) if one.planned_s else "-",
                "-" if one.spent_s is None else clock_text(one.spent_s),
                str(one.begun),
                one.state,
            ],
            "" if one.state == "done" else "warning",
        )
        for one in of.parts
    ]
    return f"<h2>Steps, minutes and seconds</h2>{table(heads, rows)}"


def _notes(of: StudyOutcome) -> str:
    if not of.notes:
        return ""
    lines = "".join(
        f"<li>{_when(one['at'])}, {_step(one['step'])}{html.escape(one['title'])}: "
        f"{html.escape(one['text'])}"
        for one in of.notes
    )
    return f"<h2>Notes</h2><ul>{lines}</ul>"


def _made(of: StudyOutcome) -> str:
    if of.figures is None:
        return ""
    return f"""<h2>How this was made</h2><p class=note>Model {of.figures.model_id} as deployed;
every sample is answered by the file itself, from a fresh state at the start of each trial.
{html.escape(of.figures.caveat)}</p>"""


def _when(at: str) -> str:
    """A date of the journal for people."""
    return html.escape(at.replace("T", " ").replace("Z", " UTC"))


def _step(step: int | None) -> str:
    return "" if step is None else f"step {step}, "


def in_words(of: StudyOutcome, page: Path) -> Sequence[str]:
    """The outcome as lines for the operator."""
    kept, planned = (
        sum(getattr(one, n) for one in of.trials) for n in ("of_plan", "planned")
    )
    lines = [
        f"{of.person}: {kept} of {planned} trials kept, {len(of.adverse)} adverse events"
    ]
    if of.figures is None:
        lines.append(f"no figures of a model: {of.no_figures}")
    else:
        for one in (*of.figures.actions, of.figures.whole):
            lines.append(
                f"  {one.action or 'all'}: {one.recognised} of {one.labelled} labelled trials "
                f"recognised, {one.false_alarms} false alarms in {one.minutes:.1f} min "
                f"({of.figures.kind})"
            )
    lines += [
        f"  {one['title']}: {number(one['score'], 1)} of 100"
        for one in of.questionnaires
    ]
    return [*lines, f"report: {page}"]
