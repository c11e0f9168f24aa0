"""Sections of a report on the closing hand, the states, and the thesis' table of outcomes."""

from __future__ import annotations

import html

from holdfast.evaluation import pictures as draw
from holdfast.evaluation.closing_hand import (
    CLOSING_S,
    LAG_S,
    MOST_N,
    STROKE_MM,
    ClosingModel,
)
from holdfast.evaluation.figures import Evaluation
from holdfast.evaluation.formats import number, percent
from holdfast.evaluation.outcomes import COLUMNS, STYLES, THESIS, OutcomeRow
from holdfast.evaluation.page import (
    Row,
    above,
    kept_cell,
    macro_f1_cell,
    spread_cell,
    table,
)
from holdfast.evaluation.report_parts import heading, kind_of
from holdfast.evaluation.scored_set import SetFigures
from holdfast.evaluation.states import ConfusionFigures
from holdfast.training.figures import ABSENT


def closing_section(of: Evaluation) -> str:
    """Which drops a closing hand would prevent, by set."""
    sets = {
        name: one.closing for name, one in of.sets.items() if one.closing is not None
    }
    if not sets:
        return ""
    lags = [f"kept, lag {lag} ms" for lag in next(iter(sets.values())).by_lag_ms]
    heads = ("set", "drops", "preventable", "kept", "kept without a slip", *lags)
    headline = of.thresholds.headline
    rows = [
        Row([html.escape(name), *_closing_cells(of.sets[name], closing, headline)])
        for name, closing in sets.items()
    ]
    errors = "; ".join(
        f"{html.escape(name)} {_error(closing.model_error_ms)}"
        for name, closing in sets.items()
    )
    return f"""{heading(of, "Would a closing hand have held the object?")}
<p>A model, not a measurement. The hand closes {STROKE_MM:g} mm in {CLOSING_S:g} s (published for
the Michelangelo hand), behind a lag of {1e3 * LAG_S:g} ms (assumed; the last columns use other
lags), to at most {MOST_N:g} N. The object is one mass on a line between the puller, or its weight,
and the friction of the grip. Preventable: a hand that closes from load onset on keeps the object. A
pull of 25 to 50 N on a grip of a few newtons is over in about 50 ms, and no such hand can hold the
object; a falling object takes longer.</p>
{table(heads, rows)}
<p class=note>Slip of the model in a hand that does nothing, minus gross slip of the truth, ms
(median, 5 to 95 %): {errors}.</p>"""


def _closing_cells(of: SetFigures, closing: ClosingModel, headline: str) -> list[str]:
    kept = of.rows[headline].closing
    assert kept is not None
    by_lag = [kept_cell(one) for one in closing.by_lag_ms.values()]
    share = above(kept_cell(kept), percent(kept.kept_share))
    drops = [f"{kept.modelled}", f"{kept.preventable}"]
    return [*drops, share, f"{kept.kept_without_a_slip}", *by_lag]


def _error(of: dict[str, float] | None) -> str:
    if not of or "p50" not in of:
        return ABSENT
    return f"{of['p50']:.0f} ({of['p5']:.0f} to {of['p95']:.0f})"


def states_section(of: Evaluation) -> str:
    """Stability, calibration and F1 of the states, and pictures of the first set."""
    stability = (
        "set",
        "load onset to first risky state, ms",
        "changes a second",
        "changes a second, truth",
        "voluntary actions with a risky sample",
    )
    quality = (
        "set",
        "calibration error",
        "calibration error, risky",
        "F1, four situations",
        "F1, seven classes",
        "F1, eight classes",
        "F1, four, at windows",
    )
    sets = of.sets.items()
    return f"""{heading(of, "The states themselves")}
<p>Per sample of every labelled phase, in natural proportion. A state is the answer to a single
sample, before any debounce. Changes a second stand beside those of the truth.</p>
{table(stability, [Row([html.escape(name), *_stability(one)]) for name, one in sets])}
{table(quality, [Row([html.escape(name), *_quality(one)]) for name, one in sets])}
<p class=note>F1 is macro F1 over the classes in the truth; below it its interval, and the classes
if one is absent. Calibration error: expected difference between
the probability and the share that came true. Seven classes count nothing once, because light and
heavy are the same signal there. At windows: only at the windows about critical points.</p>
<div class=side>{"".join(_pictures(of))}</div>"""


def _stability(of: SetFigures) -> list[str]:
    states = of.states
    return [
        spread_cell(states.to_risky_state_ms),
        number(states.changes_per_s),
        number(states.true_changes_per_s),
        percent(states.safe_acts_state_called.share),
    ]


def _quality(of: SetFigures) -> list[str]:
    calibrated, confusion = of.states.calibration, of.states.confusion
    return [
        number(calibrated.ece if calibrated else None, 3),
        number(calibrated.ece_risky if calibrated else None, 3),
        *(_f1(confusion.get(level)) for level in ("four", "seven", "eight")),
        macro_f1_cell(of.windows.heads.situations),
    ]


def _f1(level: ConfusionFigures | None) -> str:
    return "" if level is None else macro_f1_cell(level)


def _pictures(of: Evaluation) -> list[str]:
    first, figures = next(iter(of.sets.items()))
    kind = kind_of(of)
    levels = sorted(
        figures.states.confusion.items(), key=lambda pair: len(pair[1].classes)
    )
    drawn = [
        _captioned(f"{level} classes, {first}", draw.confusion(one, kind))
        for level, one in levels
    ]
    calibrated = {
        name: one.states.calibration.reliability_risky
        for name, one in of.sets.items()
        if one.states.calibration
    }
    if calibrated:
        drawn.insert(1, _captioned("calibration", draw.reliability(calibrated, kind)))
    return drawn


def _captioned(caption: str, picture: str) -> str:
    return f"<div><p class=note>{html.escape(caption)}</p>{picture}</div>"


def outcomes_section(of: Evaluation) -> str:
    """The thesis' table of outcomes beside this model's, one table a style."""
    cells = {(row.object, row.style, row.action): row for row in of.outcomes}
    if not cells:
        return ""
    styles = [
        style for style in STYLES if any(row.style == style for row in of.outcomes)
    ]
    tables = "".join(_style_table(style, cells) for style in styles)
    return f"""{heading(of, "The thesis' table of outcomes")}
<p>Left the thesis' word, right this model's, with its number of trials. ok: recognised in every
trial; part: in some; no: in none. A pull or fall is recognised where an act was requested in
it and not before. A hand-over or put-down is recognised where the state was safe_slip in it and no
act was requested. <strong>These trials are simulated</strong> in styles of the same
names, many trials each; the thesis shows a few of real people. "Every" is harder to reach in sixty
trials than in three.</p>
{tables}"""


def _style_table(style: str, cells: dict[tuple[str, str, str], OutcomeRow]) -> str:
    heads = (f"{STYLES[style]}: thesis / this model (simulated)", *COLUMNS)
    rows = [
        Row(
            [
                html.escape(name),
                *(_cell(cells.get((name, style, column))) for column in COLUMNS),
            ]
        )
        for name in THESIS
        if any((name, style, column) in cells for column in COLUMNS)
    ]
    return table(heads, rows)


def _cell(row: OutcomeRow | None) -> str:
    if row is None:
        return ""
    return above(
        f"{row.thesis} / <b>{row.ours}</b>", f"{row.recognised} of {row.trials}"
    )
