"""Verification: a file that disagrees with the reference on any label is not written.

The learner is cut out of the file itself at the tensor `features`, the labels at `votes`. Rows come
from windows, from the trees' thresholds +- 1 ulp, and from the limits of float32. The dataclasses
hold what a verification compared, as counts; `dataclasses.asdict` gives their JSON.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import numpy_helper
from onnx.utils import Extractor

from holdfast.core.contract import NOTHING, SITUATIONS, BoolArray, FloatArray
from holdfast.edge_runtime.graph import (
    BATCH,
    Outputs,
    open_session,
    run_recording,
    run_recordings,
)
from holdfast.edge_runtime.model import golden_input
from holdfast.edge_runtime.model_file import EMPTY
from holdfast.export.structure import hard_rows, require, require_same_numbers
from holdfast.step.guard import reference_contact, reference_flags
from holdfast.step.heads import (
    MAIN_HEAD,
    ByForce,
    FloatRows,
    Head,
    reference_label,
    reference_outputs,
    riskier_argmax,
)
from holdfast.step.learner import Forest, reference_votes
from holdfast.step.network import IntArray
from holdfast.step.spec import ContactRule, StepSpec

SINGLE_ROWS = 2_000
"""Rows of each head that are computed alone: one call a row is slow."""
PROBABILITY_TOLERANCE = 1e-5
"""Probabilities are float32 in the file and float64 in the reference."""
CHUNK = 4096
"""Rows that a session gets at once, which bounds its memory."""
OF_THE_STEP = (
    "settled",
    "unknown",
    "usable_sensors",
    "detectors",
    EMPTY,
    "features",
    "state_out",
)
"""Outputs that exist without a learner."""


@dataclass(frozen=True)
class PredictDisagreement:
    """How often scikit-learn's predict gives another class. share_off_ties: 0 to 1."""

    share_off_ties: float
    ties: int
    differs_on_ties: int


@dataclass(frozen=True)
class HeadVerification:
    """One head of a file against the reference. rows: given rows, thresholds and edges together.

    label_mismatches, vote_mismatches: 0 in every report, because any other number raises.
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
    """A whole file against the reference. given_rows: feature rows of windows.

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


@dataclass(frozen=True)
class AdaptedVerification:
    """What was compared, as counts.

    rows: given and hard ones. single_rows: computed alone and in a batch. samples: of a stream.
    changed: labels of given rows that differ from the base's.
    """

    rows: int
    single_rows: int
    samples: int
    changed: int


def verify(
    model: onnx.ModelProto,
    spec: StepSpec,
    heads: list[Head],
    rows: FloatRows,
    seed: int = 0,
    *,
    report: Callable[[str], None] = lambda line: None,
) -> Verification:
    """Compare file and reference; returns counts, raises VerificationFailed on any disagreement.

    rows: [N, F] feature rows of windows (in cross-validation: all held-out ones). report: called
    with the name of each stage.
    """
    learners = open_session(cut_learners(model))
    compared: dict[str, HeadVerification] = {}
    single = 0

    for head in heads:
        report(f"verifying head {head.name} on {len(rows)} rows and on its thresholds")
        # The given rows come first: by their number `_compare` tells them from the hard ones.
        hard = np.concatenate([rows, hard_rows(head.learner, rows, seed)])
        answers = run_rows(learners, hard)
        nodes = require_same_numbers(model, head)
        compared[head.name] = _compare(
            head, hard, answers, len(rows), nodes, by_force=spec.contact is not None
        )
        single += require_single_rows_equal(learners, hard, answers, seed)

    report("verifying ties, and streams of one hand against a batch")
    ties = _check_ties(model, heads)
    if spec.contact is not None:
        _check_without_contact(model, heads, rows)
    samples = compare_streams(model, spec, seed)
    return Verification(len(rows), compared, ties, single, samples)


def cut_learners(model: onnx.ModelProto, *, touches: bool = True) -> bytes:
    """The learners, labels and probabilities alone, from the tensor `features` [B, F] on.

    touches: whether all rows are those of a hand in contact, where force decides "nothing".
    """
    names = [output.name for output in model.graph.output]
    of_learners = [name for name in names if name not in OF_THE_STEP]
    return cut(model, "features", of_learners, touches=touches)


def cut(
    model: onnx.ModelProto, start: str, outputs: list[str], *, touches: bool = True
) -> bytes:
    """The part of a model between a tensor, which becomes its input, and these outputs."""
    # the new input needs a type and a shape, which only inference knows
    with_shapes = onnx.shape_inference.infer_shapes(model)
    inputs = [start]
    has_rule = any(EMPTY in node.output for node in model.graph.node)
    if start == "features" and has_rule:
        inputs.append(EMPTY)
    part: onnx.ModelProto = Extractor(with_shapes).extract_model(inputs, outputs)

    # what takes no part in the learners is no input of theirs, but a constant
    for _ in inputs[1:]:
        constant = numpy_helper.from_array(np.array([[not touches]]), EMPTY)
        part.graph.initializer.append(constant)
        del part.graph.input[-1]
    return part.SerializeToString()


def run_rows(session: Any, rows: npt.NDArray[Any], chunk: int = CHUNK) -> Outputs:
    """Every output of a session with one input, for all rows, `chunk` of them at once."""
    (given,) = session.get_inputs()
    names = [output.name for output in session.get_outputs()]
    answers = []
    for start in range(0, len(rows), chunk):
        some = rows[start : start + chunk]
        answers.append(session.run(names, {given.name: some}))
    columns = map(np.concatenate, zip(*answers, strict=True))
    return dict(zip(names, columns, strict=True))


def _compare(
    head: Head,
    rows: FloatRows,
    answers: Outputs,
    given: int,
    nodes: int,
    *,
    by_force: bool,
) -> HeadVerification:
    """Compare the answers to all rows; the first `given` of them are rows of windows.

    by_force: force decides "nothing", and all rows are those of a hand that touches something.
    """
    learned = reference_votes(head.learner, rows, len(head.classes))
    expected = learned
    if by_force:
        expected = ByForce.of(head).in_contact(learned)
    wrong = {}
    for name, reference in reference_outputs(head, expected).items():
        if differ := _rows_that_differ(answers[name], reference):
            wrong[name] = differ
    require(
        not wrong, f"head {head.name}: outputs differ, rows of {len(rows)}: {wrong}"
    )

    # scikit-learn averages probabilities, whole votes are rounded: reported, not required
    plain = None
    forest = head.learner.forest
    if forest is not None and head.learner.network is None:
        plain = _disagreement(forest, rows[:given], learned[:given])
    return HeadVerification(len(rows), 0, 0, plain, nodes)


def _rows_that_differ(got: npt.NDArray[Any], expected: npt.NDArray[Any]) -> int:
    """Votes, labels and flags must be equal, probabilities within PROBABILITY_TOLERANCE."""
    most = PROBABILITY_TOLERANCE if expected.dtype == np.float64 else 0.0
    apart = np.abs(got.astype(float) - expected).reshape(len(got), -1).max(axis=1)
    # "not near" instead of "far": a NaN is neither, and must count
    return int(np.sum(~(apart <= most)))


def _disagreement(
    forest: Forest, rows: FloatRows, votes: IntArray
) -> PredictDisagreement:
    """How often scikit-learn's predict gives another class."""
    in_order = np.sort(votes, axis=1)
    tied = in_order[:, -1] == in_order[:, -2]
    predicted = np.asarray(forest.predict(rows))
    differs = predicted != riskier_argmax(votes)

    # on a tie scikit-learn takes the first class, we take the riskier one
    n_off_ties = (~tied).sum()
    return PredictDisagreement(
        share_off_ties=float((differs & ~tied).sum() / max(1, n_off_ties)),
        ties=int(tied.sum()),
        differs_on_ties=int((differs & tied).sum()),
    )


def require_single_rows_equal(
    session: Any, rows: FloatRows, batch: Outputs, seed: int
) -> int:
    """B = 1 equals B = many, bit for bit, on every output of the learners; returns the count.

    batch: the outputs of all rows at once, of which SINGLE_ROWS are chosen at random.
    """
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(rows), size=min(SINGLE_ROWS, len(rows)), replace=False)
    alone = run_rows(session, rows[chosen], 1)
    for name, value in alone.items():
        _require_same(name, value, batch[name][chosen])

    return len(chosen)


def _require_same(name: str, one: npt.NDArray[Any], many: npt.NDArray[Any]) -> None:
    """Raise VerificationFailed where two arrays differ in any bit."""
    # as bytes: == would take 0.0 for -0.0, and NaN for different from itself
    same = one.tobytes() == np.ascontiguousarray(many).tobytes()
    require(same, f"output {name!r}: a single row and a batch differ")


def _check_ties(model: onnx.ModelProto, heads: list[Head]) -> int:
    """Feed exact ties between situations in at `votes`: the riskier one must win."""
    (main,) = [head for head in heads if head.name == MAIN_HEAD]

    # rows with such ties are too rare to be found, so the votes themselves are the input
    session = open_session(cut(model, "votes", ["situation"]))
    votes = _tied_votes(len(main.classes))
    (got,) = session.run(None, {"votes": votes.astype(np.float32)})
    same = np.array_equal(got, reference_label(main, votes))
    require(same, "the riskier class does not win ties")
    return len(votes)


def _tied_votes(n_classes: int) -> IntArray:
    """Votes for every set of situations that can tie, the other situations behind them."""
    n = len(SITUATIONS)
    per = n_classes // n
    # the bits of a number are the members of a set
    sets = np.arange(1, 2**n)
    is_member = sets[:, None] >> np.arange(n) & 1 == 1
    # Both numbers are even, so that a situation splits into a light and a heavy class.
    votes = np.where(is_member, 4096, 1000)
    return np.repeat(votes // per, per, axis=1)


def _check_without_contact(
    model: onnx.ModelProto, heads: list[Head], rows: FloatRows
) -> None:
    """A hand that touches nothing is called nothing, whatever the learner says."""
    session = open_session(cut_learners(model, touches=False))
    answers = run_rows(session, rows[:SINGLE_ROWS])
    for head in heads:
        expected = ByForce.of(head).without_contact()
        same = bool((answers[head.votes_name] == expected).all())
        require(same, f"{head.name}: votes without contact are not all for nothing")


def compare_streams(model: onnx.ModelProto, spec: StepSpec, seed: int) -> int:
    """Run the whole step: flags follow the rules, and one recording equals the same in a batch."""
    session = open_session(model.SerializeToString())
    streams = [golden_input(spec.n_channels, spec.unit, spec.settle_samples)]
    if spec.contact is not None:
        # the golden input presses from its first sample on: this one touches and lets go
        streams.append(touching_input(spec, spec.contact, seed))
    return sum(_compare_stream(session, spec, *one, seed) for one in streams)


def _compare_stream(
    session: Any, spec: StepSpec, values: FloatArray, valid: BoolArray, seed: int
) -> int:
    """One stream, alone and in a batch; returns how many samples were compared."""
    names = [output.name for output in session.get_outputs()]
    names.remove("state_out")
    alone = run_recording(session, values, valid, names)

    flags = reference_flags(values, valid, spec)
    answered = {name: alone[name] for name in flags}
    if spec.contact is not None:
        flags[EMPTY], _ = reference_contact(values, valid, spec, spec.contact)
        flags["situation"] = flags[EMPTY]
        answered[EMPTY] = alone[EMPTY][:, 0]
        answered["situation"] = alone["situation"] == NOTHING
    for name, expected in flags.items():
        same = np.array_equal(answered[name], expected)
        require(same, f"output {name!r} does not follow its rule in plain Python")

    # The other recordings of the batch differ in size, so that a mix-up of rows would show.
    scale = np.random.default_rng(seed).uniform(0.1, 2.0, size=BATCH)
    scale[BATCH // 2] = 1.0
    rows = np.arange(len(values))
    many = [values * one for one in scale]
    batch = run_recordings(session, many, [valid] * BATCH, names, [rows] * BATCH)
    for name, value in batch[BATCH // 2].items():
        _require_same(name, alone[name], value)
    return len(values) * BATCH


def touching_input(
    spec: StepSpec, rule: ContactRule, seed: int
) -> tuple[FloatArray, BoolArray]:
    """values [T, C] and valid [T, C/3] of a hand that drifts, touches, loses a sensor and lets go.

    Three touches of different strength, with a sensor lost once in a touch and once in the air.
    """
    rng = np.random.default_rng(seed)
    span = spec.settle_samples
    length = 8 * span
    samples = np.arange(length)

    # drift at two thirds of the zero's speed, noise at a quarter of the threshold
    drift = 2.0 / 3.0 * rule.zero_per_s / spec.rate_hz * samples
    values = rng.normal(scale=0.25 * rule.on, size=(length, spec.n_channels))
    values += drift[:, None] * rng.choice([-1.0, 1.0], size=spec.n_channels)

    for begin, strength in ((2, 30.0), (4, 0.9), (6, 5.0)):
        touching = (samples >= begin * span) & (samples < (begin + 1) * span)
        values[touching] += strength * rule.on / math.sqrt(spec.n_channels)

    valid = np.ones((length, spec.n_sensors), dtype=np.bool_)
    lost = spec.gap_samples + 2
    for begin in (int(2.5 * span), int(5.2 * span)):
        valid[begin : begin + lost, 0] = False
    return values, valid
