"""The report of a comparison on scenes: what was saved and blocked, and trials as they went by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from benchmarks.loop_figures import ThreeRuns
from holdfast.evaluation.style import (
    INK,
    OURS,
    QUIET,
    WARNING,
    labelled,
    svg,
    write_page,
)
from holdfast.simulation.loop.closed_loop import model_of
from studies.report import TEMPLATES
from studies.shared_control.closed_loop import FiguresByCard, LoopComparison, RunsByCard

AROUND_S = (-0.4, 1.2)
"""A trial is shown from so long before its action to so long after its beginning."""


@dataclass(frozen=True)
class ShownTrial:
    """A trial that the report draws. why: what it is the first of. picture: SVG."""

    title: str
    why: str
    picture: str


def write_loop_report(
    path: Path, comparison: LoopComparison, figures: FiguresByCard, runs: RunsByCard
) -> Path:
    """Write the report; OutputError where that cannot be done."""
    card = next(iter(figures))
    controller = comparison.controllers[0]
    return write_page(
        path,
        "loop.html",
        TEMPLATES,
        card=card,
        controller=controller,
        first=figures[card][controller],
        figures=figures,
        shown=list(_shown(runs[card][controller])),
        lag_ms=comparison.lag_ms,
        seed=comparison.seed,
        model_id=model_of(comparison.model).card.model_id,
    )


def _shown(runs: Sequence[ThreeRuns]) -> Iterator[ShownTrial]:
    """The first trials of each kind, in the order of the set."""
    kinds = {
        "preventable drop that was saved": [
            one for one in runs if one.preventable and not one.held.dropped
        ],
        "preventable drop that was lost": [
            one for one in runs if one.preventable and one.held.dropped
        ],
        "hand-over that was not blocked": [
            one for one in runs if one.hands_over("pass") and not one.blocked
        ],
        "hand-over that was blocked": [
            one for one in runs if one.hands_over("pass") and one.blocked
        ],
    }
    for what, found in kinds.items():
        if found:
            trial = found[0].held.trial
            title = f"{trial.object.name}, {trial.action}"
            yield ShownTrial(title, f"the first {what}", loop_trial(found[0]))


def loop_trial(run: ThreeRuns) -> str:
    """One trial in both hands: grip and commands above, the model's p(risky slip) below."""
    held, bare = run.held, run.bare
    t_s = held.begin_s + np.arange(len(held.grip_n)) / held.rate_hz - held.act_s
    last_s = min(AROUND_S[1], float(t_s[-1]))
    with labelled("simulated", 5.4, 3.6) as figure:
        grip, evidence = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        grip.plot(t_s, held.own_n, color=INK, linewidth=1.2, label="the wearer's own")
        grip.plot(t_s, held.grip_n, color=OURS, linewidth=2.0, label="controlled")
        commanded = np.where(held.target_n > 0.0, held.target_n, np.nan)
        grip.plot(t_s, commanded, color=OURS, linestyle="--", label="commanded")
        grip.set_ylabel("grip, N a side")
        shown = (t_s >= AROUND_S[0]) & (t_s <= last_s)
        most_n = float(np.max([held.grip_n[shown].max(), held.own_n[shown].max()]))
        commands_n = np.nan_to_num(commanded[shown])
        # a command may be far above what the drive reaches before it is withdrawn
        grip.set_ylim(
            0.0, 1.2 * max(most_n, min(float(commands_n.max()), 2.0 * most_n))
        )
        _mark(grip, bare.lost_s - held.act_s, "gone from the bare hand", QUIET, 0.98)
        _mark(grip, held.lost_s - held.act_s, "gone", WARNING, 0.85)
        grip.legend(
            frameon=False, fontsize=7, ncols=3, loc="lower left", bbox_to_anchor=(0, 1)
        )
        evidence.plot(t_s, held.p_risky, color=WARNING, linewidth=1.4)
        evidence.axhline(held.evidence_p, color=QUIET, linewidth=0.8, linestyle=":")
        evidence.set_ylim(0.0, 1.02)
        evidence.set_ylabel("p(risky slip)")
        evidence.set_xlabel("time from the beginning of the action, s")
        for axes in (grip, evidence):
            axes.axvline(0.0, color=QUIET, linewidth=0.8)
        evidence.set_xlim(AROUND_S[0], last_s)
        return svg(figure)


def _mark(axes: Axes, at_s: float, text: str, colour: str, height: float) -> None:
    """A line where the object leaves, if it does while the picture lasts."""
    if not AROUND_S[0] < at_s < AROUND_S[1]:
        return
    axes.axvline(at_s, color=colour, linewidth=1.4)
    side = "right" if at_s > 0.5 * AROUND_S[1] else "left"
    axes.annotate(
        f" {text} ",
        (at_s, height),
        xycoords=("data", "axes fraction"),
        ha=side,
        va="top",
        fontsize=7.5,
        color=INK,
    )
