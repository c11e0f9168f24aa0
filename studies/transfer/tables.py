"""The tables of docs/transfer.md, from transfer.json."""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.core.reading import Json
from holdfast.evaluation.formats import markdown, markdown_cell
from holdfast.training.figures import ABSENT
from studies.transfer.domain import HALVES
from studies.transfer.people import OWN_LEVEL, REAL_ONLY, TIMING
from studies.transfer.scene_sets import (
    COMPARED,
    IN_FIELD,
    PINCH,
    SHIPPED,
    TOLD_APART,
    WIDE,
    noise_from_zero,
)
from studies.transfer.statistics import IN_FIELD_STATISTICS, STATISTICS
from studies.transfer.tugs import ONE_THRESHOLD
from studies.transfer.tugs import REAL_ONLY as TRIALS_ONLY

PEOPLE, TAXELS, EFLESH = "human_slip_uskin", "the same, 16 taxels", "eflesh_slip"
"""Names of the real sets among the statistics."""
WITHOUT_SCALE = (REAL_ONLY, TRIALS_ONLY, TIMING, ONE_THRESHOLD)
"""Rows of models that saw the real set's own units."""
README_ROWS = (SHIPPED, PINCH, noise_from_zero(PINCH), WIDE)
"""Of the short table."""
NO_ROWS: Json = {"rows": []}
"""Of a part that a run left out."""


def rows_on_people(figures: Json) -> list[Json]:
    """Of real-only, timing and scenes; none where a run left one of both parts out."""
    if "people" not in figures or "scenes" not in figures:
        return []
    return [*figures["people"]["rows"], *figures["scenes"]["rows"]]


def people_table(figures: Json) -> str:
    """A row for each model on people; empty without that part, and so are all tables here."""
    return _table_of(rows_on_people(figures))


def spread_table(figures: Json) -> str:
    """A row for each model of scenes with spread taxels, on half of the people."""
    return _table_of(figures.get("spread", NO_ROWS)["rows"])


def _table_of(rows: Sequence[Json]) -> str:
    lines = []
    for row in rows:
        head = row.get("predict_250ms") or {}
        votes = row.get("by_risky_votes") or {}
        four = row["situations"]
        line = {
            "trained on": row["row"],
            "scale": _scale(row),
            "macro F1": _exact(four["macro_f1"], four["macro_f1_ci"]),
            "AUC": _exact(head.get("auc"), head.get("auc_ci")),
            "AUC, risky votes": _exact(votes.get("auc"), votes.get("auc_ci")),
            "average precision": _exact(
                head.get("average_precision"), head.get("average_precision_ci")
            ),
        }
        for name in ("nothing", "grasp"):
            share = row["recall"][name]
            line[f"{name} found"] = _exact(share["share"], share["share_ci"])
        lines.append(line)
    return markdown(lines) if lines else ""


def short_table(figures: Json) -> str:
    """The README's rows: people, the clock, and each scene at its own level."""
    named = {one.name for one in README_ROWS}
    lines = []
    for row in rows_on_people(figures):
        of_scene = row["row"] in named and row["scaling"] == OWN_LEVEL
        if not of_scene and row["row"] not in WITHOUT_SCALE:
            continue
        four, head = row["situations"], row["predict_250ms"]
        votes = row.get("by_risky_votes") or {}
        nothing = row["recall"]["nothing"]
        lines.append(
            {
                "trained on": row["row"],
                "macro F1, four situations": _exact(
                    four["macro_f1"], four["macro_f1_ci"]
                ),
                "AUC, risky within 0.25 s": _exact(head["auc"], head["auc_ci"]),
                "the same by risky votes": _exact(
                    votes.get("auc"), votes.get("auc_ci")
                ),
                "nothing found": _share(nothing),
            }
        )
    return markdown(lines) if lines else ""


def tugs_table(figures: Json) -> str:
    """A row for each model on the trials of eflesh_slip."""
    lines = []
    for row in figures.get("tugs", NO_ROWS)["rows"]:
        recall = row.get("recall", {})
        lines.append(
            {
                "trained on": row["row"],
                "scale": _scale(row),
                "right, of the trials": _exact(row["accuracy"], row.get("accuracy_ci")),
                "AUC": _exact(row.get("auc"), row.get("auc_ci")),
                "tugged found": _share(recall.get("tugged")),
                "held found": _share(recall.get("held")),
            }
        )
    return markdown(lines) if lines else ""


def domain_table(figures: Json) -> str:
    """A row for each group of features, a column for each scene."""
    rows = figures.get("domain", NO_ROWS)["rows"]
    columns = [HALVES, *(one.name for one in TOLD_APART)]
    found = {(row["group"], row["scene"]): row["auc"] for row in rows}
    lines = []
    for group in dict.fromkeys(row["group"] for row in rows):
        line = {"features": group}
        for scene in columns:
            line[scene] = _number(found.get((group, scene)))
        lines.append(line)
    return markdown(lines) if lines else ""


def statistics_table(figures: Json) -> str:
    """5, 50 and 95 % of every statistic in N, and whether the scenes cover people."""
    sets = [PEOPLE, TAXELS, *(one.name for one in COMPARED)]
    return _statistics(figures, STATISTICS, sets, PEOPLE)


def field_statistics_table(figures: Json) -> str:
    """The same of clips in uT."""
    sets = [EFLESH, *(one.name for one in IN_FIELD)]
    return _statistics(figures, IN_FIELD_STATISTICS, sets, EFLESH)


def _statistics(
    figures: Json, names: dict[str, str], sets: Sequence[str], real: str
) -> str:
    part = figures.get("statistics", NO_ROWS)
    found = {}
    for row in part["rows"]:
        found[row["statistic"], row["set"]] = row
    if not found:
        return ""
    verdicts = {}
    for one in part["within"]:
        verdicts[one["statistic"], one["set"]] = one
    lines = []
    for key, words in names.items():
        line = {"5 %, median, 95 %": words}
        for name in sets:
            line[name] = _spread(found.get((key, name)))
        line["covered"] = _verdict(verdicts.get((key, real)))
        lines.append(line)
    return markdown(lines)


def _spread(row: Json | None) -> str:
    if row is None or row["p50"] is None:
        return ABSENT
    return "; ".join(markdown_cell(row[key]) for key in ("p5", "p50", "p95"))


def _verdict(one: Json | None) -> str:
    if one is None:
        return ABSENT
    if one["p5_within"] and one["p95_within"]:
        return "yes"
    ends = {"5 %": one["p5_within"], "95 %": one["p95_within"]}
    return "not " + ", ".join(end for end, inside in ends.items() if not inside)


def _scale(row: Json) -> str:
    return ABSENT if row["row"] in WITHOUT_SCALE else str(row["scaling"])


def _number(value: float | None) -> str:
    return ABSENT if value is None else f"{value:.2f}"


def _share(share: Json | None) -> str:
    return ABSENT if share is None else _exact(share["share"], share["share_ci"])


def _exact(value: float | None, interval: Sequence[float] | None) -> str:
    if value is None:
        return ABSENT
    if interval is None:
        return f"{value:.2f}"
    return f"{value:.2f} ({interval[0]:.2f} to {interval[1]:.2f})"


FUNCTIONS = {
    "transfer_people": people_table,
    "transfer_short": short_table,
    "transfer_spread": spread_table,
    "transfer_tugs": tugs_table,
    "transfer_domain": domain_table,
    "transfer_statistics": statistics_table,
    "transfer_field": field_statistics_table,
}
"""What the templates of documents call."""
