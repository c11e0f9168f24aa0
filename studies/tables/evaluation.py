"""The tables of docs/evaluation.md, from the JSON files of four commands: `make docs`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from holdfast.core.reading import Json
from holdfast.evaluation.formats import markdown
from holdfast.evaluation.method_names import DEPLOYED
from studies.row_names import OURS, RAW, shown
from studies.tables.targets import target_rows
from studies.thesis_preliminary.published import ACCURACY_PERCENT, LEARNERS
from tools.doc_tables import Tables, refresh, table, with_interval

RATE = "150"
STREAM_HEADS = {
    "recall": "recall (95 %)",
    "acted": "acted before gross slip",
    "false_per_min": "false alarms per min",
    "delay_ms": "delay, ms",
    "lead_used": "lead used",
    "voluntary": "voluntary actions called risky",
}
F1_HEADS = {
    "idea": "change",
    "f1_author": "author",
    "f1_author_past": "author, past 20 ms",
    "f1_p1": "p1",
    "f1_p2": "p2",
    "worst_object": "worst object",
    "learner_us": "learner, us",
}
ALARM_HEADS = {
    "idea": "change",
    "recall_author": "recall, author",
    "recall_unseen": "recall, unseen styles",
    "false_unseen": "false alarms per min, unseen styles",
    "false_holds": "false alarms per min, disturbed holds",
    "voluntary_author": "voluntary called risky, author",
    "voluntary_p1": "voluntary called risky, p1",
    "delay_ms": "delay, ms",
}
BOUND_HEADS = {
    "samples_late": "samples late",
    "ms_late": "late, ms",
    "f1_author": "macro F1",
}
CURVE_HEADS = {
    "trials": "trials",
    "four_ours": "four situations, ours",
    "four_raw": "four situations, raw window",
    "eight_ours": "eight classes, ours",
    "eight_raw": "eight classes, raw window",
}


def _streams(figures: Json) -> Tables:
    """What was evaluated, every method on all sets, and the file as deployed by set."""
    headline, rows = figures["thresholds"]["headline"], figures["all"]["rows"]
    first = rows[headline]
    about = [
        {"what": "model", "value": figures["model"]["model_id"]},
        {"what": "threshold", "value": figures["thresholds"]["how"]},
        {"what": "risky events", "value": first["events"]},
        {"what": "voluntary actions", "value": first["safe_acts_called"]["n"]},
    ]
    compared = figures["all"]["mcnemar"]
    methods = [
        {"method": shown(name)} | _stream(row) | {"p": compared.get(name, {}).get("p")}
        for name, row in rows.items()
    ]
    by_set = [
        {"set": name, "events": one["rows"][DEPLOYED]["events"]}
        | _stream(one["rows"][DEPLOYED])
        for name, one in figures["sets"].items()
    ]
    return {
        "streams-about": markdown(about),
        "streams": table(
            methods, {"method": "method"} | STREAM_HEADS | {"p": "McNemar p"}
        ),
        "streams-by-set": table(
            by_set, {"set": "set", "events": "events"} | STREAM_HEADS
        ),
    }


def _stream(row: Json) -> Json:
    delay, used, voluntary = row["delay_ms"], row["lead_used"], row["safe_acts_called"]
    return {
        "recall": with_interval(row["recall"], row["recall_ci"]),
        "acted": row["in_time"],
        "false_per_min": row["false_per_min"],
        "delay_ms": delay["p50"] if delay else None,
        "lead_used": used["p50"] if used else None,
        "voluntary": voluntary["share"],
    }


def _fast_handover(figures: Json) -> Tables:
    """Every change, the bounds and the targets."""
    rows = figures["rows"]
    return {
        "handover-f1": table(rows, F1_HEADS),
        "handover-alarms": table([_alarms(row) for row in rows], ALARM_HEADS),
        "handover-bounds": table(figures["bounds"], BOUND_HEADS),
        "handover-targets": markdown(target_rows(rows)),
    }


def _alarms(row: Json) -> Json:
    author, unseen = row["author"], row["unseen_style"]
    return {
        "idea": row["idea"],
        "recall_author": author["recall"],
        "recall_unseen": unseen["recall"],
        "false_unseen": unseen["false_per_min"],
        "false_holds": row["asked-holds"]["false_per_min"],
        "voluntary_author": author["safe_acts_called"]["share"],
        "voluntary_p1": row["p1"]["safe_acts_called"]["share"],
        "delay_ms": author["delay_ms"]["p50"],
    }


def _generalisation(figures: Json) -> Tables:
    """Trials, objects and styles left out, fewer trials, other seeds."""
    rate = figures["rates"][RATE]
    curve = [_curve_point(row) for row in rate["learning_curve"]]
    spread = {name: one["spread"] for name, one in rate["retrainings"].items()}
    by_class = [
        {"class": name.replace("_", " ")}
        | {shown(row): one[name] for row, one in spread.items()}
        for name in next(iter(spread.values()))
    ]
    return {
        "generalisation": markdown(
            [_split(name, rows) for name, rows in _splits(rate)]
        ),
        "learning-curve": table(curve, CURVE_HEADS),
        "retrainings": markdown(by_class),
    }


def _splits(rate: Json) -> list[tuple[str, Json]]:
    """What was held out, and the rows of that."""
    objects, styles = rate["objects"], rate.get("styles", {})
    return [
        ("trials held out", rate["rows"]),
        *(
            (f"object left out: {name}", {row: by[name] for row, by in objects.items()})
            for name in objects[OURS]
        ),
        *((f"style left out: {name}", one["rows"]) for name, one in styles.items()),
        *(
            (f"trained on the author, evaluated on {name}", one["rows"])
            for name, one in rate["others"].items()
        ),
    ]


def _split(name: str, rows: Json) -> Json:
    ours, raw = rows[OURS]["four"], rows[RAW]["four"]
    return {
        "split": name,
        "ours (95 %)": with_interval(ours["macro_f1"], ours["macro_f1_ci"]),
        "raw-window forest (95 %)": with_interval(raw["macro_f1"], raw["macro_f1_ci"]),
    }


def _curve_point(row: Json) -> Json:
    pairs = [
        (level, name, key) for level in ("four", "eight") for name, key in ROWS.items()
    ]
    return {"trials": row["trials"]} | {
        f"{level}_{name}": row[key][level]["macro_f1"] for level, name, key in pairs
    }


ROWS = {"ours": OURS, "raw": RAW}


def _preliminary(figures: Json) -> Tables:
    """Every case: the thesis' own figures, and a row a set."""
    rows = []
    for case in figures["sets"][0]["cases"]:
        published = ACCURACY_PERCENT.get(case, (None,) * len(LEARNERS))
        rows.append({"case": case, "set": "the thesis, published"})
        rows[-1] |= dict(zip(LEARNERS, published, strict=True))
        for one in figures["sets"]:
            learners = one["cases"][case]["learners"]
            rows.append({"case": case, "set": one["data"]})
            rows[-1] |= {
                name: 100.0 * learners[name]["accuracy"]["mean"] for name in LEARNERS
            }
    return {"preliminary": markdown(rows)}


def _relative_rotation(figures: Json) -> Tables:
    """human_slip_uskin labelled by the object's rotation relative to the hand."""
    rows = [
        {
            "method": shown(name),
            "macro F1 (95 %)": with_interval(one["macro_f1"], one["macro_f1_ci"]),
            "AUC, risky within 0.25 s (95 %)": with_interval(
                head["auc"], head["auc_ci"]
            ),
        }
        for name, row in figures["rows"].items()
        for one, head in [(row["situations"], row["predict_250ms"])]
    ]
    counts = [
        {"situation": name.replace("_", " "), "windows": f"{count:,}"}
        for name, count in figures["windows"].items()
    ]
    return {
        "relative-rotation-windows": markdown(counts),
        "relative-rotation": markdown(rows),
    }


MADE_FROM: tuple[Callable[[Json], Tables], ...] = (
    _streams,
    _fast_handover,
    _generalisation,
    _preliminary,
    _relative_rotation,
)
"""Of the JSON files, in the order of the command's arguments."""

if __name__ == "__main__":
    *sources, target = sys.argv[1:]
    refresh(target, dict(zip(map(Path, sources), MADE_FROM, strict=True)))
