"""What the report of simulated scenes is made from, and how it writes headings and figures."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from holdfast.evaluation.model_outputs import StreamPicture
from holdfast.evaluation.page import above
from holdfast.evaluation.scores import LevelScores
from holdfast.training.crossval import HeldOut
from holdfast.training.figures import ABSENT, Interval, over
from holdfast.training.recording import DataSet
from studies.scenes.figures import MadeBy, RateFigures, ScenesFigures


@dataclass(frozen=True)
class SceneEvidence:
    """Everything the report shows. data, held_out, streams: of the headline's rate.

    closed_loop: HTML of a further section; the demo shows its closed loop there.
    """

    figures: ScenesFigures
    made: MadeBy
    data: DataSet
    held_out: HeldOut
    streams: list[StreamPicture]
    closed_loop: str = ""

    @property
    def headline(self) -> RateFigures:
        """The figures of the headline's rate."""
        return self.figures.rates[self.figures.headline_hz]

    @property
    def kind(self) -> str:
        """The kind of data, shown beside every number."""
        return self.figures.kind


def heading(evidence: SceneEvidence, title: str) -> str:
    """A section's heading, which says what kind of data it shows."""
    return f"<h2>{title} <em class=note>({html.escape(evidence.kind)})</em></h2>"


def number(value: float | None) -> str:
    """A figure with three decimals; "-" where there is none."""
    return ABSENT if value is None else f"{value:.3f}"


def between(interval: Interval | None, joint: str = " to ") -> str:
    """An interval."""
    return joint.join(f"{edge:.3f}" for edge in interval) if interval else "no interval"


def macro_f1(scores: LevelScores) -> str:
    """Macro F1 at a level of classes with its interval, and over which classes if one is absent."""
    return above(
        f"{number(scores.macro_f1)} ({between(scores.macro_f1_ci, '-')})",
        over(scores.f1),
    )


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """An HTML table. heads and rows: cells of HTML."""
    lines = "\n".join("<tr>" + "".join(f"<td>{cell}" for cell in row) for row in rows)
    head = "".join(f"<th>{one}" for one in heads)
    return f"<div class=wide><table><tr>{head}\n{lines}</table></div>"
