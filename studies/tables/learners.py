"""The tables of docs/learners.md, from the JSON of three commands: `make docs`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from holdfast.core.reading import Json
from holdfast.evaluation.formats import markdown
from tools.doc_tables import Tables, refresh, table, with_interval

CASES = {
    (18, False): "real-18",
    (48, False): "real-48",
    (18, True): "real-in-hand",
}
"""Channels, and whether the truer label -> the table's name."""
STREAM_HEADS = {
    "learner": "learner",
    "step_us": "step, us",
    "recall": "recall, `daily` (95 %)",
    "in_time": "acted before gross slip",
    "false": "false alarms per min",
    "false_holds": "in disturbed holds",
    "called_author": "voluntary called, author",
    "called_daily": "voluntary called, `daily`",
}
UNSEEN_HEADS = {
    "learner": "learner",
    "recall": "recall, p1 and p2 (95 %)",
    "in_time": "acted before gross slip",
    "false": "false alarms per min",
    "called": "voluntary called (95 %)",
    "called_p1": "p1",
    "called_p2": "p2",
    "called_alike": "voluntary called at equal recall",
    "recall_left_out": "recall, style left out",
    "false_left_out": "false alarms per min, left out",
    "called_left_out": "voluntary called, left out",
}
ALIKE_RECALL = 0.98


def _on_people(figures: Json) -> Tables:
    """Every learner with its figures, and by person."""
    made = {
        CASES[one["channels"], one["in_hand"]]: markdown(
            [_row(name, row) for name, row in one["rows"].items()]
        )
        for one in figures["studied"]
    }
    return made | {"people": markdown(_people(figures["studied"][0]["people"]))}


def _row(name: str, row: Json) -> dict[str, str | None]:
    situations, head = row["situations"], row.get("predict_250ms") or {}
    return {
        "learner": name,
        "macro F1 (95 %)": with_interval(
            situations["macro_f1"], situations["macro_f1_ci"]
        ),
        "AUC (95 %)": with_interval(head.get("auc"), head.get("auc_ci")),
        "average precision (95 %)": with_interval(
            head.get("average_precision"), head.get("average_precision_ci")
        ),
    }


def _people(people: Json) -> list[dict[str, str]]:
    """Least, median and largest macro F1 of a person, and how many each learner answers best."""
    names = list(next(iter(people.values())))
    by_learner = np.array(
        [[one[name] for name in names] for one in people.values()], float
    )
    best = np.bincount(by_learner.argmax(axis=1), minlength=len(names))
    return [
        {
            "learner, label weights": name,
            "worst person": f"{by_learner[:, k].min():.3f}",
            "median person": f"{np.median(by_learner[:, k]):.3f}",
            "best person": f"{by_learner[:, k].max():.3f}",
            "people it answers best": f"{best[k]} of {len(by_learner)}",
        }
        for k, name in enumerate(names)
    ]


def _times(figures: Json) -> Tables:
    """Each learner on one row, beside the forest."""
    forest = figures["times"]["forest"]["p50_us"]
    rows = [
        {
            "one row, from features to answers": name,
            "median, us": f"{one['p50_us']:.1f}",
            "99 %, us": f"{one['p99_us']:.0f}",
            "median beside the forest": f"{one['p50_us'] / forest:.2f}",
        }
        for name, one in figures["times"].items()
    ]
    return {"time": markdown(rows)}


def _on_streams(row: Json) -> Json:
    sets = row["sets"]
    daily = sets["asked-daily"]
    return {
        "learner": row["name"],
        "step_us": f"{row['step_us']:.0f}",
        "recall": with_interval(daily["recall"], daily["recall_ci"]),
        "in_time": daily["in_time"],
        "false": daily["false_per_min"],
        "false_holds": sets["asked-holds"]["false_per_min"],
        "called_author": sets["author"]["safe_acts_called"]["share"],
        "called_daily": daily["safe_acts_called"]["share"],
    }


def _unseen(row: Json) -> Json:
    unseen, left_out = row["unseen"], row["left_out"]
    called = unseen["safe_acts_called"]
    return {
        "learner": row["name"],
        "recall": with_interval(unseen["recall"], unseen["recall_ci"]),
        "in_time": unseen["in_time"],
        "false": unseen["false_per_min"],
        "called": with_interval(called["share"], called["share_ci"]),
        "called_p1": row["sets"]["p1"]["safe_acts_called"]["share"],
        "called_p2": row["sets"]["p2"]["safe_acts_called"]["share"],
        "called_alike": _called_at(ALIKE_RECALL, row["curve"]),
        "recall_left_out": left_out["recall"],
        "false_left_out": left_out["false_per_min"],
        "called_left_out": left_out["safe_acts_called"]["share"],
    }


def _called_at(recall: float, curve: list[Json]) -> float | None:
    """Voluntary actions called at the highest threshold that leaves a recall."""
    kept = [point for point in curve if point["recall"] >= recall]
    return kept[-1]["called"] if kept else None


def _streams(figures: Json) -> Tables:
    """On whole streams, and on unseen styles."""
    return {
        "streams": table([_on_streams(row) for row in figures["rows"]], STREAM_HEADS),
        "streams-unseen": table(
            [_unseen(row) for row in figures["rows"]], UNSEEN_HEADS
        ),
    }


MADE_FROM: tuple[Callable[[Json], Tables], ...] = (_on_people, _times, _streams)
"""Of the JSON files, in the order of the command's arguments."""

if __name__ == "__main__":
    *sources, page = sys.argv[1:]
    refresh(page, dict(zip(map(Path, sources), MADE_FROM, strict=True)))
