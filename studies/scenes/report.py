"""The report of simulated scenes: the answer, what it stands beside, what it never met, trials as
they went by.

`write_scene_report` shows whatever the figures hold, so `demo_report` makes the same page from one
small set.
"""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluation import stream_pictures as draw
from evaluation.page import key, write_page
from evaluation.scores import confusion, scores, spread_of
from evaluation.streams import StreamPicture
from evaluation.style import SITUATION_COLOURS
from export.reference import IntArray
from studies.real.pictures import confusion as four_by_four
from studies.row_names import LINE, OURS, RAW, row_class, shown
from studies.scenes.study import CAVEAT
from training.crossval import HeldOut
from training.fitting import with_situations
from training.recording import DataSet

LEVEL_HEADS = (
    ("eight", "accuracy"),
    ("seven", "accuracy"),
    ("four", "accuracy"),
    ("four", "macro_f1"),
)


@dataclass(frozen=True)
class SceneEvidence:
    """Everything the report shows: figures as in scenes.json, and of the headline's rate what
    pictures need."""

    figures: dict[str, Any]
    data: DataSet
    held_out: HeldOut
    streams: list[StreamPicture]

    @property
    def headline(self) -> dict[str, Any]:
        """The figures of the headline's rate."""
        rate: dict[str, Any] = self.figures["rates"][self.figures["headline_hz"]]
        return rate

    @property
    def kind(self) -> str:
        """What stands beside every number."""
        return str(self.figures["kind"])


def write_scene_report(path: Path, evidence: SceneEvidence) -> Path:
    """Write the report; OutputError where that cannot be done."""
    sections = [
        _answer(evidence),
        _leak(evidence),
        _table(evidence),
        _confusion(evidence),
        _objects(evidence),
        _others(evidence),
        _styles(evidence),
        _curve(evidence),
        _rates(evidence),
        _streams(evidence),
        _made(evidence),
    ]
    return write_page(path, "Holdfast, scenes", [section for section in sections if section])


def demo_report(
    path: Path,
    data: DataSet,
    held_out: HeldOut,
    figures: dict[str, Any],
    streams: list[StreamPicture],
) -> Path:
    """The same page from one set: its table has ours alone, and what is not there (objects, rates)
    is left out.

    data, held_out: with the task "classes". figures: seed, seconds, versions, command, whichever
    are known. streams: of `held_out_streams`. Raises OutputError.
    """
    votes: IntArray = held_out.votes["classes"]
    rate = {
        "rate_hz": data.rate_hz,
        "data": {"name": data.name, "kind": data.kind, "n_trials": len(data.recordings)},
        "rows": {OURS: scores(data, votes, seed=int(figures.get("seed", 0)))},
        "retrainings": {OURS: _one_retraining(data, votes, int(figures.get("seed", 0)))},
    }
    name = f"{data.rate_hz:g}"
    told = {
        "kind": data.kind,
        "caveat": CAVEAT,
        **figures,
        "headline_hz": name,
        "rates": {name: rate},
    }
    return write_scene_report(path, SceneEvidence(told, data, held_out, streams))


def _one_retraining(data: DataSet, votes: IntArray, seed: int) -> dict[str, Any]:
    matrix = confusion(data.tasks["classes"].label, votes)
    return {"seeds": [seed], "confusion": [matrix.tolist()], **spread_of([matrix])}


def _head(evidence: SceneEvidence, title: str) -> str:
    return f"<h2>{title} <em class=note>({html.escape(evidence.kind)})</em></h2>"


def _answer(evidence: SceneEvidence) -> str:
    best, kind = evidence.headline["rows"][OURS], html.escape(evidence.kind)
    told = evidence.headline["data"]
    figures = (
        ("macro F1 over four situations", best["four"]["macro_f1"], best["four"]["macro_f1_ci"]),
        ("accuracy over seven classes", best["seven"]["accuracy"], best["seven"]["accuracy_ci"]),
        (
            "risky windows called risky",
            best["calls"]["risky"]["share"],
            best["calls"]["risky"]["share_ci"],
        ),
        (
            "safe slips called risky",
            best["calls"]["safe"]["share"],
            best["calls"]["safe"]["share_ci"],
        ),
    )
    boxes = "".join(
        f"<div><b>{_number(value)}</b>{name}, {kind}<br><span class=note>{_between(interval)}</span></div>"
        for name, value, interval in figures
    )
    return f"""<h1>Scenes: can a forest tell a slip it has not seen? Every number here is {kind}</h1>
<p class=note>{html.escape(told["name"])}, {evidence.figures["headline_hz"]} Hz: {told["n_trials"]} trials,
{best["n_windows"]} windows, as many of each class; every answer from a forest that never saw the trial.</p>
<div class=answer>{boxes}</div>
<p><strong>Read with this:</strong> {html.escape(evidence.figures["caveat"])} Clock-free: no feature sees anything older
than 0.5 s. Intervals are 95 %, over trials.</p>"""


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.3f}"


def _between(interval: list[float] | None, joint: str = " to ") -> str:
    return joint.join(f"{edge:.3f}" for edge in interval) if interval else "no interval"


def _leak(evidence: SceneEvidence) -> str:
    checks = {
        rate: study["leak"] for rate, study in evidence.figures["rates"].items() if "leak" in study
    }
    if not checks:
        return ""
    verdict = (
        "LEAK: weight is known where nothing shows it"
        if evidence.figures.get("leak")
        else "No leak of weight"
    )
    lines = "; ".join(
        f"{rate} Hz: {_number(one['eight_class_accuracy'])} ({_between(one['eight_class_accuracy_ci99'])}), weight "
        f"within nothing {_number(one['weight_within_nothing'])} ({_between(one['weight_within_nothing_ci99'])})"
        for rate, one in checks.items()
    )
    explained = html.escape(next(iter(checks.values()))["explanation"])
    return f"""{_head(evidence, verdict)}<p>{explained}</p>
<p>Eight-class accuracy with its 99 % interval: {lines}.</p>"""


def _table(evidence: SceneEvidence) -> str:
    rows = evidence.headline["rows"]
    lines = "\n".join(_row(name, row) for name, row in rows.items())
    one = rows.get(LINE)
    told = (
        f"The one line {html.escape(one['law'])}. It is asked at a window's last sample, as every line is; anywhere in "
        f"the window's 0.10 s it calls {_number(one['calls_anywhere_in_the_window']['risky']['share'])} of the risky "
        f"and {_number(one['calls_anywhere_in_the_window']['safe']['share'])} of the safe-slip windows."
        if one
        else ""
    )
    return f"""{_head(evidence, "What it stands beside")}
<p>Seven counts nothing once, because light and heavy are one signal there; eight classes cannot be told better than
0.875 (dotted). Accuracy is at balanced classes. {told}</p>
{draw.score_bars(rows, evidence.kind)}
<div class=wide><table><tr><th>{evidence.figures["headline_hz"]} Hz, trials held out, {html.escape(evidence.kind)}
<th>8, acc.<th>95 %<th>7, acc.<th>95 %<th>4, acc.<th>95 %<th>4, F1<th>95 %<th>risky called<th>safe called
{lines}</table></div>"""


def _row(name: str, row: dict[str, Any]) -> str:
    cells = "".join(
        f"<td>{_number(row[level][figure])}<td>{_between(row[level][f'{figure}_ci'], '-')}"
        if level in row
        else "<td><td>"
        for level, figure in LEVEL_HEADS
    )
    called = "".join(f"<td>{_number(row['calls'][name]['share'])}" for name in ("risky", "safe"))
    return f"<tr class='{row_class(name)}'><td>{html.escape(shown(name))}{cells}{called}"


def _confusion(evidence: SceneEvidence) -> str:
    again = evidence.headline["retrainings"][OURS]
    several = len(again["seeds"]) > 1
    told = (
        f"Five retrainings with other seeds of split and forest: mean share, ± half the range. {_spread(evidence)}"
        if several
        else "Trials held out, one training."
    )
    data = with_situations(evidence.data)
    return f"""{_head(evidence, "Where it is right and where not")}<p>{told}</p>
{draw.confusion_spread(again["confusion"], evidence.kind)}
<p>The four situations ({html.escape(evidence.kind)}), as the hand is told them:</p>
{four_by_four(data, evidence.held_out)}"""


def _spread(evidence: SceneEvidence) -> str:
    parts = [
        f"{html.escape(name)}: recall of a class moves by {100 * one['largest_spread']:.1f} points at most"
        for name, one in evidence.headline["retrainings"].items()
    ]
    return (
        f"{'; '.join(parts)} (the thesis: within 10 % per class; the two of nothing are a coin's)."
    )


def _objects(evidence: SceneEvidence) -> str:
    objects = evidence.headline.get("objects")
    if not objects:
        return ""
    lines = "\n".join(
        f"<tr><td>{html.escape(name)}<td>{one['n_windows']}<td>{one['eight']['present']}"
        + "".join(
            f"<td>{_cell(figures[name], level)}"
            for level in ("four", "seven")
            for figures in (ours, raw)
        )
        for ours, raw in ((objects[OURS], objects[RAW]),)
        for name, one in ours.items()
    )
    return f"""{_head(evidence, "Objects it never met")}
<p>Each object held out in turn. Macro F1 over the classes that the object has, never over absent ones: an object is
light or heavy, and an answer of the wrong weight is a miss in seven classes.</p>
{draw.by_object(objects, evidence.kind)}
<div class=wide><table><tr><th>object held out, {html.escape(evidence.kind)}<th>windows<th>classes<th>4, F1, ours
<th>4, F1, raw<th>7, F1, ours<th>7, F1, raw
{lines}</table></div>"""


def _cell(row: dict[str, Any], level: str) -> str:
    return f"{_number(row[level]['macro_f1'])} ({_between(row[level]['macro_f1_ci'], '-')})"


def _others(evidence: SceneEvidence) -> str:
    others = evidence.headline.get("others")
    if not others:
        return ""
    lines = "\n".join(
        f"<tr><td>{html.escape(card)}: {html.escape(name)}<td>{row['n_windows']}"
        + "".join(f"<td>{_cell(row, level) if level in row else ''}" for level in ("four", "seven"))
        + "".join(
            f"<td>{_number(row['calls'][name]['share'])}" for name in ("risky", "safe", "grasp")
        )
        for card, study in others.items()
        for name, row in study["rows"].items()
    )
    return f"""{_head(evidence, "An object and two styles it never met")}
<p>Trained on every trial of {html.escape(evidence.headline["data"]["name"])}, asked about all windows of the
others (not balanced). p1 and p2 are styles: ranges of parameters, not people.</p>
<div class=wide><table><tr><th>asked about, {html.escape(evidence.kind)}<th>windows<th>4, F1<th>7, F1<th>risky called
<th>safe called<th>grasp called
{lines}</table></div>"""


def _styles(evidence: SceneEvidence) -> str:
    styles = evidence.headline.get("styles")
    if not styles:
        return ""
    lines = "\n".join(
        f"<tr><td>{html.escape(style)}: {html.escape(name)}<td>{study['trained_on_trials']}<td>{row['n_windows']}"
        + "".join(f"<td>{_cell(row, level)}" for level in ("four", "seven"))
        for style, study in styles.items()
        for name, row in study["rows"].items()
    )
    return f"""{_head(evidence, "A style left out")}
<p>Each style left out in turn, trained on the trials of the others alone; balanced windows.</p>
<div class=wide><table><tr><th>style left out, {html.escape(evidence.kind)}<th>trials trained on<th>windows<th>4, F1
<th>7, F1
{lines}</table></div>"""


def _curve(evidence: SceneEvidence) -> str:
    curve = evidence.headline.get("learning_curve")
    if not curve:
        return ""
    names = [name for name in curve[0] if name not in ("trials", "windows")]
    heads = "".join(
        f"<th>{level}, F1, {html.escape(name)}" for name in names for level in ("4", "8")
    )
    lines = "\n".join(
        f"<tr><td>{row['trials']}<td>{row['windows']}"
        + "".join(f"<td>{_cell(row[name], level)}" for name in names for level in ("four", "eight"))
        for row in curve
    )
    return f"""{_head(evidence, "How many trials it takes")}
<p>So many of the trials, trials held out within them. The thesis recorded 600, then 1000.</p>
<div class=wide><table><tr><th>trials, {html.escape(evidence.kind)}<th>windows{heads}
{lines}</table></div>"""


def _rates(evidence: SceneEvidence) -> str:
    rates = evidence.figures["rates"]
    if len(rates) < 2:
        return ""
    lines = "\n".join(
        f"<tr><td>{rate} Hz: {html.escape(name)}"
        + "".join(
            f"<td>{_number(row[level][f]) if level in row else ''}" for level, f in LEVEL_HEADS
        )
        + "".join(f"<td>{_number(row['calls'][name]['share'])}" for name in ("risky", "safe"))
        for rate, study in rates.items()
        for name, row in study["rows"].items()
    )
    return f"""{_head(evidence, "Rates")}
{draw.over_rates(rates, evidence.kind)}
<div class=wide><table><tr><th>trials held out, {html.escape(evidence.kind)}<th>8, acc.<th>7, acc.<th>4, acc.<th>4, F1
<th>risky called<th>safe called
{lines}</table></div>"""


def _streams(evidence: SceneEvidence) -> str:
    if not evidence.streams:
        return ""
    kind = html.escape(evidence.kind)
    parts = "".join(
        f"<h3>{html.escape(one.recording.trial_id)} ({kind})</h3>{draw.stream(one, evidence.kind)}"
        for one in evidence.streams
    )
    return f"""{_head(evidence, "Trials as they went by")}
<p class=key>The first pull, fall and pass of the folder, answered sample by sample by one forest that met none of them.
Below, the truth behind in pale colour and the answer in front, at the height of its name (hatched: unknown, settling);
a triangle is where the decision asks the hand to act. Dotted: critical points, found offline by the labeller.
Dashed: the truth's load onset, gross slip and loss of contact. Right: the action alone.
{key(SITUATION_COLOURS)}</p>
{parts}"""


def _made(evidence: SceneEvidence) -> str:
    figures = evidence.figures
    versions = ", ".join(f"{name} {number}" for name, number in figures.get("versions", {}).items())
    seconds = f", {figures['seconds']:.0f} s" if "seconds" in figures else ""
    command = html.escape(figures.get("command", "python -m studies.scenes FOLDER --out DIR"))
    return f"""{_head(evidence, "How this was made")}
<p><code>{command}</code>, seed {figures.get("seed", 0)}{seconds}; {html.escape(versions)}.</p>"""
