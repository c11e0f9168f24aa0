"""Sections of the report of simulated scenes: unseen objects, cards and styles, trials, rates."""

from __future__ import annotations

import html

from holdfast.evaluation.scores import ClassScores
from holdfast.training.figures import Interval
from studies.row_names import OURS, RAW, shown
from studies.scenes import pictures
from studies.scenes.evidence import SceneEvidence, heading, macro_f1, number, table
from studies.scenes.figures import ShearRateFigures

Figure = tuple[float | None, Interval | None]
"""A value and its 95 % interval."""


def level_figures(row: ClassScores | ShearRateFigures) -> list[Figure]:
    """Accuracy of eight and seven classes and four situations, macro F1 of four; none of calls."""
    if not isinstance(row, ClassScores):
        return []
    levels = (row.eight, row.seven, row.four)
    accuracies: list[Figure] = [(one.accuracy, one.accuracy_ci) for one in levels]
    return [*accuracies, (row.four.macro_f1, row.four.macro_f1_ci)]


def _macro_f1s(row: ClassScores | ShearRateFigures) -> list[str]:
    """Macro F1 of four situations and of seven classes; empty where the row has none."""
    if not isinstance(row, ClassScores):
        return ["", ""]
    return [macro_f1(row.four), macro_f1(row.seven)]


def objects_section(evidence: SceneEvidence) -> str:
    """Each object held out in its turn; empty without such figures."""
    objects = evidence.headline.objects
    if not objects:
        return ""
    ours, raw = objects[OURS], objects[RAW]
    heads = ("4, F1, ours", "4, F1, raw window", "7, F1, ours", "7, F1, raw window")
    rows = [
        [html.escape(name), one.n_windows, one.eight.present]
        + [macro_f1(figures[name].four) for figures in (ours, raw)]
        + [macro_f1(figures[name].seven) for figures in (ours, raw)]
        for name, one in ours.items()
    ]
    return f"""{heading(evidence, "Unseen objects")}
<p>Each object is held out in its turn. Macro F1 is over the classes that the object has, never over
absent ones. An object is light or heavy, and an answer of the wrong weight is a miss in seven
classes.</p>
{pictures.objects_left_out(objects, evidence.kind)}
{table((_first(evidence, "object held out"), "windows", "classes", *heads), rows)}"""


def _first(evidence: SceneEvidence, what: str) -> str:
    return f"{what}, {html.escape(evidence.kind)}"


def _method(what: str, name: str) -> str:
    return html.escape(f"{what}: {shown(name)}")


def _called(row: ClassScores | ShearRateFigures) -> list[str]:
    """Shares of the risky, safe and grasp windows that are called risky."""
    calls = row.calls
    return [number(one.share) for one in (calls.risky, calls.safe, calls.grasp)]


def others_section(evidence: SceneEvidence) -> str:
    """Cards that training did not use; empty without such figures."""
    others = evidence.headline.others
    if not others:
        return ""
    rows = [
        [_method(card, name), row.n_windows, *_macro_f1s(row), *_called(row)]
        for card, study in others.items()
        for name, row in study.rows.items()
    ]
    called = ("risky called risky", "safe called risky", "grasp called risky")
    first = _first(evidence, "evaluated on")
    return f"""{heading(evidence, "An unseen object and two unseen styles")}
<p>Trained on every trial of {html.escape(evidence.headline.data.name)}, evaluated on all
windows of the others (not undersampled). p1 and p2 are styles: ranges of parameters, not
people.</p>
{table((first, "windows", "4, F1", "7, F1", *called), rows)}"""


def styles_section(evidence: SceneEvidence) -> str:
    """Each style left out in its turn; empty without such figures."""
    styles = evidence.headline.styles
    if not styles:
        return ""
    rows = [
        [_method(style, name), study.trained_on_trials, row.n_windows, *_macro_f1s(row)]
        for style, study in styles.items()
        for name, row in study.rows.items()
    ]
    first = _first(evidence, "style left out")
    return f"""{heading(evidence, "A style left out")}
<p>Each style is left out in its turn. Training uses the trials of the other styles alone,
and the thesis' undersampled windows.</p>
{table((first, "trials trained on", "windows", "4, F1", "7, F1"), rows)}"""


def curve_section(evidence: SceneEvidence) -> str:
    """Macro F1 by number of trials; empty without such figures."""
    curve = evidence.headline.learning_curve
    if not curve:
        return ""
    heads = [
        f"{digit}, F1, {html.escape(shown(name))}"
        for name in curve[0].rows
        for digit in "48"
    ]
    rows = [
        [point.trials, point.windows]
        + [
            macro_f1(level)
            for row in point.rows.values()
            for level in (row.four, row.eight)
        ]
        for point in curve
    ]
    return f"""{heading(evidence, "How many trials it takes")}
<p>Forests trained on fewer of the trials, with held-out trials evaluated. The thesis recorded 600,
then 1000 trials.</p>
{table((_first(evidence, "trials"), "windows", *heads), rows)}"""


def rates_section(evidence: SceneEvidence) -> str:
    """Every rate; empty where there is one alone."""
    rates = evidence.figures.rates
    if len(rates) < 2:
        return ""
    scores = ("8, accuracy", "7, accuracy", "4, accuracy", "4, F1")
    rows = [
        [_method(f"{rate} Hz", name)]
        + ([number(value) for value, _ in level_figures(row)] or [""] * len(scores))
        + _called(row)[:2]
        for rate, study in rates.items()
        for name, row in study.rows.items()
    ]
    first = _first(evidence, "trials held out")
    return f"""{heading(evidence, "Rates")}
{pictures.rates(rates, evidence.kind)}
{table((first, *scores, "risky called risky", "safe called risky"), rows)}"""
