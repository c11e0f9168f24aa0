"""Sections of the report of simulated scenes: unseen objects, cards and styles, trials, rates."""

from __future__ import annotations

import html
from typing import Any

from studies.row_names import OURS, RAW, shown
from studies.scenes import pictures
from studies.scenes.evidence import SceneEvidence, heading, macro_f1, number, table

LEVELS = ("four", "seven")
LEVEL_FIGURES = (
    ("eight", "accuracy"),
    ("seven", "accuracy"),
    ("four", "accuracy"),
    ("four", "macro_f1"),
)
"""Columns of a table of methods: level of classes and figure."""


def objects_section(evidence: SceneEvidence) -> str:
    """Each object held out in its turn; empty without such figures."""
    objects = evidence.headline.get("objects")
    if not objects:
        return ""
    ours, raw = objects[OURS], objects[RAW]
    heads = ("4, F1, ours", "4, F1, raw window", "7, F1, ours", "7, F1, raw window")
    rows = [
        [html.escape(name), one["n_windows"], one["eight"]["present"]]
        + [macro_f1(figures[name], level) for level in LEVELS for figures in (ours, raw)]
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


def _called(row: dict[str, Any], *names: str) -> list[str]:
    return [number(row["calls"][name]["share"]) for name in names]


def others_section(evidence: SceneEvidence) -> str:
    """Cards that training did not use; empty without such figures."""
    others = evidence.headline.get("others")
    if not others:
        return ""
    rows = [
        [_method(card, name), row["n_windows"]]
        + [macro_f1(row, level) for level in LEVELS]
        + _called(row, "risky", "safe", "grasp")
        for card, study in others.items()
        for name, row in study["rows"].items()
    ]
    called = ("risky called risky", "safe called risky", "grasp called risky")
    first = _first(evidence, "evaluated on")
    return f"""{heading(evidence, "An unseen object and two unseen styles")}
<p>Trained on every trial of {html.escape(evidence.headline["data"]["name"])}, evaluated on all
windows of the others (not balanced). p1 and p2 are styles: ranges of parameters, not people.</p>
{table((first, "windows", "4, F1", "7, F1", *called), rows)}"""


def styles_section(evidence: SceneEvidence) -> str:
    """Each style left out in its turn; empty without such figures."""
    styles = evidence.headline.get("styles")
    if not styles:
        return ""
    rows = [
        [_method(style, name), study["trained_on_trials"], row["n_windows"]]
        + [macro_f1(row, level) for level in LEVELS]
        for style, study in styles.items()
        for name, row in study["rows"].items()
    ]
    first = _first(evidence, "style left out")
    return f"""{heading(evidence, "A style left out")}
<p>Each style is left out in its turn. Training uses the trials of the other styles alone, and
balanced windows.</p>
{table((first, "trials trained on", "windows", "4, F1", "7, F1"), rows)}"""


def curve_section(evidence: SceneEvidence) -> str:
    """Macro F1 by number of trials; empty without such figures."""
    curve = evidence.headline.get("learning_curve")
    if not curve:
        return ""
    names = [name for name in curve[0] if name not in ("trials", "windows")]
    columns = [(name, level) for name in names for level in ("four", "eight")]
    digit = {"four": "4", "eight": "8"}
    heads = [f"{digit[level]}, F1, {html.escape(shown(name))}" for name, level in columns]
    rows = [
        [row["trials"], row["windows"]] + [macro_f1(row[name], level) for name, level in columns]
        for row in curve
    ]
    return f"""{heading(evidence, "How many trials it takes")}
<p>Forests trained on fewer of the trials, with held-out trials evaluated. The thesis recorded 600,
then 1000 trials.</p>
{table((_first(evidence, "trials"), "windows", *heads), rows)}"""


def rates_section(evidence: SceneEvidence) -> str:
    """Every rate; empty where there is one alone."""
    rates = evidence.figures["rates"]
    if len(rates) < 2:
        return ""
    rows = [
        [_method(f"{rate} Hz", name)]
        + [number(row[level][f]) if level in row else "" for level, f in LEVEL_FIGURES]
        + _called(row, "risky", "safe")
        for rate, study in rates.items()
        for name, row in study["rows"].items()
    ]
    scores = ("8, accuracy", "7, accuracy", "4, accuracy", "4, F1")
    first = _first(evidence, "trials held out")
    return f"""{heading(evidence, "Rates")}
{pictures.rates(rates, evidence.kind)}
{table((first, *scores, "risky called risky", "safe called risky"), rows)}"""
