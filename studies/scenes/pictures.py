"""The figures of the study of scenes as the pictures of its report."""

from __future__ import annotations

from typing import Any

from evaluation.score_pictures import RateCurve, ScoreBars, by_object, over_rates, score_bars
from evaluation.style import Bar
from studies.row_names import row_class, shown

BARS = (("eight", "accuracy"), ("seven", "accuracy"), ("four", "macro_f1"))


def level_bars(rows: dict[str, Any], kind: str) -> str:
    """Scores at three levels of every row that answers with classes."""
    drawn = []
    for name, row in rows.items():
        if "eight" in row:
            of = (Bar(row[a][b], row[a][f"{b}_ci"], row_class(name)) for a, b in BARS)
            drawn.append(ScoreBars(shown(name), *of))
    return score_bars(drawn, kind)


def objects_left_out(objects: dict[str, dict[str, Any]], kind: str) -> str:
    """Macro F1 of each object held out; objects: row -> object -> scores."""
    return by_object({shown(name): one for name, one in objects.items()}, kind)


def rates(studies: dict[str, Any], kind: str) -> str:
    """Macro F1 over the rates: every row, and the first one on unseen sets."""
    first = next(iter(studies.values()))
    held_out = [
        RateCurve(shown(name), [one["rows"][name]["four"] for one in studies.values()])
        for name, row in first["rows"].items()
        if "four" in row
    ]
    ours = next(iter(first["rows"]))
    unseen = [
        RateCurve(card, [one["others"][card]["rows"][ours]["four"] for one in studies.values()])
        for card in first["others"]
        if all(card in one["others"] for one in studies.values())
    ]
    return over_rates([float(hz) for hz in studies], held_out, unseen, kind)
