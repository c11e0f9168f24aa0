"""Verification of an adapted file: every label and vote equals the reference, all else the base.

Base and adapted file answer the same rows, from the tensor `features` on. The reference takes the
base's own votes, which its export has verified, and corrects them in numpy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx

from holdfast.edge_runtime.errors import VerificationFailed
from holdfast.edge_runtime.golden import golden_input
from holdfast.edge_runtime.graph import Outputs, open_session, run_recording
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.export.correction import Correction, corrected_votes
from holdfast.export.hard_rows import edge_rows, step_rows
from holdfast.export.network import Inputs
from holdfast.export.reference import FloatRows, riskier_argmax, situation_votes, weighted
from holdfast.export.verify import cut_learners

CHUNK, SINGLE_ROWS = 4096, 1_000
OF_THE_VOTES = ("votes", "situation", "p_situation", "p_class", "weight")


@dataclass(frozen=True)
class AdaptedVerification:
    """What was compared, as counts. rows: given and hard ones. changed: labels that differ from
    the base's. samples: of streams."""

    rows: int
    single_rows: int
    samples: int
    changed: int


def verify_adapted(
    base: bytes, data: bytes, card: ModelCard, correction: Correction | None, rows: FloatRows
) -> AdaptedVerification:
    """Compare an adapted file with the reference. rows: [N, F] features. Raises
    VerificationFailed."""
    before, after = (open_session(cut_learners(onnx.load_from_string(one))) for one in (base, data))
    hard = np.concatenate([rows, _hard_rows(correction, rows)])
    old, new = _answers(before, hard, CHUNK), _answers(after, hard, CHUNK)
    expected = _expected(correction, hard, old["votes"])
    label = _label(card, expected)
    _require(np.array_equal(new["votes"], expected), "votes")
    _require(np.array_equal(new["situation"], label), "labels")
    for name in set(old) - ({*OF_THE_VOTES} if correction else set()):
        _require(old[name].tobytes() == new[name].tobytes(), name)
    chosen = np.random.default_rng(0).choice(len(hard), min(SINGLE_ROWS, len(hard)), replace=False)
    for name, value in _answers(after, hard[chosen], 1).items():
        _require(value.tobytes() == new[name][chosen].tobytes(), f"{name} of single rows")
    samples = _require_same_streams(base, data, card, correction)
    changed = int((new["situation"] != old["situation"])[: len(rows)].sum())
    return AdaptedVerification(len(hard), len(chosen), samples, changed)


def _hard_rows(correction: Correction | None, rows: FloatRows) -> FloatRows:
    edges = edge_rows(rows.shape[1])
    if correction is None:
        return edges
    of_all, n = correction.network.inputs, rows.shape[1]
    inputs = Inputs(of_all.knee[:n], of_all.gain[:n], of_all.offset[:n])
    return np.concatenate([edges, step_rows(inputs, rows, 0)])


def _answers(session: Any, rows: FloatRows, chunk: int) -> Outputs:
    names = [output.name for output in session.get_outputs()]
    parts = [
        session.run(names, {"features": rows[k : k + chunk]}) for k in range(0, len(rows), chunk)
    ]
    return {name: np.concatenate([part[k] for part in parts]) for k, name in enumerate(names)}


def _expected(
    correction: Correction | None, rows: FloatRows, votes: npt.NDArray[Any]
) -> npt.NDArray[np.int64]:
    whole = votes.astype(np.int64)
    return whole if correction is None else corrected_votes(correction, rows, whole)


def _label(card: ModelCard, votes: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    weights = card.raw["heads"]["situation"].get("label_weights")
    given = None if weights is None else tuple(weights)
    return riskier_argmax(weighted(situation_votes(votes), given))


def _require_same_streams(
    base: bytes, data: bytes, card: ModelCard, correction: Correction | None
) -> int:
    """The golden input through both whole steps; returns its length in samples."""
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
    streams = []
    for one in (base, data):
        session = open_session(one)
        names = [out.name for out in session.get_outputs() if out.name != "state_out"]
        streams.append(run_recording(session, values, valid, names))
    old, new = streams
    expected = _expected(correction, old["features"], old["votes"])
    _require(np.array_equal(new["votes"], expected), "votes of a stream")
    for name in set(old) - {*OF_THE_VOTES}:
        _require(old[name].tobytes() == new[name].tobytes(), f"{name} of a stream")
    return len(values)


def _require(same: bool, what: str) -> None:
    if not same:
        raise VerificationFailed(
            f"the adapted file: {what} differ from the reference",
            cause="a runtime that computes differently",
            next_step="report the versions that holdfast doctor prints",
        )
