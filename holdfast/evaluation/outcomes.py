"""The thesis' table of outcomes (chapter 6) beside the same cells of this model.

ok: recognised in every trial; part: in some; no: in none. A pull or fall is recognised where an
act was requested in it and not before. A hand-over or put-down is recognised where the state was
safe_slip in it and no act was requested. The thesis judges a few trials of real
hands by eye; the trials here are many, and simulated in styles of the same names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.core.contract import SAFE_SLIP, BoolArray
from holdfast.evaluation.event_scores import match_alarms
from holdfast.evaluation.methods import (
    LabelledTrial,
)
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.evaluation.truths import style_of, voluntary_actions

ACTIONS = {
    "pass": "pass",
    "pull": "pull or fall",
    "fall": "pull or fall",
    "put-down": "put-down",
}


COLUMNS = ("pass", "pull or fall", "put-down")


STYLES = {"author": "author", "p1": "participant 1", "p2": "participant 2"}


THESIS: dict[str, dict[str, tuple[str, str, str]]] = {
    "soft-ball": {
        "author": ("part", "ok", "part"),
        "p1": ("ok", "no", "ok"),
        "p2": ("part", "ok", "ok"),
    },
    "empty-bottle": {
        "author": ("part", "ok", "ok"),
        "p1": ("no", "no", "part"),
        "p2": ("part", "part", "ok"),
    },
    "basket-ball": {
        "author": ("part", "ok", "ok"),
        "p1": ("no", "part", "ok"),
        "p2": ("part", "ok", "part"),
    },
    "hard-ball": {
        "author": ("ok", "ok", "part"),
        "p1": ("no", "no", "ok"),
        "p2": ("part", "no", "no"),
    },
    "full-bottle": {
        "author": ("ok", "ok", "ok"),
        "p1": ("part", "ok", "ok"),
        "p2": ("part", "no", "ok"),
    },
    "apple": {"author": ("ok", "ok", "ok")},
}
"""Object -> style -> (pass, pull or fall, put-down)."""


class JudgedTrial(NamedTuple):
    """A trial of a cell of the thesis' table, and whether its action was recognised."""

    object_name: str
    style: str
    column: str
    recognised: bool


@dataclass(frozen=True)
class OutcomeRow:
    """A cell of the thesis' table: its word, this model's, and how many trials were recognised."""

    object: str
    style: str
    action: str
    thesis: str
    ours: str
    recognised: int
    trials: int


def recognised(
    trial: LabelledTrial, of: ModelOutputs, requests: BoolArray
) -> bool | None:
    """Whether a trial's action was; None where it did not happen (a pull that did not slip)."""
    if trial.recording.action in ("pull", "fall"):
        one = match_alarms(trial.recording, requests)
        if not one.outcomes:
            return None
        return all(o.alarm_s is not None for o in one.outcomes) and not one.false_s
    actions = voluntary_actions(trial.recording)
    if trial.recording.action not in ACTIONS or not actions:
        return None
    states = [of.situation[one.first : one.stop] for one in actions]
    return all(bool(np.any(one == SAFE_SLIP)) for one in states) and not bool(
        requests.any()
    )


def judged_trials(
    trials: Sequence[LabelledTrial],
    outputs: Sequence[ModelOutputs],
    requests: Sequence[BoolArray],
) -> list[JudgedTrial]:
    """Every trial that has an object, a style and an action of the thesis' table."""
    judged = []
    for one, of, on in zip(trials, outputs, requests, strict=True):
        name, style = one.recording.object_name or "", style_of(one.grasps)
        right = recognised(one, of, on) if style in THESIS.get(name, {}) else None
        if right is not None:
            judged.append(
                JudgedTrial(name, style, ACTIONS[str(one.recording.action)], right)
            )
    return judged


def word(hits: Sequence[bool]) -> str:
    """ok, part or no.

    >>> word([True, True]), word([True, False]), word([False])
    ('ok', 'part', 'no')
    """
    return "ok" if all(hits) else "part" if any(hits) else "no"


def outcome_table(judged: Sequence[JudgedTrial]) -> list[OutcomeRow]:
    """One row for each cell of the thesis' table that has a trial here."""
    rows = []
    for name, styles in THESIS.items():
        for style, words in styles.items():
            for column, theirs in zip(COLUMNS, words, strict=True):
                hits = [
                    one.recognised for one in judged if one[:3] == (name, style, column)
                ]
                if hits:
                    rows.append(
                        OutcomeRow(
                            name,
                            style,
                            column,
                            theirs,
                            word(hits),
                            sum(hits),
                            len(hits),
                        )
                    )
    return rows
