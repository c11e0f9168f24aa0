"""What the hand would have been asked, on whole streams: the decision of edge_runtime/decision.py, many at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edge_runtime.contract import NOTHING, RISKY_SLIP, BoolArray
from edge_runtime.decision import UNKNOWN, DecisionRules
from training.recording import Recording


@dataclass(frozen=True)
class Answers:
    """One recording as it was answered, sample by sample from its first one on.

    situation: [T], UNKNOWN or 0..3. risky_permille: [T], thousandths of the votes (or of the probability).
    """

    recording: Recording
    situation: npt.NDArray[np.int64]
    risky_permille: npt.NDArray[np.int64]


def acts(answers: Sequence[Answers], rules: DecisionRules, min_risky_permille: Sequence[int]) -> list[BoolArray]:
    """[T, K] a stream: whether the hand is asked to act, for each of K confidences in place of the rules' own.

    Sample by sample the same as `decide` with neither opening command nor override.
    """
    longest = max((len(one.situation) for one in answers), default=0)
    situation = _side_by_side([one.situation for one in answers], longest, UNKNOWN)
    permille = _side_by_side([one.risky_permille for one in answers], longest, 0)
    least = np.asarray(min_risky_permille)
    risky_run = np.zeros((len(answers), len(least)), dtype=np.int64)
    nothing_run, act = np.zeros_like(risky_run), np.zeros_like(risky_run, dtype=np.bool_)
    asked = np.zeros((longest, len(answers), len(least)), dtype=np.bool_)
    for t in range(longest):
        now, known = situation[t, :, None], situation[t, :, None] != UNKNOWN
        risky = (now == RISKY_SLIP) & (permille[t, :, None] >= least)
        risky_run = np.where(known, np.where(risky, risky_run + 1, 0), risky_run)
        nothing_run = np.where(known, np.where(now == NOTHING, nothing_run + 1, 0), nothing_run)
        called = known & (risky_run >= rules.act_samples)
        act = called | (act & ~(known & (nothing_run >= rules.release_samples)))
        asked[t] = act
    return [asked[: len(one.situation), k] for k, one in enumerate(answers)]


def _side_by_side(columns: Sequence[npt.NDArray[np.int64]], longest: int, filler: int) -> npt.NDArray[np.int64]:
    """[longest, N]."""
    joined = np.full((longest, len(columns)), filler)
    for k, column in enumerate(columns):
        joined[: len(column), k] = column
    return joined
