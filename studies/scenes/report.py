"""The report of simulated scenes: scores, baselines, what is unseen, and whole trials.

`write_scene_report` shows what the figures hold, so `demo_report` makes the same page from one
small set.
"""

from __future__ import annotations

import html
from pathlib import Path

from holdfast.evaluation import stream_pictures as draw
from holdfast.evaluation.model_outputs import StreamPicture
from holdfast.evaluation.page import key, write_page
from holdfast.evaluation.scores import ClassScores, LeakCheck, confusion, scores
from holdfast.evaluation.style import SITUATION_COLOURS
from holdfast.export.reference import IntArray
from holdfast.export.spec import window_samples
from holdfast.training.crossval import HeldOut
from holdfast.training.fitting import with_situations
from holdfast.training.recording import DataSet
from studies.real.pictures import confusion as four_by_four
from studies.row_names import LINE, OURS, row_class, shown
from studies.scenes import pictures
from studies.scenes.evidence import SceneEvidence, between, heading, number
from studies.scenes.figures import (
    DescribedSet,
    MadeBy,
    RateFigures,
    ScenesFigures,
    ShearRateFigures,
)
from studies.scenes.study import CAVEAT, retraining
from studies.scenes.unseen_report import (
    curve_section,
    level_figures,
    objects_section,
    others_section,
    rates_section,
    styles_section,
)
from studies.score_pictures import confusion_spread


def write_scene_report(path: Path, evidence: SceneEvidence) -> Path:
    """Write the report; OutputError where that cannot be done."""
    sections = [
        _summary(evidence),
        _leak(evidence),
        _methods(evidence),
        _confusion(evidence),
        objects_section(evidence),
        others_section(evidence),
        styles_section(evidence),
        curve_section(evidence),
        rates_section(evidence),
        _streams(evidence),
        evidence.closed_loop,
        _made(evidence),
    ]
    return write_page(
        path, "Holdfast, scenes", [section for section in sections if section]
    )


def demo_report(
    path: Path,
    data: DataSet,
    held_out: HeldOut,
    made: MadeBy,
    streams: list[StreamPicture],
    closed_loop: str = "",
) -> Path:
    """The same page from one set, with our forest alone and without objects and rates.

    data, held_out: with the task "classes". streams: of `held_out_streams`. closed_loop: HTML.
    Raises OutputError.
    """
    votes: IntArray = held_out.votes["classes"]
    matrix = confusion(data.tasks["classes"].label, votes)
    rate = RateFigures(
        rate_hz=data.rate_hz,
        window_samples=window_samples(data.rate_hz),
        data=DescribedSet(data.name, data.kind, len(data.recordings)),
        rows={OURS: scores(data, votes, seed=made.seed)},
        retrainings={OURS: retraining([made.seed], [matrix])},
    )
    figures = ScenesFigures(data.kind, CAVEAT, {f"{data.rate_hz:g}": rate})
    evidence = SceneEvidence(figures, made, data, held_out, streams, closed_loop)
    return write_scene_report(path, evidence)


def _summary(evidence: SceneEvidence) -> str:
    best, kind = evidence.headline.scores(OURS), html.escape(evidence.kind)
    data = evidence.headline.data
    return f"""<h1>Scenes: does a forest recognise a slip it was not trained on? All {kind}</h1>
<p class=note>{html.escape(data.name)}, {evidence.figures.headline_hz} Hz:
{data.n_trials} trials, {best.n_windows} windows, as many of each class. Every answer is from
a forest that was not trained on the trial.</p>
<div class=answer>{_boxes(best, kind)}</div>
<p><strong>Read with this:</strong> {html.escape(evidence.figures.caveat)} Clock-free: no feature
sees anything older than 0.5 s. Intervals are 95 %, over trials.</p>"""


def _boxes(best: ClassScores, kind: str) -> str:
    """The four headline figures."""
    four, seven, calls = best.four, best.seven, best.calls
    places = (
        ("macro F1 over four situations", four.macro_f1, four.macro_f1_ci),
        ("accuracy over seven classes", seven.accuracy, seven.accuracy_ci),
        ("risky windows called risky", calls.risky.share, calls.risky.share_ci),
        ("safe slips called risky", calls.safe.share, calls.safe.share_ci),
    )
    return "".join(
        f"<div><b>{number(value)}</b>{name}, {kind}<br>"
        f"<span class=note>{between(interval)}</span></div>"
        for name, value, interval in places
    )


def _leak(evidence: SceneEvidence) -> str:
    rates = evidence.figures.rates
    checks = {rate: one.leak for rate, one in rates.items() if one.leak is not None}
    if not checks:
        return ""
    verdict = (
        "LEAK: the weight is known where no signal carries it"
        if evidence.figures.leak
        else "No leak of weight"
    )
    lines = "; ".join(f"{rate} Hz: {_leak_line(one)}" for rate, one in checks.items())
    explained = html.escape(next(iter(checks.values())).explanation)
    return f"""{heading(evidence, verdict)}<p>{explained}</p>
<p>Eight-class accuracy with its 99 % interval: {lines}.</p>"""


def _leak_line(one: LeakCheck) -> str:
    return (
        f"{number(one.eight_class_accuracy)} ({between(one.eight_class_accuracy_ci99)}), "
        f"weight within nothing {number(one.weight_within_nothing)} "
        f"({between(one.weight_within_nothing_ci99)})"
    )


def _methods(evidence: SceneEvidence) -> str:
    rows, kind = evidence.headline.rows, html.escape(evidence.kind)
    lines = "\n".join(_row(name, row) for name, row in rows.items())
    return f"""{heading(evidence, "Our forest beside baselines")}
<p>Seven classes count "nothing" once, because no signal tells a light from a heavy object there. So
accuracy over eight classes cannot pass 0.875 (dotted). Classes have the same count.
{_threshold(rows.get(LINE))}</p>
{pictures.level_bars(rows, evidence.kind)}
<div class=wide><table><tr><th>{evidence.figures.headline_hz} Hz, trials held out, {kind}
<th>8, accuracy<th>95 %<th>7, accuracy<th>95 %<th>4, accuracy<th>95 %<th>4, F1<th>95 %
<th>risky called risky<th>safe called risky
{lines}</table></div>"""


def _threshold(row: ClassScores | ShearRateFigures | None) -> str:
    """What the shear-rate threshold does, where it is one of the rows."""
    if not isinstance(row, ShearRateFigures):
        return ""
    anywhere = row.calls_anywhere_in_the_window
    return (
        f"The shear-rate threshold {html.escape(row.law)}. It is evaluated at a window's last "
        f"sample, as every method is. Anywhere in the window's 0.10 s it calls "
        f"{number(anywhere.risky.share)} of the risky and "
        f"{number(anywhere.safe.share)} of the safe-slip windows risky."
    )


def _row(name: str, row: ClassScores | ShearRateFigures) -> str:
    cells = "".join(
        f"<td>{number(value)}<td>{between(interval, '-')}"
        for value, interval in level_figures(row)
    )
    absent = "" if isinstance(row, ClassScores) else "<td>" * 8
    called = "".join(
        f"<td>{number(one.share)}" for one in (row.calls.risky, row.calls.safe)
    )
    return f"<tr class='{row_class(name)}'><td>{html.escape(shown(name))}{cells}{absent}{called}"


def _confusion(evidence: SceneEvidence) -> str:
    retrainings = evidence.headline.retrainings[OURS]
    several = (
        "Five retrainings with other seeds of split and forest: mean share, ± half the range. "
        + _spread(evidence)
    )
    once = "Trials held out, one training."
    data = with_situations(evidence.data)
    return f"""{heading(evidence, "Confusion of classes")}
<p>{several if len(retrainings.seeds) > 1 else once}</p>
{confusion_spread(retrainings.confusion, evidence.kind)}
<p>The four situations ({html.escape(evidence.kind)}), as the hand receives them:</p>
{four_by_four(data, evidence.held_out)}"""


def _spread(evidence: SceneEvidence) -> str:
    parts = [
        f"{html.escape(shown(name))}: recall of a class changes by at most "
        f"{100 * one.spread.largest_spread:.1f} points"
        for name, one in evidence.headline.retrainings.items()
    ]
    return (
        f"{'; '.join(parts)} (the thesis: within 10 % per class). The two classes of nothing are "
        "at chance."
    )


def _streams(evidence: SceneEvidence) -> str:
    if not evidence.streams:
        return ""
    kind = html.escape(evidence.kind)
    parts = "".join(
        f"<h3>{html.escape(one.recording.trial_id)} ({kind})</h3>{draw.stream(one, evidence.kind)}"
        for one in evidence.streams
    )
    return f"""{heading(evidence, "Whole trials")}
<p class=key>The first pull, fall and pass of the folder, answered sample by sample by one forest
that was trained on none of them. Below, the truth in pale colour and the answer in front of it, at
the height of its name (hatched: unknown, settling). A triangle is where the decision asks the hand
to act. Dotted: critical points, which the labeller finds offline. Dashed: load onset, gross slip
and loss of contact in the truth. Right: the action alone. {key(SITUATION_COLOURS)}</p>
{parts}"""


def _made(evidence: SceneEvidence) -> str:
    made = evidence.made
    versions = ", ".join(f"{name} {version}" for name, version in made.versions.items())
    seconds = "" if made.seconds is None else f", {made.seconds:.0f} s"
    return f"""{heading(evidence, "How this was made")}
<p><code>{html.escape(made.command)}</code>, seed {made.seed}{seconds};
{html.escape(versions)}.</p>"""
