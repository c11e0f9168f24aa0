"""When an act is requested, on whole streams: edge_runtime/decision.py for many at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NOTHING, RISKY_SLIP, BoolArray
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules, period_us
from holdfast.training.recording import Recording


@dataclass(frozen=True)
class Answers:
    """One recording as it was answered, sample by sample from its first one on.

    situation: [T], UNKNOWN or 0..3. risky_permille: [T], thousandths of the votes (or of the
    probability).
    """

    recording: Recording
    situation: npt.NDArray[np.int64]
    risky_permille: npt.NDArray[np.int64]


def act_requests(
    answers: Sequence[Answers], rules: DecisionRules, min_risky_permille: Sequence[int]
) -> list[BoolArray]:
    """[T, K] a stream: whether an act is requested, at each of K confidences.

    Sample by sample the same as `decide` with neither opening command nor override.
    """
    return [_requests(one, rules, np.asarray(min_risky_permille)) for one in answers]


def _requests(
    one: Answers, rules: DecisionRules, least: npt.NDArray[np.int64]
) -> BoolArray:
    """A request lasts from its last call until release, or until evidence is missing for too long.

    An unknown sample neither calls nor releases, and breaks no run of samples that do.
    """
    known = np.flatnonzero(one.situation != UNKNOWN)
    situation, permille = one.situation[known], one.risky_permille[known, None]
    risky = (situation == RISKY_SLIP)[:, None] & (permille >= least)
    calls = _lasting(risky, rules.act_samples)
    patience = -(-1000 * rules.evidence_ms // period_us(one.recording.rate_hz))
    lets_go = _lasting(
        (situation == NOTHING)[:, None], rules.release_samples
    ) | _lasting(~risky, patience)
    requested = np.zeros((1 + len(known), len(least)), dtype=np.bool_)
    called = _last(calls)
    requested[1:] = (called > 0) & (called >= _last(lets_go))
    return requested[
        np.searchsorted(known, np.arange(len(one.situation)), side="right")
    ]


def _lasting(flags: BoolArray, samples: int) -> BoolArray:
    """[T, K] where a flag has been up for this many samples."""
    if samples <= 1:
        return flags
    return np.asarray(_turns(flags) - _last(~flags) >= samples)


def _last(flags: BoolArray) -> npt.NDArray[np.int32]:
    """[T, K] the turn, from 1, at which a flag was last up, 0 before its first."""
    return np.maximum.accumulate(np.where(flags, _turns(flags), np.int32(0)), axis=0)


def _turns(flags: BoolArray) -> npt.NDArray[np.int32]:
    return np.arange(1, 1 + len(flags), dtype=np.int32)[:, None]
