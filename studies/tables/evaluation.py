"""docs/evaluation.md: what a user feels, what helps and what does not, how far it carries, written
by `make docs`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from evaluation.page import markdown
from studies.scenes.study import OURS, RAW
from studies.thesis_preliminary.published import ACCURACY_PERCENT, LEARNERS

INTRO = """# Evaluation

Written by `make docs` from `make evaluate`, `make wall`, `make scenes` and `make preliminary`. Unless a table says
otherwise **everything here is simulated**: styles (`author`, `p1`, `p2`) are ranges of parameters, not people. Public
real recordings: the [README's table](../README.md) and the report of `make evaluate`.
"""
RATE = "150"
TARGETS = (
    ("four situations, macro F1, trials held out", 0.97, "at_least", ("f1_author",)),
    ("the same, style never met (worse of two)", 0.94, "at_least", ("f1_p1", "f1_p2")),
    ("worst object left out, macro F1", 0.88, "at_least", ("worst_object",)),
    (
        "risky slips found, disturbed holds and author",
        0.99,
        "at_least",
        ("author.recall", "asked-holds.recall"),
    ),
    ("false alarms a minute, disturbed holds", 0.5, "at_most", ("asked-holds.false_per_min",)),
    ("risky slips found, style never met", 0.99, "at_least", ("unseen_style.recall",)),
    ("false alarms a minute, style never met", 1.0, "at_most", ("unseen_style.false_per_min",)),
    ("safe acts called risky, author", 0.05, "at_most", ("author.safe_acts_called.share",)),
    ("safe acts called risky, fast passer (p1)", 0.25, "at_most", ("p1.safe_acts_called.share",)),
    (
        "ms from load onset to the first risky state, median",
        7.0,
        "at_most",
        ("state_delay_ms.p50",),
    ),
    ("specificity under dFn", 0.95, "at_least", ("asked-holds.specificity.dFn.share",)),
    ("specificity under dFt", 0.95, "at_least", ("asked-holds.specificity.dFt.share",)),
    ("specificity under dq", 0.95, "at_least", ("asked-holds.specificity.dq.share",)),
)
"""What was aimed at, the aim, its side, and where the figure stands (of several the worst
counts)."""


def page(
    evaluated: dict[str, Any],
    wall: dict[str, Any],
    scenes: dict[str, Any],
    preliminary: dict[str, Any],
    truer: dict[str, Any],
) -> str:
    """The whole page, from the JSON of each command."""
    rate = scenes["rates"][RATE]
    parts = [
        *_streams(evaluated),
        *_wall(wall),
        *_carries(rate),
        *_preliminary(preliminary),
        *_truer(truer),
    ]
    return "\n\n".join([INTRO.rstrip(), *parts]) + "\n"


def _streams(figures: dict[str, Any]) -> list[str]:
    """Whole streams, ours beside its rivals, and ours by set."""
    headline = figures["thresholds"]["headline"]
    rows = figures["all"]["rows"]
    beside = [
        {"line": name}
        | _line(row)
        | {"mcnemar_p": figures["all"]["mcnemar"].get(name, {}).get("p")}
        for name, row in rows.items()
    ]
    by_set = [{"set": name} | _line(one["rows"][headline]) for name, one in figures["sets"].items()]
    return [
        "## Whole streams, beside rivals",
        f"Model {figures['model']['model_id']} on sets simulated from seeds it never met. Threshold: "
        f"{figures['thresholds']['how']}. *found*: asked to act between load onset and loss of contact; *in time*: "
        "before all fingers slide. An alarm holds until the load falls. McNemar: events found, against the first.",
        markdown(beside),
        f"By set, {headline}:",
        markdown(by_set),
    ]


def _line(row: dict[str, Any]) -> dict[str, Any]:
    delay, used, safe = row["delay_ms"], row["lead_used"], row["safe_acts_called"]
    return {
        "events": row["events"],
        "found": row["recall"],
        "found_95": _range(row["recall_ci"]),
        "in_time": row["in_time"],
        "false_per_min": row["false_per_min"],
        "act_after_onset_ms": delay["p50"] if delay else None,
        "lead_used": used["p50"] if used else None,
        "safe_acts_called": safe["share"],
        "of": safe["n"],
    }


def _range(interval: list[float] | None) -> str:
    return f"{interval[0]:.2f} to {interval[1]:.2f}" if interval else "-"


def _wall(figures: dict[str, Any]) -> list[str]:
    """Ideas, bounds and targets."""
    rows = [
        {
            "idea": row["idea"],
            "f1_author": row["f1_author"],
            "f1_past_20_ms": row["f1_author_past"],
            "f1_p1": row["f1_p1"],
            "f1_p2": row["f1_p2"],
            "worst_object": row.get("worst_object"),
            "found_author": row["author"]["recall"],
            "found_unseen": row["unseen_style"]["recall"],
            "false_per_min_unseen": row["unseen_style"]["false_per_min"],
            "false_per_min_holds": row["asked-holds"]["false_per_min"],
            "safe_called_author": row["author"]["safe_acts_called"]["share"],
            "safe_called_p1": row["p1"]["safe_acts_called"]["share"],
            "act_ms": row["author"]["delay_ms"]["p50"],
            "learner_us": row["learner_us"],
        }
        for row in figures["rows"]
    ]
    return [
        "## Moving the wall",
        "One change of the default at a time (studies/fast_handover/ideas.py), trained on the same trials but for what "
        "is changed, the threshold chosen on other streams at half a false alarm a minute. F1 over four situations at "
        "windows about critical points, held against the truth of the moment; *past 20 ms*: those at least 20 ms after "
        "a change of phase. The learner's microseconds are of its trees alone, in turns. How far back features look, "
        "which groups and how many trees: [what accuracy costs](what-accuracy-costs.md).",
        markdown(rows),
        "What nobody can do better: an observer who knows the truth, but so many samples late, on the same windows.",
        markdown(figures["bounds"]),
        "### Targets",
        markdown(targets(figures["rows"])),
    ]


def targets(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each target beside the default and the best of the ideas, and which idea that is."""
    table = []
    for what, aim, side, places in TARGETS:
        sign = 1.0 if side == "at_least" else -1.0
        told = [(row["idea"], [_at(row, place) for place in places]) for row in rows]
        known = [
            (idea, min(values, key=lambda v: sign * v))
            for idea, values in told
            if None not in values
        ]
        best = max(known, key=lambda one: sign * one[1])
        default = dict(known)[rows[0]["idea"]]
        met = "yes" if sign * default >= sign * aim else "no"
        told_aim = f"{'>=' if sign > 0 else '<='} {aim:g}"
        table.append(
            {
                "target": what,
                "aim": told_aim,
                "default": default,
                "met": met,
                "best": best[1],
                "by": best[0],
            }
        )
    return table


def _at(row: dict[str, Any], place: str) -> Any:
    found: Any = row
    for name in place.split("."):
        found = None if found is None else found.get(name)
    return found


def _carries(rate: dict[str, Any]) -> list[str]:
    """How far it carries: trials, objects, styles, an object and styles never met, fewer trials,
    retrainings."""
    pairs = {"ours": OURS, "raw_window": RAW}
    held = [("trials held out", rate["rows"])]
    held += [
        (
            f"object left out: {name}",
            {line: objects[name] for line, objects in rate["objects"].items()},
        )
        for name in rate["objects"][OURS]
    ]
    held += [
        (f"style left out: {name}", one["rows"]) for name, one in rate.get("styles", {}).items()
    ]
    held += [
        (f"trained on the author, asked about {name}", one["rows"])
        for name, one in rate["others"].items()
    ]
    rows = [
        {"split": split}
        | {f"f1_{name}": told[line]["four"]["macro_f1"] for name, line in pairs.items()}
        | {
            f"f1_{name}_95": _range(told[line]["four"]["macro_f1_ci"])
            for name, line in pairs.items()
        }
        for split, told in held
    ]
    curve = [
        {"trials": row["trials"]}
        | {
            f"f1_{level}_{name}": row[line][level]["macro_f1"]
            for level in ("four", "eight")
            for name, line in pairs.items()
        }
        for row in rate["learning_curve"]
    ]
    spread = [{"line": name} | one["spread"] for name, one in rate["retrainings"].items()]
    return [
        "## How far it carries",
        f"The study of `make scenes` at {RATE} Hz: forests of the plan for people (docs/decisions.md) on balanced "
        "windows at critical points, macro F1 over four situations.",
        markdown(rows),
        "So many trials (the thesis had 600, then 1000), trials held out:",
        markdown(curve),
        "Five retrainings with other seeds: largest minus smallest recall of each class.",
        markdown(spread),
    ]


def _preliminary(figures: dict[str, Any]) -> list[str]:
    """The thesis' preliminary study again."""
    rows = []
    for case in figures["sets"][0]["cases"]:
        published = ACCURACY_PERCENT.get(case, (None,) * len(LEARNERS))
        rows.append(
            {"case": case, "set": "thesis, published"} | dict(zip(LEARNERS, published, strict=True))
        )
        for one in figures["sets"]:
            learners = one["cases"][case]["learners"]
            rows.append(
                {"case": case, "set": f"{one['data']} ({one['kind']})"}
                | {name: 100.0 * learners[name]["accuracy"]["mean"] for name in LEARNERS}
            )
    return [
        "## The preliminary study again",
        "Accuracy in %, mean of five repetitions, trials or people held out; chance is 50, in case 5 25. What differs "
        "from the thesis' set-up stands in the report of `make preliminary`.",
        markdown(rows),
    ]


def _truer(figures: dict[str, Any]) -> list[str]:
    """human_slip_uskin by the object's rotation in the hand."""
    rows = [
        {
            "line": name,
            "macro_f1": row["situations"]["macro_f1"],
            "macro_f1_95": _range(row["situations"]["macro_f1_ci"]),
            "auc_250_ms": row["predict_250ms"]["auc"],
            "auc_95": _range(row["predict_250ms"]["auc_ci"]),
        }
        for name, row in figures["rows"].items()
    ]
    counts = ", ".join(f"{count:,} {name}" for name, count in figures["windows"].items())
    return [
        "## People, by a truer label",
        "Public real data (human_slip_uskin, 18 channels, people held out), labelled by the object's rotation in the "
        "hand, from both IMUs, so that the wrist has no part in it. The logger rounds to 0.01 and refreshes at 15 to "
        f"25 Hz: this label is noisier than the README's. Windows: {counts}.",
        markdown(rows),
    ]


if __name__ == "__main__":
    sys.stdout.write(page(*(json.loads(Path(path).read_text("utf-8")) for path in sys.argv[1:])))
