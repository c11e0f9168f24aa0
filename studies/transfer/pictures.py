"""The two pictures of docs/transfer.md: scores on people, and real beside simulated traces."""

from __future__ import annotations

from matplotlib.axes import Axes

from holdfast.core.reading import Json
from holdfast.evaluation.style import (
    GRID,
    INK,
    OURS,
    QUIET,
    WARNING,
    drawing,
    for_any_page,
    svg,
)
from studies.transfer.people import OWN_LEVEL, REAL_ONLY, TIMING

SCORES = {"macro F1, four situations": None, "AUC, risky within 0.25 s": 0.5}
"""A panel each, and what chance gives, where that is one number."""
COLOURS = {REAL_ONLY: OURS, TIMING: QUIET}
"""Of rows that are not of scenes; these have the colour of a warning."""


def worth(figures: Json) -> str:
    """Macro F1 and AUC on people of every model, with intervals over people."""
    rows = [*figures["people"]["rows"], *figures["scenes"]["rows"]]
    rows = [one for one in rows if one["row"] in COLOURS or one["scaling"] == OWN_LEVEL]
    with drawing(8.6, 0.45 * len(rows) + 1.5, font_size=11) as drawn:
        n = figures["people"]["rows"][0]["n_groups"]
        drawn.suptitle(
            f"human_slip_uskin, {n} people, real: models of people left out, and of scenes alone",
            x=0.995,
            ha="right",
            fontsize=10,
            style="italic",
        )
        panels = drawn.subplots(1, len(SCORES), sharey=True)
        for axes, (title, chance) in zip(panels, SCORES.items(), strict=True):
            _panel(axes, rows, title, chance)
        panels[0].set_yticks(range(len(rows)), [one["row"] for one in rows])
        panels[0].invert_yaxis()
        return for_any_page(svg(drawn))


def _panel(axes: Axes, rows: list[Json], title: str, chance: float | None) -> None:
    for place, row in enumerate(rows):
        value, interval = _score(row, title)
        if value is None or interval is None:
            continue
        colour = COLOURS.get(row["row"], WARNING)
        axes.plot(interval, [place, place], color=colour, linewidth=7, alpha=0.4)
        axes.plot(value, place, "o", color=INK, markersize=6)
        axes.annotate(
            f"{value:.2f}",
            (value, place),
            (0, 7),
            textcoords="offset points",
            ha="center",
            fontsize=9,
        )
    if chance is not None:
        axes.axvline(chance, color=INK, linewidth=0.8, linestyle=":")
    axes.set_title(title, fontsize=11)
    axes.set(xlim=(0.0, 1.0), ylim=(-0.7, len(rows) - 0.5), xlabel="95 % interval")
    axes.grid(axis="x", color=GRID)
    axes.set_axisbelow(True)


def _score(row: Json, title: str) -> tuple[float | None, list[float] | None]:
    if title.startswith("macro F1"):
        four = row["situations"]
        return four["macro_f1"], four["macro_f1_ci"]
    # a model without a head for it is ranked by its risky votes
    head = row.get("predict_250ms") or row["by_risky_votes"]
    return head["auc"], head["auc_ci"]


def traces(figures: Json) -> str:
    """Slips of a robot's grip, real, above simulated ones: changes from the grip, no score."""
    found = figures["traces"]
    rows = [found["real"], found["simulated"]]
    with drawing(8.6, 4.6, font_size=10) as drawn:
        panels = drawn.subplots(2, 3, sharex=True, sharey=True)
        for line, kind, axes_row in zip(
            rows, ("real, robot", "simulated"), panels, strict=True
        ):
            for axes, one in zip(axes_row, line, strict=False):
                _trace(axes, one, kind)
        panels[0][0].legend(frameon=False, fontsize=9, loc="lower left")
        drawn.supxlabel("s from the first sign of slip", fontsize=10)
        drawn.supylabel("change from the grip, over the largest", fontsize=10)
        return for_any_page(svg(drawn))


def _trace(axes: Axes, one: Json, kind: str) -> None:
    axes.axvspan(*one["slip_s"], color=WARNING, alpha=0.15, label="slip (label)")
    axes.plot(one["t_s"], one["normal"], color=OURS, label="normal force")
    axes.plot(one["t_s"], one["shear"], color=INK, linewidth=1.0, label="shear")
    axes.axhline(0.0, color=QUIET, linewidth=0.6)
    axes.set_title(f"{kind}: {one['name']}", fontsize=9)


PICTURES = {"transfer.svg": worth, "transfer-traces.svg": traces}
