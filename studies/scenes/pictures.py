"""The figures of the study of scenes as the pictures of its report."""

from __future__ import annotations

from holdfast.evaluation.style import bar
from holdfast.evaluation.window_scores import ClassScores
from studies.row_names import row_class, shown
from studies.scenes.figures import RateFigures, Rows
from studies.score_pictures import (
    RateCurve,
    ScoreBars,
    by_object,
    over_rates,
    score_bars,
)


def level_bars(rows: Rows, kind: str) -> str:
    """Scores at three levels of every row that answers with classes."""
    drawn = [
        _bars(name, row) for name, row in rows.items() if isinstance(row, ClassScores)
    ]
    return score_bars(drawn, kind)


def _bars(name: str, row: ClassScores) -> ScoreBars:
    figures = (
        (row.eight.accuracy, row.eight.accuracy_ci),
        (row.seven.accuracy, row.seven.accuracy_ci),
        (row.four.macro_f1, row.four.macro_f1_ci),
    )
    bars = (bar(value, interval, row_class(name)) for value, interval in figures)
    return ScoreBars(shown(name), *bars)


def objects_left_out(objects: dict[str, dict[str, ClassScores]], kind: str) -> str:
    """Macro F1 of each object held out; objects: row -> object -> scores."""
    return by_object({shown(name): one for name, one in objects.items()}, kind)


def rates(studies: dict[str, RateFigures], kind: str) -> str:
    """Macro F1 over the rates: every row, and the first one on unseen sets."""
    first = next(iter(studies.values()))
    held_out = [
        RateCurve(shown(name), [one.scores(name).four for one in studies.values()])
        for name, row in first.rows.items()
        if isinstance(row, ClassScores)
    ]
    ours = next(iter(first.rows))
    unseen = [
        RateCurve(
            card, [one.others[card].scores(ours).four for one in studies.values()]
        )
        for card in first.others
        if all(card in one.others for one in studies.values())
    ]
    return over_rates([float(hz) for hz in studies], held_out, unseen, kind)
