"""The tables of docs/what-accuracy-costs.md and the README's, from build/bench: `make docs`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.cost.picture import figure
from benchmarks.cost.point import GOOD, REFERENCE, SHIPPED, Point
from holdfast.core.reading import Json
from holdfast.core.writing import write_whole
from holdfast.evaluation.formats import markdown
from holdfast.evaluation.style import for_any_page
from tools.doc_tables import Tables, refresh, table, with_interval

HEADS = {
    "what": "choice",
    "step_us": "step, us",
    "kib": "model, KiB",
    "recall": "recall (95 %)",
    "acted": "acted before gross slip",
    "false_per_min": "false alarms per min",
    "delay_ms": "delay, ms",
    "macro_f1": "macro F1",
}
FRONT_HEADS = {key: head for key, head in HEADS.items() if key != "kib"} | {
    "unbeaten_in": "unbeaten in"
}
MODEL_HEADS = {"model": "model"} | {
    key: head for key, head in HEADS.items() if key != "what"
}
README_HEADS = {
    "set": "data",
    "what": "choice",
    "step_us": "step, us",
    "recall_alone": "recall",
    "acted": "acted before gross slip",
    "delay_ms": "delay, ms",
    "macro_f1": "macro F1",
}
LATENCY_HEADS = {
    "what": "what",
    "n": "calls",
    "p50": "median, us",
    "p99": "99 %, us",
    "p99.9": "99.9 %, us",
    "cold_p50": "cold median, us",
}
INSTRUCTION_HEADS = {
    "what": "what",
    "instructions": "instructions",
    "projected_cortex_a72_us": "projected to 1.5 GHz, us",
}
TRAINING_HEADS = {
    "trials": "trials",
    "windows": "windows",
    "samples": "samples",
    "simulated_cpu_s": "simulating, CPU s",
    "read_and_labelled_cpu_s": "reading and labelling, CPU s",
    "features_cpu_s": "features, CPU s",
    "forest_cpu_s": "forest, CPU s",
    "cross_validated_6_folds_cpu_s": "6-fold cross-validation, CPU s",
}
README_ROWS = (
    Point(),
    Point(debounce=2),
    Point(debounce=3),
    SHIPPED,
    Point(learner="committee", trees=8, depth=10),
    Point(learner="committee", trees=100, depth=0),
    Point(learner="network"),
    Point(trees=1),
    Point(rate_hz=50.0),
    Point(groups="raw window"),
    Point("human"),
    Point("human", learner="committee"),
    Point("human", groups="raw window"),
)
RECOMMENDED = {
    "tiny": Point(learner="committee", trees=8, depth=10),
    "default": SHIPPED,
    "best": Point(learner="committee", trees=100, depth=0),
}
SHOWN = {
    "floor": "busy-wait reference",
    "floor of the step in C": "busy-wait reference of the step in C",
    "the thesis' way": "the thesis' method",
    "a walk in C, the same trees": "plain C, the same trees",
}
"""JSON name -> what the page shows, where they differ."""


def _surface(cost: Json) -> Tables:
    """The models that are made by name, and the front and all points of each set."""
    return {
        "data": markdown(_data(cost)),
        "models": table(_models(cost["rows"]), MODEL_HEADS),
        **_set(cost, "scenes"),
        **_set(cost, "human"),
    }


def _latency(latency: Json) -> Tables:
    """One decision beside its peers, and the memory of a process."""
    heads = {
        "process": "process",
        "resident_mb": "resident memory, MB",
        "start_s": "start, s",
    }
    return {
        "latency": table(
            [_shown(row, "what") for row in latency["rows"]], LATENCY_HEADS
        ),
        "budgets": markdown(_budgets(latency["budgets"])),
        "memory": table([_process(row) for row in latency["memory"]], heads),
    }


def _instructions(figures: Json) -> Tables:
    return {"instructions": table(figures["rows"], INSTRUCTION_HEADS)}


def _training(figures: Json) -> Tables:
    return {"training": table(figures["rows"], TRAINING_HEADS)}


def readme_table(cost: Json) -> Tables:
    """The README's lines."""
    by_choice = {(row["of"], row["what"]): row for row in cost["rows"]}
    lines = [
        line(by_choice[point.of, point.what]) | {"set": _name(point)}
        for point in README_ROWS
    ]
    return {"cost": table(lines, README_HEADS)}


MADE_FROM: dict[str, Callable[[Json], Tables]] = {
    "cost.json": _surface,
    "latency.json": _latency,
    "training.json": _training,
    "instructions.json": _instructions,
}
"""The page's tables, by the file of each bench."""


def _data(cost: Json) -> list[Json]:
    """What was evaluated, and how long the surface took where one run made every point."""
    rows, took = cost["rows"], cost["took"]
    reference = next(
        row for row in rows if row["of"] == "scenes" and row["what"] == REFERENCE
    )
    about = [
        {"what": "risky slips, simulated", "value": reference["events"]},
        {"what": "simulated stream, min", "value": f"{reference['minutes']:.0f}"},
    ]
    if took["new_points"] < len(rows) or took["cores"] is None:
        return about
    minutes = f"{took['wall_s'] / 60.0:.1f} on {took['cores']} cores"
    return [
        *about,
        {
            "what": f"time of `holdfast bench cost`, {len(rows)} points, min",
            "value": minutes,
        },
    ]


def _models(rows: list[Json]) -> list[Json]:
    by_choice = {(row["of"], row["what"]): row for row in rows}
    return [
        {"model": name} | line(by_choice[point.of, point.what])
        for name, point in RECOMMENDED.items()
    ]


def _set(cost: Json, of: str) -> dict[str, str]:
    """The front and all points of one set."""
    here = [row for row in cost["rows"] if row["of"] == of]
    return {
        f"{of}-front": table(front(here, cost["fronts"][of]), FRONT_HEADS),
        f"{of}-all": table([line(row) for row in here], HEADS),
    }


def _budgets(budgets: list[Json]) -> list[Json]:
    return [
        {
            "budget": row["budget"].replace("_", " ").replace("floor", "busy wait"),
            "value": f"{row['value']:.2f}",
            "limit": row["limit"],
        }
        for row in budgets
    ]


def _shown(row: Json, key: str) -> Json:
    return row | {key: SHOWN.get(row[key], row[key])}


def _process(row: Json) -> Json:
    names = {"floor": "Python with numpy and onnxruntime"}
    return row | {"process": names.get(row["process"], row["process"])}


def front(rows: list[Json], fronts: dict[str, list[str]]) -> list[Json]:
    """Lines of all points on a front, cheapest first, each saying on which."""
    return [
        line(row)
        | {
            "unbeaten_in": ", ".join(
                GOOD[good] for good, names in fronts.items() if row["what"] in names
            )
        }
        for row in sorted(rows, key=lambda row: float(row["step_us"]))
        if any(row["what"] in names for names in fronts.values())
    ]


def short(figures: Json) -> dict[str, list[Json]]:
    """What is printed of a surface: the front of each set."""
    return {
        of: [
            {head: row.get(key) for key, head in FRONT_HEADS.items()}
            for row in front([row for row in figures["rows"] if row["of"] == of], names)
        ]
        for of, names in figures["fronts"].items()
    }


def line(row: Json) -> Json:
    """A row of the surface with its figures as the tables show them."""
    delay, kib = row["delay_ms"], row["bytes"] / 1024
    return {
        "what": row["what"],
        "step_us": row["step_us"],
        "kib": kib,
        "recall": with_interval(row["recall"], row["recall_ci"]),
        "recall_alone": row["recall"],
        "acted": row["in_time"],
        "false_per_min": row["false_per_min"],
        "delay_ms": delay["p50"] if delay else None,
        "macro_f1": row["macro_f1"],
    }


def _name(point: Point) -> str:
    return "people, real" if point.of == "human" else "scenes, simulated"


def main(folder: Path, docs: Path, readme: Path) -> None:
    """Rewrite the picture, the page's tables and the README's, where the folder has figures."""
    page, cost = docs / "what-accuracy-costs.md", folder / "cost.json"
    refresh(page, {folder / name: tables for name, tables in MADE_FROM.items()})
    refresh(readme, {cost: readme_table})
    if cost.is_file():
        drawn = figure(json.loads(cost.read_text("utf-8"))["rows"])
        write_whole(docs / "what-accuracy-costs.svg", for_any_page(drawn))


if __name__ == "__main__":
    main(*(Path(path) for path in sys.argv[1:]))
