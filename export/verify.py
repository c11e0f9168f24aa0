"""An exported file must agree with the reference on every label, or it is not written.

The forest is cut out of the very file at the tensor `features`, the labels at `votes`; rows come from
windows, from the trees' own thresholds +- 1 ulp, and from the edges of float32.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx.utils import Extractor

from edge_runtime.contract import SITUATIONS
from edge_runtime.errors import VerificationFailed
from edge_runtime.golden import golden_input
from edge_runtime.graph import BATCH, StepGraph, open_session, run_recording
from export.heads import MAIN_HEAD, Head
from export.reference import FloatRows, reference_votes, riskier_argmax, situation_votes
from export.spec import StepSpec

THRESHOLD_ROWS = 20_000
SINGLE_ROWS = 2_000
CHUNK = 4096
OF_THE_STEP = ("settled", "unknown", "usable_sensors", "detectors", "features", "state_out")
"""Outputs that exist without a forest."""


def verify(model: onnx.ModelProto, spec: StepSpec, heads: list[Head], rows: FloatRows, seed: int = 0) -> dict[str, Any]:
    """Compare file and reference; returns counts, raises VerificationFailed on any disagreement.

    rows: [N, F] feature rows of windows (in cross-validation: all held-out ones).
    """
    forests = open_session(cut_forests(model))
    report: dict[str, Any] = {"given_rows": len(rows), "heads": {}}
    single = 0
    for head in heads:
        hard = np.concatenate([rows, threshold_rows(head.forest, rows, seed), edge_rows(head.forest)])
        votes = _run(forests, hard, CHUNK)
        report["heads"][head.name] = _compare(head, hard, votes, len(rows))
        single += _compare_single(forests, hard, votes, seed)
    report["ties_checked"] = _check_ties(model, heads)
    report["single_rows"] = single
    report["stream_samples"] = _compare_streams(model, spec, seed)
    return report


def threshold_rows(forest: Any, rows: FloatRows, seed: int) -> FloatRows:
    """Rows that reach a node of a tree and sit on its threshold, or one float32 step to either side of it.

    Every threshold equally often from all three sides, or a random choice of them where there are too many
    for THRESHOLD_ROWS. A row is a held-out one, changed only in what keeps it from its node.
    """
    rng = np.random.default_rng(seed)
    trees = [_Branches(tree.tree_) for tree in forest.estimators_]
    places = [(tree, node) for tree in trees for node in tree.nodes]
    if not places:
        return rows[:0]
    chosen = np.resize(rng.permutation(3 * len(places)), THRESHOLD_ROWS).tolist()
    hard = rows[rng.integers(len(rows), size=THRESHOLD_ROWS)].copy()
    for row, (place, side) in zip(hard, (divmod(number, 3) for number in chosen), strict=True):
        tree, node = places[place]
        tree.lead(row, node)
        row[tree.feature[node]] = tree.beside[side][node]
    return hard


class _Branches:
    """A tree's branches as lists, because they are walked one by one.

    beside: by node, the largest float32 that goes left, the one below it and the one above it, which goes right.
    """

    def __init__(self, tree: Any) -> None:
        on = tree.threshold.astype(np.float32)
        at = np.where(on > tree.threshold, np.nextafter(on, np.float32(-np.inf)), on)
        around = (at, np.nextafter(at, np.float32(-np.inf)), np.nextafter(at, np.float32(np.inf)))
        self.beside = [side.tolist() for side in around]
        self.feature = tree.feature.tolist()
        self.nodes = [node for node, feature in enumerate(self.feature) if feature >= 0]
        left, right = tree.children_left.tolist(), tree.children_right.tolist()
        self._above = {left[node]: (node, True) for node in self.nodes}
        self._above |= {right[node]: (node, False) for node in self.nodes}

    def lead(self, row: npt.NDArray[np.float32], node: int) -> None:
        """Change a row [F] in place where it leaves the path to a node, from the root on down."""
        path = []
        while node in self._above:
            node, left = self._above[node]
            path.append((node, left))
        for above, left in reversed(path):
            feature, at = self.feature[above], self.beside[0][above]
            if (row[feature] <= at) != left:
                row[feature] = at if left else self.beside[2][above]


def edge_rows(forest: Any) -> FloatRows:
    """Whole rows of zeros of both signs, subnormals, tiniest and largest finite numbers."""
    limits = np.finfo(np.float32)
    values = [0.0, -0.0, limits.smallest_subnormal, -limits.smallest_subnormal, limits.tiny, limits.max, limits.min]
    return np.repeat(np.array(values, dtype=np.float32)[:, None], forest.n_features_in_, axis=1)


def cut_forests(model: onnx.ModelProto) -> bytes:
    """The forests, labels and probabilities alone, from the tensor `features` [B, F] on."""
    outputs = [output.name for output in model.graph.output if output.name not in OF_THE_STEP]
    return _cut(model, ["features"], outputs)


def _votes(head: Head) -> str:
    return "votes" if head.name == MAIN_HEAD else f"votes_{head.name}"


def _cut(model: onnx.ModelProto, inputs: list[str], outputs: list[str]) -> bytes:
    cut: onnx.ModelProto = Extractor(onnx.shape_inference.infer_shapes(model)).extract_model(inputs, outputs)
    return cut.SerializeToString()


def _run(session: Any, rows: FloatRows, chunk: int) -> dict[str, npt.NDArray[Any]]:
    (name,) = [i.name for i in session.get_inputs()]
    names = [o.name for o in session.get_outputs()]
    parts = [session.run(None, {name: rows[k : k + chunk]}) for k in range(0, len(rows), chunk)]
    return {n: np.concatenate([part[i] for part in parts]) for i, n in enumerate(names)}


def _compare(head: Head, rows: FloatRows, answers: dict[str, npt.NDArray[Any]], given: int) -> dict[str, Any]:
    expected = reference_votes(head.forest, rows, len(head.classes))
    got = answers[_votes(head)]
    wrong_votes = int(np.any(got != expected, axis=1).sum())
    label = riskier_argmax(situation_votes(expected)) if head.name == MAIN_HEAD else riskier_argmax(expected)
    answered = answers["situation"] if head.name == MAIN_HEAD else riskier_argmax(got.astype(np.int64))
    wrong = int((label != answered).sum())
    if wrong or wrong_votes:
        raise VerificationFailed(
            f"head {head.name}: {wrong} labels and {wrong_votes} votes of {len(rows)} rows differ",
            cause="a converter or runtime that treats the trees differently",
            next_step="report the versions that holdfast doctor prints",
        )
    return {
        "rows": len(rows),
        "label_mismatches": wrong,
        "vote_mismatches": wrong_votes,
        "predict_disagreement": _disagreement(head, rows[:given], expected[:given]),
    }


def _disagreement(head: Head, rows: FloatRows, votes: npt.NDArray[np.int64]) -> dict[str, Any]:
    """How often plain predict says something else (of eight classes: another class)."""
    plain = np.asarray(head.forest.predict(rows))
    top = np.sort(votes, axis=1)
    tied = top[:, -1] == top[:, -2]
    differs = plain != riskier_argmax(votes)
    return {
        "share_off_ties": float((differs & ~tied).sum() / max(1, (~tied).sum())),
        "ties": int(tied.sum()),
        "differs_on_ties": int((differs & tied).sum()),
    }


def _compare_single(session: Any, rows: FloatRows, many: dict[str, npt.NDArray[Any]], seed: int) -> int:
    """B = 1 equals B = many, bit for bit, on every output of the forests."""
    chosen = np.random.default_rng(seed).choice(len(rows), size=min(SINGLE_ROWS, len(rows)), replace=False)
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
    """Exact ties between any situations, fed in at `votes`: the riskier one must win."""
    (main,) = [head for head in heads if head.name == MAIN_HEAD]
    session = open_session(_cut(model, ["votes"], ["situation"]))
    votes = np.array(list(_tied_votes(len(main.classes))), dtype=np.float32)
    (got,) = session.run(None, {"votes": votes})
    if not np.array_equal(got, riskier_argmax(situation_votes(votes.astype(np.int64)))):
        raise VerificationFailed("ties are not won by the riskier class", next_step="report this")
    return len(votes)


def _tied_votes(n_classes: int) -> Iterator[npt.NDArray[np.int64]]:
    """Every set of situations that can tie, with every situation left out behind them."""
    per = n_classes // len(SITUATIONS)
    for members in range(1, 2 ** len(SITUATIONS)):
        votes = np.full(len(SITUATIONS), 1000, dtype=np.int64)
        votes[[k for k in range(len(SITUATIONS)) if members >> k & 1]] = 4096
        yield np.repeat(votes // per, per)


def _compare_streams(model: onnx.ModelProto, spec: StepSpec, seed: int) -> int:
    """The whole step, from the sample on: one recording alone equals the same one among many."""
    session = open_session(model.SerializeToString())
    values, valid = golden_input(spec.n_channels, spec.unit, spec.settle_samples)
    names = [o.name for o in session.get_outputs()]
    alone = run_recording(session, values, valid, [n for n in names if n != "state_out"])
    scale = np.random.default_rng(seed).uniform(0.1, 2.0, size=BATCH)
    scale[BATCH // 2] = 1.0
    many = StepGraph(session, BATCH, [n for n in names if n != "state_out"])
    for t in range(len(values)):
        many.sample[:] = values[t] * scale[:, None]
        many.valid[:] = valid[t]
        for name, value in many.step().items():
            _require_same(name, alone[name][t], value[BATCH // 2])
    return len(values) * BATCH
