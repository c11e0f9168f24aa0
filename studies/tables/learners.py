"""The tables of docs/learners.md: `python -m studies.tables.learners LEARNERS TIMES PAGE`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from edge_runtime.reading import Json
from evaluation.doc_tables import with_interval, write_tables
from evaluation.page import markdown

CASES = {
    (18, False): "real-18",
    (48, False): "real-48",
    (18, True): "real-in-hand",
}
"""Channels, and whether the truer label -> the table's name."""


def tables(figures: Json, times: Json) -> dict[str, str]:
    """Every learner with its figures, by person, and its time."""
    made = {
        CASES[one["channels"], one["in_hand"]]: markdown(
            [_row(name, row) for name, row in one["rows"].items()]
        )
        for one in figures["studied"]
    }
    made["people"] = markdown(_people(figures["studied"][0]["people"]))
    made["time"] = markdown(_times(times))
    return made


def _row(name: str, row: Json) -> dict[str, str | None]:
    situations, head = row["situations"], row.get("predict_250ms") or {}
    return {
        "learner": name,
        "macro F1 (95 %)": with_interval(situations["macro_f1"], situations["macro_f1_ci"]),
        "AUC (95 %)": with_interval(head.get("auc"), head.get("auc_ci")),
        "average precision (95 %)": with_interval(
            head.get("average_precision"), head.get("average_precision_ci")
        ),
    }


def _people(people: Json) -> list[dict[str, str]]:
    """Least, median and largest macro F1 of a person, and how many each learner answers best."""
    names = list(next(iter(people.values())))
    by_learner = np.array([[one[name] for name in names] for one in people.values()], float)
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


def _times(times: Json) -> list[dict[str, str]]:
    forest = times["times"]["forest"]["p50_us"]
    return [
        {
            "one row, from features to answers": name,
            "median, us": f"{one['p50_us']:.1f}",
            "99 %, us": f"{one['p99_us']:.0f}",
            "median beside the forest": f"{one['p50_us'] / forest:.2f}",
        }
        for name, one in times["times"].items()
    ]


if __name__ == "__main__":
    learners, network, page = sys.argv[1:]
    sources = [json.loads(Path(one).read_text("utf-8")) for one in (learners, network)]
    write_tables(page, tables(*sources))
