"""The thesis' table of outcomes (chapter 6, in its own words) and ours, by the same words for the
same trials.

ok: recognised in every trial; part: in some; no: in none. A pull or fall is recognised where the
hand was asked to act in it and not before; a hand-over or put-down where the state said safe_slip
in it and the hand was never asked to act. The thesis judges by eye, few trials of real hands; ours
are simulated styles, and many more of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from edge_runtime.contract import SAFE_SLIP, BoolArray
from evaluation.event_scores import match_alarms
from evaluation.figures import LabelledTrial
from evaluation.model_outputs import ModelOutputs
from evaluation.truths import safe_acts, style_of

ACTIONS = {"pass": "pass", "pull": "pull or fall", "fall": "pull or fall", "put-down": "put-down"}
COLUMNS = ("pass", "pull or fall", "put-down")
Outcome = tuple[str, str, str, bool]
"""Object, style, column, recognised."""
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


def recognised(told: LabelledTrial, said: ModelOutputs, asked: BoolArray) -> bool | None:
    """Whether a trial's action was; None where nothing of it happened (a pull that did not
    slip)."""
    if told.recording.action in ("pull", "fall"):
        one = match_alarms(told.recording, asked)
        return (
            all(o.alarm_s is not None for o in one.outcomes) and not one.false_s
            if one.outcomes
            else None
        )
    acts = safe_acts(told.recording)
    if told.recording.action not in ACTIONS or not acts:
        return None
    seen = all(bool(np.any(said.situation[act.first : act.stop] == SAFE_SLIP)) for act in acts)
    return seen and not bool(asked.any())


def outcomes(
    told: Sequence[LabelledTrial], said: Sequence[ModelOutputs], asked: Sequence[BoolArray]
) -> list[Outcome]:
    """Every trial that has an action of the thesis' and an object of its."""
    found = []
    for one, answered, on in zip(told, said, asked, strict=True):
        name, style = one.recording.object_name or "", style_of(one.grasps)
        right = recognised(one, answered, on) if style in THESIS.get(name, {}) else None
        if right is not None:
            found.append((name, style, ACTIONS[str(one.recording.action)], right))
    return found


def word(hits: Sequence[bool]) -> str:
    """ok, part or no.

    >>> word([True, True]), word([True, False]), word([False])
    ('ok', 'part', 'no')
    """
    return "ok" if all(hits) else "part" if any(hits) else "no"


def outcome_table(found: Sequence[Outcome]) -> list[dict[str, Any]]:
    """One row a cell of the thesis' table that was asked about: its word and ours, with our
    counts."""
    rows = []
    for name, styles in THESIS.items():
        for style, words in styles.items():
            for column, theirs in zip(COLUMNS, words, strict=True):
                hits = [right for a, b, c, right in found if (a, b, c) == (name, style, column)]
                if hits:
                    rows.append(
                        {
                            "object": name,
                            "style": style,
                            "action": column,
                            "thesis": theirs,
                            "ours": word(hits),
                            "recognised": sum(hits),
                            "trials": len(hits),
                        }
                    )
    return rows
