"""The figures: drops saved against what it costs, and against when a hand knows of the load."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from holdfast.core.contract import Json
from holdfast.evaluation.style import INK, OURS, QUIET, drawing, svg

CHOSEN = "both"
ALONE = ("detection alone", "following alone")
FORCE_AIM_N = 3.0
NEED_AIM_N = 10.0
LINE_PX, LETTER_PX = 7.0, 6.5
"""Height of a line and width of a letter of the names, in pixels of the drawing."""


def front(rows: Sequence[Json]) -> list[Json]:
    """A point for each choice: its sets counted together; of force and grip the worst set."""
    points = []
    for label in dict.fromkeys(row["controller"] for row in rows):
        some = [row for row in rows if row["controller"] == label]
        saved = sum(row["saved"] for row in some)
        preventable = sum(row["preventable"] for row in some)
        forces_n = [row["extra_force_n_p95"] for row in some]
        over_n = [n for row in some for n in row["over_need_n_by_action"].values()]
        points.append(
            {
                "choice": label,
                "saved": saved,
                "preventable": preventable,
                "extra_force_n": max(n for n in forces_n if n is not None),
                "over_need_n": max(n for n in over_n if n is not None),
            }
        )
    return points


def picture(figures: Json) -> str:
    """The SVG: two panels, force on a receiver and grip over need."""
    rows = [row for row in figures["rows"] if row["part"] == "front"]
    points = front(rows)
    with drawing(10.0, 4.2, font_size=11) as drawn:
        force, grip = drawn.subplots(1, 2, sharey=True)
        _panel(force, points, "extra_force_n", FORCE_AIM_N)
        _panel(grip, points, "over_need_n", NEED_AIM_N)
        force.set(
            xlabel="receiver's extra force, 95 %, worst set, N",
            ylabel="preventable drops saved",
        )
        grip.set_xlabel("grip over need, median of the worst kind, N")
        others = [point["choice"] for point in points if not _is_named(point)]
        names = ", ".join(f"{k}: {name}" for k, name in enumerate(others, 1))
        force.set_title(names, fontsize=9, loc="left")
        return svg(drawn)


def knowing(figures: Json) -> str:
    """The SVG: a panel for each set, what an oracle saves that knows later; ours as a line."""
    rows = [row for row in figures["rows"] if row["part"] == "knowing"]
    names = list(dict.fromkeys(row["set"] for row in rows))
    with drawing(8.0, 3.6, font_size=11) as drawn:
        panels = drawn.subplots(1, len(names), sharey=True, squeeze=False)[0]
        for axes, name in zip(panels, names, strict=True):
            of_set = [row for row in rows if row["set"] == name]
            ours = [row for row in of_set if row["knows_after_ms"] is None]
            late = [row for row in of_set if row["knows_after_ms"] is not None]
            after_ms = [row["knows_after_ms"] for row in late]
            axes.plot(after_ms, [row["saved"] for row in late], "o-", color=QUIET)
            for row in ours:
                axes.axhline(row["saved"], color=OURS)
                axes.annotate(
                    "ours", (0.0, row["saved"]), (4, 4), textcoords="offset points"
                )
            preventable = max(row["preventable"] for row in of_set)
            axes.set_title(f"{name}: {preventable} preventable drops", loc="left")
            axes.set_xlabel("knows after load onset, ms")
            axes.set_ylim(bottom=0.0)
        panels[0].set_ylabel("drops saved")
        return svg(drawn)


def _is_named(point: Json) -> bool:
    return point["choice"] in (CHOSEN, *ALONE)


def _panel(axes: Axes, points: Sequence[Json], key: str, aim: float) -> None:
    number = 0
    names: list[tuple[tuple[float, float], str]] = []
    for point in points:
        label = point["choice"]
        at = point[key], point["saved"] / max(1, point["preventable"])
        colour = OURS if _is_named(point) else QUIET
        axes.plot(*at, "s" if label in ALONE else "o", color=colour)
        # the others lie so close that their names would cover each other
        if not _is_named(point):
            number += 1
            label = str(number)
        names.append((at, label))
    axes.axvline(aim, color=INK, linewidth=0.6, linestyle=":")
    axes.margins(0.15)
    _annotate(axes, names)


def _annotate(axes: Axes, names: Sequence[tuple[tuple[float, float], str]]) -> None:
    """Names to the right of their points; one that would cover another goes further right."""
    # matplotlib scales late: without these the places are those of an empty drawing
    axes.get_xlim(), axes.get_ylim()
    taken: list[tuple[float, float]] = []
    for (x, y), name in sorted(names):
        at, up = (float(one) for one in axes.transData.transform((x, y)))
        begin = at + 8.0
        beside = [end for other, end in taken if abs(up - other) < LINE_PX]
        begin = max([begin, *(end + LETTER_PX for end in beside if end > at)])
        taken.append((up, begin + LETTER_PX * len(name)))
        # 72 points an inch, 100 pixels an inch
        offset = 0.72 * (begin - at), -3.0
        axes.annotate(name, (x, y), offset, textcoords="offset points", fontsize=8)
