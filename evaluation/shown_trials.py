"""Which trials a report draws: the first of each kind, chosen before any answer is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.contract import BoolArray
from holdfast.evaluation.methods import LabelledTrial
from holdfast.evaluation.model_outputs import ModelOutputs

ROWS_SHOWN = 8


class _Kind(NamedTuple):
    """An action, and an object that must (or must not) be in the hand; "": any object."""

    action: str
    object_name: str
    wanted: bool


KINDS = (
    _Kind("pass", "full-bottle", False),
    _Kind("pull", "", False),
    _Kind("fall", "", False),
    _Kind("put-down", "", False),
    _Kind("pass", "full-bottle", True),
)
"""One picture each."""


@dataclass(frozen=True)
class ShownTrial:
    """A trial to be drawn: its truth, the state and the request to act at every sample [T]."""

    trial: LabelledTrial
    situation: npt.NDArray[np.int64]
    requests: BoolArray


def shown_trials(
    trials: Sequence[LabelledTrial],
    outputs: Sequence[ModelOutputs],
    requests: Sequence[BoolArray],
) -> dict[str, list[ShownTrial]]:
    """Title -> the first trials of each kind, objects interleaved; no title without a trial."""
    shown = {}
    for kind in KINDS:
        fits = [k for k, one in enumerate(trials) if _fits(one, kind)]
        title = f"{kind.action}, {kind.object_name}" if kind.wanted else kind.action
        rows = _interleaved(trials, fits)[:ROWS_SHOWN]
        if rows:
            shown[title] = [ShownTrial(trials[k], outputs[k].situation, requests[k]) for k in rows]
    return shown


def _fits(trial: LabelledTrial, kind: _Kind) -> bool:
    recording = trial.recording
    if recording.action != kind.action:
        return False
    return not kind.object_name or (recording.object_name == kind.object_name) == kind.wanted


def _interleaved(trials: Sequence[LabelledTrial], places: Sequence[int]) -> list[int]:
    """The places, the first trial of every object before the second of any."""
    count: dict[str | None, int] = {}
    dealt = []
    for k in places:
        name = trials[k].recording.object_name
        count[name] = count.get(name, 0) + 1
        dealt.append((count[name], k))
    return [k for _, k in sorted(dealt)]
