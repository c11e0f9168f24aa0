"""Integer votes: exact sums, the riskier class on ties, and a wrong file that is never written."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import onnx
import pytest
from hard_marks import EXACT, MILLION, SMALL, TIES
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier

from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.core.errors import VerificationFailed
from holdfast.edge_runtime.graph import open_session
from holdfast.export.exporting import export_artifact, whole_graph
from holdfast.export.structure import edge_rows, threshold_rows
from holdfast.export.verify import cut_learners, verify
from holdfast.step.heads import Head, VoteCalibration, riskier_argmax, situation_votes
from holdfast.step.learner import Forest, Learner, reference_votes, vote_bits
from holdfast.step.spec import StepSpec

if TYPE_CHECKING:
    from conftest import Built

SPEC = StepSpec(
    n_sensors=2, rate_hz=50.0, unit="N", groups=("now",), force_decides=False
)
"""The learner alone: what force decides after it is in test_contact.py."""
N_FEATURES = 6
KINDS: dict[str, type[Forest]] = {
    "random": RandomForestClassifier,
    "extra": ExtraTreesClassifier,
}
Rows = npt.NDArray[np.float32]


def head_of(forest: Forest, classes: tuple[str, ...]) -> Head:
    k = len(classes)
    return Head(
        "situation",
        classes,
        Learner(forest),
        VoteCalibration(np.eye(k) * 4.0, np.zeros(k)),
    )


@cache
def fitted(
    kind: str,
    present: tuple[int, ...],
    trees: int,
    depth: int | None = None,
    rows: int = 120,
) -> tuple[Forest, Rows]:
    """A forest that saw only the classes `present`, and the rows it was fitted on (values on a
    coarse grid)."""
    rng = np.random.default_rng(trees)
    x = (rng.integers(-20, 20, (rows, N_FEATURES)) / 4.0).astype(np.float32)
    y = np.array(present)[rng.integers(len(present), size=rows)]
    return KINDS[kind](n_estimators=trees, max_depth=depth, random_state=0).fit(x, y), x


def cut(model: onnx.ModelProto, rows: Rows) -> dict[str, npt.NDArray[Any]]:
    """What the forest in the whole graph answers to feature rows."""
    names: list[str] = [
        n
        for n in ("votes", "situation", "p_situation", "p_class", "weight")
        if n in published(model)
    ]
    part = open_session(cut_learners(model))
    return dict(zip(names, part.run(names, {"features": rows}), strict=True))


def published(model: onnx.ModelProto) -> set[str]:
    return {output.name for output in model.graph.output}


def hard_rows(forest: Forest, rows: Rows) -> Rows:
    """Rows it knows, rows on its thresholds and a float32 step beside them, and the edges of
    float32."""
    return np.concatenate(
        [rows, threshold_rows(forest, rows, 0)[:2000], edge_rows(forest.n_features_in_)]
    )


FORESTS: dict[str, tuple[tuple[str, ...], tuple[int, ...], int, int | None]] = {
    "four situations": (SITUATIONS, (0, 1, 2, 3), 12, None),
    "eight classes": (CLASSES, tuple(range(8)), 12, None),
    "one tree": (CLASSES, tuple(range(8)), 1, None),
    "an absent class": (SITUATIONS, (0, 1, 3), 7, None),
    "only the first and the last": (CLASSES, (0, 7), 5, None),
    "stumps": (SITUATIONS, (0, 1, 2, 3), 9, 1),
    "one node a tree": (SITUATIONS, (2,), 3, None),
    "one tree of one node": (CLASSES, (5,), 1, None),
}


@SMALL.mark
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", FORESTS)
def test_the_exported_file_answers_what_the_reference_does(
    kind: str, name: str
) -> None:
    classes, present, trees, depth = FORESTS[name]
    forest, rows = fitted(kind, present, trees, depth)
    hard = hard_rows(forest, rows)
    got = cut(whole_graph(SPEC, [head_of(forest, classes)]), hard)
    votes = reference_votes(Learner(forest), hard, len(classes))
    np.testing.assert_array_equal(got["votes"], votes)
    np.testing.assert_array_equal(
        got["situation"], riskier_argmax(situation_votes(votes))
    )
    assert (got["votes"].sum(axis=1) == trees << vote_bits(trees)).all()
    assert not got["votes"][
        :, [k for k in range(len(classes)) if k not in present]
    ].any()


@pytest.mark.parametrize("kind", KINDS)
def test_the_reference_is_the_forests_own_probability_within_the_quantisation(
    kind: str,
) -> None:
    forest, rows = fitted(kind, (0, 1, 3), 7, 3)
    votes = reference_votes(Learner(forest), rows, 4)
    full = 7 << vote_bits(7)
    np.testing.assert_allclose(
        votes[:, [0, 1, 3]] / full, forest.predict_proba(rows), atol=7 / full
    )


@EXACT.mark
@given(trees=st.integers(1, 5000))
@settings(max_examples=200)
def test_all_votes_together_are_exact_in_float32_and_no_finer_quantisation_would_be(
    trees: int,
) -> None:
    k = vote_bits(trees)
    assert trees << k < 2**24
    assert k == 16 or trees << (k + 1) >= 2**24


@given(
    votes=st.lists(
        st.lists(st.integers(0, 5), min_size=4, max_size=4), min_size=1, max_size=20
    ),
)
@settings(max_examples=50)
def test_of_equal_votes_the_riskier_class_wins(votes: list[list[int]]) -> None:
    for row, label in zip(votes, riskier_argmax(np.array(votes)), strict=True):
        assert row[label] == max(row)
        assert max(row) not in row[label + 1 :]


def tied(present: tuple[int, ...], kind: str = "extra") -> tuple[Forest, Rows]:
    """A forest whose every leaf is an exact tie between these classes: nothing tells them apart."""
    x = np.zeros((4 * len(present), N_FEATURES), dtype=np.float32)
    return KINDS[kind](3, bootstrap=False, random_state=0).fit(
        x, np.tile(present, 4)
    ), x[:1]


@TIES.mark
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("present", [(0, 1), (1, 3), (0, 2), (0, 1, 2, 3), (2, 3)])
def test_on_an_exact_tie_the_riskier_situation_wins_where_plain_predict_says_the_safer(
    kind: str, present: tuple[int, ...]
) -> None:
    forest, row = tied(present, kind)
    got = cut(whole_graph(SPEC, [head_of(forest, SITUATIONS)]), row)
    assert len(set(got["votes"][0][list(present)])) == 1
    assert got["situation"][0] == max(present)
    assert forest.predict(row)[0] == min(present)


@pytest.mark.parametrize(
    ("labels", "heavy"),
    [
        ([2, 3], True),
        ([6, 6, 7], False),
        ([0, 0, 0, 1, 6], False),
        ([5], True),
        ([1, 1, 1, 4], False),
    ],
)
def test_weight_is_voted_on_outside_of_nothing_and_a_tie_is_heavy(
    labels: list[int], heavy: bool
) -> None:
    x = np.zeros((len(labels), N_FEATURES), dtype=np.float32)
    forest = ExtraTreesClassifier(1, bootstrap=False).fit(x, labels)
    assert (
        bool(cut(whole_graph(SPEC, [head_of(forest, CLASSES)]), x[:1])["weight"][0])
        == heavy
    )


Wrong = Callable[[onnx.ModelProto], None]


def attribute(model: onnx.ModelProto, op: str, name: str) -> Any:
    (node,) = [node for node in model.graph.node if node.op_type == op]
    (found,) = [a for a in node.attribute if a.name == name]
    return found


def one_vote_more(place: int) -> Wrong:
    def spoil(model: onnx.ModelProto) -> None:
        attribute(model, "TreeEnsembleRegressor", "target_weights").floats[place] += 1.0

    return spoil


def one_threshold_by_an_ulp(place: int) -> Wrong:
    def spoil(model: onnx.ModelProto) -> None:
        values = attribute(model, "TreeEnsembleRegressor", "nodes_values").floats
        branches = [
            k
            for k, mode in enumerate(
                attribute(model, "TreeEnsembleRegressor", "nodes_modes").strings
            )
            if mode != b"LEAF"
        ]
        at = branches[place]
        values[at] = float(np.nextafter(np.float32(values[at]), np.float32(np.inf)))

    return spoil


@MILLION.mark
@given(
    kind=st.sampled_from(sorted(KINDS)),
    place=st.integers(0, 2**16),
    what=st.sampled_from(["leaf", "threshold"]),
)
@settings(max_examples=8)
def test_one_wrong_leaf_or_threshold_anywhere_fails_the_verification(
    kind: str, place: int, what: str
) -> None:
    forest, rows = fitted(kind, (0, 1, 2, 3), 4)
    heads = [head_of(forest, SITUATIONS)]
    model = whole_graph(SPEC, heads)
    branches = sum(int((tree.tree_.feature >= 0).sum()) for tree in forest.estimators_)
    (one_vote_more if what == "leaf" else one_threshold_by_an_ulp)(place % branches)(
        model
    )
    with pytest.raises(VerificationFailed):
        verify(model, SPEC, heads, rows)


OTHERWISE = {
    "GreaterOrEqual": "LessOrEqual",
    "Softmax": "LogSoftmax",
}
"""An operator, and one that takes its place."""


@pytest.mark.parametrize("output", ["settled", "unknown", "p_class", "weight"])
def test_flags_probabilities_and_weight_are_verified_too(output: str) -> None:
    forest, rows = fitted("extra", tuple(range(8)), 5)
    heads = [head_of(forest, CLASSES)]
    model = whole_graph(SPEC, heads)
    verify(model, SPEC, heads, rows)
    made_by = {node.output[0]: node for node in model.graph.node}
    node = made_by[output]
    if node.op_type == "Gather":
        other = "settled" if output == "unknown" else "unknown"
        node.input[0] = made_by[other].input[0]
    else:
        node.op_type = OTHERWISE[node.op_type]
    with pytest.raises(VerificationFailed):
        verify(model, SPEC, heads, rows)


def test_a_second_head_is_verified_as_the_first() -> None:
    forest, rows = fitted("random", (0, 1, 2, 3), 5)
    question, _ = fitted("random", (0, 1), 6)
    yes = Head(
        "p_risky_250ms",
        ("no", "yes"),
        Learner(question),
        VoteCalibration(np.eye(2), np.zeros(2)),
    )
    heads = [head_of(forest, SITUATIONS), yes]
    model = whole_graph(SPEC, heads)
    assert verify(model, SPEC, heads, rows).heads["p_risky_250ms"].label_mismatches == 0
    (node,) = [
        node for node in model.graph.node if node.output[0] == "votes_p_risky_250ms"
    ]
    (weights,) = [a for a in node.attribute if a.name == "target_weights"]
    weights.floats[0] += 1.0
    with pytest.raises(VerificationFailed, match="p_risky_250ms"):
        verify(model, SPEC, heads, rows)


@pytest.mark.parametrize("earlier", [True, False])
def test_nothing_is_written_where_a_library_below_us_gets_ties_wrong(
    eight_classes: Built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, earlier: bool
) -> None:
    artifact = shutil.copytree(eight_classes.artifact, tmp_path / "artifact")
    if not earlier:
        (artifact / "holdfast.onnx").unlink()
    real = onnx.helper.make_node

    def lying(op: str, *args: Any, **kwargs: Any) -> onnx.NodeProto:
        last = {"select_last_index": 0} if op == "ArgMax" else {}
        return real(op, *args, **kwargs | last)

    before = [(path, path.stat().st_size) for path in sorted(tmp_path.rglob("*"))]
    monkeypatch.setattr(onnx.helper, "make_node", lying)
    with pytest.raises(VerificationFailed):
        export_artifact(artifact)
    with pytest.raises(VerificationFailed):
        export_artifact(artifact, tmp_path / "new" / "holdfast.onnx")
    after = [(path, path.stat().st_size) for path in sorted(tmp_path.rglob("*"))]
    assert after == before
    if earlier:
        model = (artifact / "holdfast.onnx").read_bytes()
        assert model == eight_classes.model.read_bytes()
