"""Verification: a file that disagrees with the reference on any label is not written.

The learner is cut out of the file itself at the tensor `features`, the labels at `votes`. Rows come
from windows, from the trees' own thresholds +- 1 ulp, and from the limits of float32.

What a verification compared, as counts; `dataclasses.asdict` gives its JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx.utils import Extractor

from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.core.errors import VerificationFailed
from holdfast.edge_runtime.graph import BATCH, StepGraph, open_session, run_recording
from holdfast.edge_runtime.model import golden_input
from holdfast.export.forest import FOREST_KINDS, Forest
from holdfast.export.heads import MAIN_HEAD, Head
from holdfast.export.learner import reference_votes
from holdfast.export.reference import (
    FloatRows,
    reference_flags,
    reference_heavy,
    reference_label,
    reference_probability,
    riskier_argmax,
)
from holdfast.export.spec import StepSpec
from holdfast.export.structure import hard_rows, require_same_numbers


@dataclass(frozen=True)
class PredictDisagreement:
    """How often scikit-learn's predict gives another class. share_off_ties: 0 to 1."""

    share_off_ties: float
    ties: int
    differs_on_ties: int


@dataclass(frozen=True)
class HeadVerification:
    """One head of a file beside the reference. rows: given rows, thresholds and edges together.

    predict_disagreement: None but for a forest alone. nodes: of its trees, and weights of its
    network, each compared.
    """

    rows: int
    label_mismatches: int
    vote_mismatches: int
    predict_disagreement: PredictDisagreement | None
    nodes: int


@dataclass(frozen=True)
class Verification:
    """A whole file beside the reference. given_rows: feature rows of windows.

    single_rows: rows computed alone and in a batch. stream_samples: samples of all streams.
    """

    given_rows: int
    heads: dict[str, HeadVerification]
    ties_checked: int
    single_rows: int
    stream_samples: int


@dataclass(frozen=True)
class ExportReport(Verification):
    """A verified file that was written. bytes: its size."""

    bytes: int

    @staticmethod
    def of(verification: Verification, n_bytes: int) -> ExportReport:
        """The report of a written file."""
        return ExportReport(**vars(verification), bytes=n_bytes)


SINGLE_ROWS = 2_000
PROBABILITY_TOLERANCE = 1e-5
"""Probabilities are float32 in the file and float64 in the reference."""
CHUNK = 4096
OF_THE_STEP = (
    "settled",
    "unknown",
    "usable_sensors",
    "detectors",
    "features",
    "state_out",
)
"""Outputs that exist without a forest."""


def verify(
    model: onnx.ModelProto,
    spec: StepSpec,
    heads: list[Head],
    rows: FloatRows,
    seed: int = 0,
    *,
    say: Callable[[str], None] = lambda line: None,
) -> Verification:
    """Compare file and reference; returns counts, raises VerificationFailed on any disagreement.

    rows: [N, F] feature rows of windows (in cross-validation: all held-out ones). say: called with
    what begins now.
    """
    learners = open_session(cut_learners(model))
    compared: dict[str, HeadVerification] = {}
    single = 0
    for head in heads:
        say(f"verifying head {head.name} on {len(rows)} rows and on its own thresholds")
        hard = np.concatenate([rows, hard_rows(head.learner, rows, seed)])
        votes = _run(learners, hard, CHUNK)
        nodes = require_same_numbers(model, head, _votes(head))
        compared[head.name] = _compare(head, hard, votes, len(rows), nodes)
        single += _compare_single(learners, hard, votes, seed)
    say("verifying ties, and streams of one hand against a batch")
    ties = _check_ties(model, heads)
    return Verification(
        len(rows), compared, ties, single, _compare_streams(model, spec, seed)
    )


def cut_learners(model: onnx.ModelProto) -> bytes:
    """The learners, labels and probabilities alone, from the tensor `features` [B, F] on."""
    outputs = [
        output.name for output in model.graph.output if output.name not in OF_THE_STEP
    ]
    return _cut(model, ["features"], outputs)


def _votes(head: Head) -> str:
    return "votes" if head.name == MAIN_HEAD else f"votes_{head.name}"


def _cut(model: onnx.ModelProto, inputs: list[str], outputs: list[str]) -> bytes:
    cut: onnx.ModelProto = Extractor(
        onnx.shape_inference.infer_shapes(model)
    ).extract_model(inputs, outputs)
    return cut.SerializeToString()


def _run(session: Any, rows: FloatRows, chunk: int) -> dict[str, npt.NDArray[Any]]:
    (name,) = [i.name for i in session.get_inputs()]
    names = [o.name for o in session.get_outputs()]
    parts = [
        session.run(None, {name: rows[k : k + chunk]})
        for k in range(0, len(rows), chunk)
    ]
    return {n: np.concatenate([part[i] for part in parts]) for i, n in enumerate(names)}


def _compare(
    head: Head,
    rows: FloatRows,
    answers: dict[str, npt.NDArray[Any]],
    given: int,
    nodes: int,
) -> HeadVerification:
    expected = reference_votes(head.learner, rows, len(head.classes))
    got = answers[_votes(head)]
    wrong_votes = int(np.any(got != expected, axis=1).sum())
    label = reference_label(head, expected)
    answered = (
        answers["situation"]
        if head.name == MAIN_HEAD
        else riskier_argmax(got.astype(np.int64))
    )
    wrong = int((label != answered).sum())
    wrong_others = _wrong_others(head, expected, answers)
    if wrong or wrong_votes or wrong_others:
        raise VerificationFailed(
            f"head {head.name}: {wrong} labels, {wrong_votes} votes "
            f"and {wrong_others} other outputs of {len(rows)} rows differ",
            cause="a converter or runtime that treats the learner differently",
            next_step="report the versions that holdfast doctor prints",
        )
    forest = head.learner
    plain = (
        _disagreement(forest, rows[:given], expected[:given])
        if isinstance(forest, FOREST_KINDS)
        else None
    )
    return HeadVerification(len(rows), wrong, wrong_votes, plain, nodes)


def _wrong_others(
    head: Head, votes: npt.NDArray[np.int64], answers: dict[str, npt.NDArray[Any]]
) -> int:
    """Rows with probabilities beyond PROBABILITY_TOLERANCE, or with a wrong weight."""
    probability = reference_probability(head, votes)
    if head.name != MAIN_HEAD:
        return _far(answers[head.name], probability[:, 1])
    if head.classes != CLASSES:
        return _far(answers["p_situation"], probability)
    by_situation = probability.reshape(len(votes), -1, 2).sum(axis=2)
    wrong_weight = int((answers["weight"] != reference_heavy(votes)).sum())
    return (
        _far(answers["p_class"], probability)
        + _far(answers["p_situation"], by_situation)
        + wrong_weight
    )


def _far(got: npt.NDArray[Any], expected: npt.NDArray[np.float64]) -> int:
    apart = np.abs(got - expected).reshape(len(got), -1).max(axis=1)
    return int(np.sum(~(apart <= PROBABILITY_TOLERANCE)))


def _disagreement(
    forest: Forest, rows: FloatRows, votes: npt.NDArray[np.int64]
) -> PredictDisagreement:
    """How often scikit-learn's predict gives another class."""
    plain = np.asarray(forest.predict(rows))
    top = np.sort(votes, axis=1)
    tied = top[:, -1] == top[:, -2]
    differs = plain != riskier_argmax(votes)
    return PredictDisagreement(
        share_off_ties=float((differs & ~tied).sum() / max(1, (~tied).sum())),
        ties=int(tied.sum()),
        differs_on_ties=int((differs & tied).sum()),
    )


def _compare_single(
    session: Any, rows: FloatRows, many: dict[str, npt.NDArray[Any]], seed: int
) -> int:
    """B = 1 equals B = many, bit for bit, on every output of the forests."""
    chosen = np.random.default_rng(seed).choice(
        len(rows), size=min(SINGLE_ROWS, len(rows)), replace=False
    )
    ones = _run(session, rows[chosen], 1)
    for name, value in ones.items():
        _require_same(name, value, many[name][chosen])
    return len(chosen)


def _require_same(name: str, one: npt.NDArray[Any], many: npt.NDArray[Any]) -> None:
    if one.tobytes() != np.ascontiguousarray(many).tobytes():
        raise VerificationFailed(
            f"output {name!r}: a single row and a batch differ",
            cause="an operator that rounds differently by batch size",
            next_step="report the versions that holdfast doctor prints",
        )


def _check_ties(model: onnx.ModelProto, heads: list[Head]) -> int:
    """Feed exact ties between situations in at `votes`: the riskier one must win."""
    (main,) = [head for head in heads if head.name == MAIN_HEAD]
    session = open_session(_cut(model, ["votes"], ["situation"]))
    votes = np.array(list(_tied_votes(len(main.classes))), dtype=np.float32)
    (got,) = session.run(None, {"votes": votes})
    if not np.array_equal(got, reference_label(main, votes.astype(np.int64))):
        raise VerificationFailed(
            "the riskier class does not win ties", next_step="report this"
        )
    return len(votes)


def _tied_votes(n_classes: int) -> Iterator[npt.NDArray[np.int64]]:
    """Votes for every set of situations that can tie, the other situations behind them."""
    per = n_classes // len(SITUATIONS)
    for members in range(1, 2 ** len(SITUATIONS)):
        votes = np.full(len(SITUATIONS), 1000, dtype=np.int64)
        votes[[k for k in range(len(SITUATIONS)) if members >> k & 1]] = 4096
        yield np.repeat(votes // per, per)


def _compare_streams(model: onnx.ModelProto, spec: StepSpec, seed: int) -> int:
    """Run the whole step: flags follow the rule, and one recording equals the same in a batch."""
    session = open_session(model.SerializeToString())
    values, valid = golden_input(spec.n_channels, spec.unit, spec.settle_samples)
    names = [o.name for o in session.get_outputs()]
    alone = run_recording(
        session, values, valid, [n for n in names if n != "state_out"]
    )
    for name, expected in reference_flags(values, valid, spec).items():
        if not np.array_equal(alone[name], expected):
            raise VerificationFailed(
                f"output {name!r} does not follow the guard's rule",
                next_step="report this",
            )
    scale = np.random.default_rng(seed).uniform(0.1, 2.0, size=BATCH)
    scale[BATCH // 2] = 1.0
    many = StepGraph(session, BATCH, [n for n in names if n != "state_out"])
    for t in range(len(values)):
        many.sample[:] = values[t] * scale[:, None]
        many.valid[:] = valid[t]
        for name, value in many.step().items():
            _require_same(name, alone[name][t], value[BATCH // 2])
    return len(values) * BATCH
