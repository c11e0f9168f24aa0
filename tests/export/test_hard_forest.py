"""Hard cases of forest and file: a million rows on every edge, ties, exact votes, and what stock
conversion answers.

Tests marked unguarded use scikit-learn's forest and skl2onnx as they come, and watch what happens.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort
import pytest
from hard_marks import EXACT, GOLDEN, MILLION, MISSING, SMALL, TIES
from onnx import helper
from skl2onnx import convert_sklearn
from skl2onnx.common.data_types import FloatTensorType
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier
from small_model import with_metadata

from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.core.errors import GoldenMismatch
from holdfast.edge_runtime.graph import open_session
from holdfast.edge_runtime.model import golden_answers
from holdfast.edge_runtime.monitor import Model
from holdfast.export.exporting import whole_graph
from holdfast.export.heads import Calibration, Head, riskier_argmax, situation_votes
from holdfast.export.learner import Forest, leaf_votes, reference_votes, vote_bits
from holdfast.export.network import IntArray
from holdfast.export.spec import StepSpec
from holdfast.export.structure import (
    edge_rows,
    largest_float32_not_above,
    threshold_rows,
)
from holdfast.export.verify import CHUNK, cut_learners

if TYPE_CHECKING:
    from conftest import Built

SPEC = StepSpec(
    n_sensors=2, rate_hz=50.0, unit="N", groups=("now",), force_decides=False
)
"""The learner alone: what force decides after it is in test_contact.py."""
N_FEATURES = 6
Rows = npt.NDArray[np.float32]
Record = Any
"""pytest's record_property."""


@dataclass(frozen=True)
class Case:
    """A fitted forest, its rows, and what it votes for. whole: its readings are integer counts."""

    forest: Forest
    rows: Rows
    classes: tuple[str, ...]
    whole: bool = False


@cache
def case(name: str) -> Case:
    rng = np.random.default_rng(11)
    grid = (rng.integers(-20, 20, (400, N_FEATURES)) / 4.0).astype(np.float32)
    counts = rng.integers(-3000, 3000, (400, N_FEATURES)).astype(np.float32)
    eight, four = rng.integers(8, size=400), rng.integers(4, size=400)
    if name == "eight classes, impure leaves":
        return Case(
            ExtraTreesClassifier(12, min_samples_leaf=4, random_state=0).fit(
                grid, eight
            ),
            grid,
            CLASSES,
        )
    if name == "four situations, pure leaves, many ties":
        return Case(
            RandomForestClassifier(4, bootstrap=False, random_state=0).fit(grid, four),
            grid,
            SITUATIONS,
        )
    return Case(
        RandomForestClassifier(10, random_state=0).fit(counts, eight),
        counts,
        CLASSES,
        whole=True,
    )


CASES = (
    "eight classes, impure leaves",
    "four situations, pure leaves, many ties",
    "integer counts",
)


def on_thresholds(one: Case, n: int, seed: int) -> Rows:
    """n rows, as the verification draws them."""
    parts = [threshold_rows(one.forest, one.rows, seed)]
    while sum(map(len, parts)) < n:
        parts.append(threshold_rows(one.forest, one.rows, 1000 * seed + len(parts)))
    return np.concatenate(parts)[:n]


def of_edges(forest: Forest, n: int, rng: np.random.Generator) -> Rows:
    """[n, F] of zeros of both signs, subnormals, the tiniest and the largest finite numbers, in any
    mixture."""
    return np.asarray(
        rng.choice(edge_rows(forest.n_features_in_)[:, 0], (n, forest.n_features_in_)),
        dtype=np.float32,
    )


def without_a_sensor(rows: Rows, rng: np.random.Generator) -> Rows:
    """The same rows, one finger's three numbers zero in one half and another row's (held) in the
    other."""
    rows = rows.copy()
    held = rows[rng.permutation(len(rows))]
    for row, finger in enumerate(
        rng.integers(0, rows.shape[1] // 3, len(rows)).tolist()
    ):
        here = slice(3 * finger, 3 * finger + 3)
        rows[row, here] = 0.0 if row % 2 else held[row, here]
    return rows


def adversarial(one: Case, n: int, seed: int) -> Rows:
    """About n rows of every kind."""
    rng = np.random.default_rng(seed)
    most = 3000 if one.whole else 6
    return np.concatenate(
        [
            on_thresholds(one, 7 * n // 10, seed),
            of_edges(one.forest, n // 10, rng),
            rng.integers(-most, most, (n // 10, N_FEATURES)).astype(np.float32),
            without_a_sensor(on_thresholds(one, n // 10, seed + 1), rng),
        ]
    )


def head_of(one: Case) -> Head:
    k = len(one.classes)
    return Head(
        "situation", one.classes, one.forest, Calibration(4.0 * np.eye(k), np.zeros(k))
    )


@cache
def session_of(name: str) -> ort.InferenceSession:
    """The forest, labels and probabilities out of the exported graph."""
    return open_session(cut_learners(whole_graph(SPEC, [head_of(case(name))])))


def answered(
    session: ort.InferenceSession, rows: Rows, batch: int = CHUNK
) -> dict[str, npt.NDArray[Any]]:
    names = [output.name for output in session.get_outputs()]
    parts = [
        session.run(None, {"features": rows[k : k + batch]})
        for k in range(0, len(rows), batch)
    ]
    return {
        name: np.concatenate([part[at] for part in parts])
        for at, name in enumerate(names)
    }


@pytest.mark.parametrize(
    "n", [350_000, pytest.param(3_500_000, marks=pytest.mark.soak)]
)
@pytest.mark.parametrize("name", CASES)
@MILLION.mark
def test_of_a_third_of_a_million_adversarial_rows_none_is_answered_otherwise_than_by_the_reference(
    name: str, n: int, record_property: Record
) -> None:
    one = case(name)
    rows = adversarial(one, n, seed=3)
    got, votes = (
        answered(session_of(name), rows),
        reference_votes(one.forest, rows, len(one.classes)),
    )
    by_situation = situation_votes(votes)
    labels = riskier_argmax(by_situation)
    top = np.sort(by_situation, axis=1)
    record_property("rows", len(rows))
    record_property("exact_ties", int((top[:, -1] == top[:, -2]).sum()))
    record_property("label_mismatches", int((got["situation"] != labels).sum()))
    np.testing.assert_array_equal(got["votes"], votes)
    np.testing.assert_array_equal(got["situation"], labels)
    assert len(rows) >= 334_000
    assert np.isfinite(got["p_situation"]).all()


@pytest.mark.parametrize(
    ("batch", "n"),
    [
        (1, 5_000),
        (2, 5_000),
        (7, 5_000),
        (63, 5_000),
        pytest.param(1, 350_000, marks=pytest.mark.soak),
    ],
)
@pytest.mark.parametrize("name", CASES)
@MILLION.mark
def test_a_row_alone_is_answered_bit_for_bit_as_in_any_batch(
    name: str, batch: int, n: int, record_property: Record
) -> None:
    rows = adversarial(case(name), n, seed=4)[:n]
    many, few = (
        answered(session_of(name), rows),
        answered(session_of(name), rows, batch),
    )
    record_property("rows", len(rows))
    assert {name: part.tobytes() for name, part in few.items()} == {
        name: part.tobytes() for name, part in many.items()
    }


@MILLION.unguarded
def test_thresholds_rounded_to_the_nearest_float32_send_every_second_row_on_them_the_wrong_way(
    record_property: Record,
) -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(400, N_FEATURES)).astype(np.float32)
    forest = ExtraTreesClassifier(20, random_state=0).fit(x, rng.integers(4, size=400))
    trees = [tree.tree_ for tree in forest.estimators_]
    at = np.concatenate([tree.threshold[tree.feature >= 0] for tree in trees])
    # goes left where it is the threshold too; in scikit-learn right, where above
    row_on_it = at.astype(np.float32)
    moved = float(np.mean(row_on_it.astype(np.float64) > at))
    record_property("thresholds", len(at))
    record_property("share_that_is_moved", moved)
    assert moved > 0.2
    ours = largest_float32_not_above(at)
    assert (ours.astype(np.float64) <= at).all()
    assert (np.nextafter(ours, np.float32(np.inf)).astype(np.float64) > at).all()


# Stock conversion


def stock(forest: Forest) -> Any:
    """skl2onnx' own classifier, on two threads as it would run anywhere: rows [N, F] -> labels
    [N]."""
    initial = [("X", FloatTensorType([None, forest.n_features_in_]))]
    model = convert_sklearn(
        forest,
        initial_types=initial,
        options={id(forest): {"zipmap": False}},
        target_opset={"": 20, "ai.onnx.ml": 3},
    )
    options = ort.SessionOptions()
    options.intra_op_num_threads = 2
    session = ort.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    return lambda rows: session.run(None, {"X": rows})[0]


@cache
def hundred_trees() -> tuple[Forest, Rows]:
    """A hundred trees of pure leaves, and rows on the grid they were fitted on."""
    rng = np.random.default_rng(0)
    x = (rng.integers(-20, 20, (400, N_FEATURES)) / 4.0).astype(np.float32)
    forest = RandomForestClassifier(100, random_state=0).fit(
        x, rng.integers(4, size=400)
    )
    return forest, (rng.integers(-20, 20, (60_000, N_FEATURES)) / 4.0).astype(
        np.float32
    )


@cache
def whole_votes() -> IntArray:
    """[N, 4] of the hundred trees: how many say what, each tree evaluated on its own."""
    forest, rows = hundred_trees()
    votes = np.zeros((len(rows), 4), dtype=np.int64)
    for tree in forest.estimators_:
        votes[np.arange(len(rows)), tree.predict(rows).astype(np.int64)] += 1
    return votes


@TIES.mark
def test_of_a_hundred_trees_every_tie_is_exact_and_goes_to_the_riskier_class(
    record_property: Record,
) -> None:
    forest, rows = hundred_trees()
    model = whole_graph(
        SPEC,
        [Head("situation", SITUATIONS, forest, Calibration(np.eye(4), np.zeros(4)))],
    )
    votes = whole_votes()
    tied = (votes == votes.max(axis=1, keepdims=True)).sum(axis=1) > 1
    record_property("ties", int(tied.sum()))
    np.testing.assert_array_equal(
        answered(open_session(cut_learners(model)), rows)["situation"],
        riskier_argmax(votes),
    )
    assert tied.sum() > 1000


@TIES.unguarded
def test_the_stock_conversion_answers_exact_ties_by_rounding(
    record_property: Record,
) -> None:
    forest, rows = hundred_trees()
    votes, got = whole_votes(), stock(forest)(rows)
    tied = (votes == votes.max(axis=1, keepdims=True)).sum(axis=1) > 1
    wrong = got != forest.predict(rows)
    record_property("rows", len(rows))
    record_property("labels_unlike_predict", int(wrong.sum()))
    record_property("of_them_exact_ties", int((wrong & tied).sum()))
    assert wrong.any()
    assert not (wrong & ~tied).any()


@pytest.mark.parametrize("present", [(0, 1, 2), (1, 2, 3), (0, 1, 3)])
@pytest.mark.parametrize("trees", [1, 3, 7])
@TIES.mark
def test_where_a_leaf_is_split_in_thirds_the_riskier_class_wins_the_rounding_too(
    present: tuple[int, ...], trees: int
) -> None:
    """Three do not divide a power of two: one vote is left over."""
    x = np.zeros((12, N_FEATURES), dtype=np.float32)
    forest = ExtraTreesClassifier(trees, bootstrap=False, random_state=0).fit(
        x, np.tile(present, 4)
    )
    model = whole_graph(
        SPEC,
        [Head("situation", SITUATIONS, forest, Calibration(np.eye(4), np.zeros(4)))],
    )
    assert answered(open_session(cut_learners(model)), x[:1])["situation"][0] == max(
        present
    )


# Exact votes


def exact_shares(forest: Forest, rows: Rows) -> list[list[Fraction]]:
    """[N, K] the forest's probabilities as fractions: no rounding anywhere."""
    leaves = forest.apply(rows)
    shares = []
    for tree in forest.estimators_:
        counts = np.rint(
            tree.tree_.value[:, 0, :] * tree.tree_.weighted_n_node_samples[:, None]
        ).astype(np.int64)
        shares.append(
            [
                [Fraction(int(count), int(node.sum())) for count in node]
                for node in counts
            ]
        )
    n_trees = len(shares)
    return [
        [
            sum((shares[t][leaf][k] for t, leaf in enumerate(row)), Fraction(0))
            / n_trees
            for k in range(forest.n_classes_)
        ]
        for row in leaves.tolist()
    ]


@pytest.mark.parametrize("min_samples_leaf", [1, 4])
@EXACT.mark
def test_quantised_votes_are_the_exact_rational_votes_within_one_part_in_a_leafs_whole(
    min_samples_leaf: int, record_property: Record
) -> None:
    rng = np.random.default_rng(2)
    x, y = (
        rng.normal(size=(300, N_FEATURES)).astype(np.float32),
        rng.integers(4, size=300),
    )
    forest = RandomForestClassifier(
        20, min_samples_leaf=min_samples_leaf, random_state=0
    ).fit(x, y)
    rows = rng.normal(size=(1000, N_FEATURES)).astype(np.float32)
    votes, bits = reference_votes(forest, rows, 4), vote_bits(20)
    unlike, furthest = 0, Fraction(0)
    for row, exact in zip(votes.tolist(), exact_shares(forest, rows), strict=True):
        assert sum(row) == 20 << bits
        apart = [
            abs(Fraction(vote, 20 << bits) - share)
            for vote, share in zip(row, exact, strict=True)
        ]
        furthest = max(furthest, *apart)
        label = max(k for k in range(4) if exact[k] == max(exact))
        first, second = sorted(exact)[-1], sorted(exact)[-2]
        answer = int(riskier_argmax(np.array([row]))[0])
        unlike += answer != label
        assert answer == label or first - second < Fraction(2, 1 << bits)
    record_property("rows", len(rows))
    record_property("labels_unlike_the_exact_ones", unlike)
    record_property("largest_difference_of_a_share", float(furthest))
    assert furthest < Fraction(1, 1 << bits)
    assert min_samples_leaf > 1 or furthest == 0


@EXACT.mark
def test_the_odd_votes_of_a_leaf_go_to_the_largest_remainders_equal_ones_to_the_riskier() -> (
    None
):
    rng = np.random.default_rng(6)
    x, y = rng.normal(size=(300, N_FEATURES)), rng.integers(5, size=300)
    forest = RandomForestClassifier(5, min_samples_leaf=7, random_state=0).fit(x, y)
    whole = 1 << vote_bits(5)
    for tree, votes in zip(forest.estimators_, leaf_votes(forest, 5), strict=True):
        counts = np.rint(
            tree.tree_.value[:, 0, :] * tree.tree_.weighted_n_node_samples[:, None]
        ).astype(np.int64)
        for count, given in zip(counts.tolist(), votes.tolist(), strict=True):
            shares = [Fraction(one * whole, sum(count)) for one in count]
            floors = [share.numerator // share.denominator for share in shares]
            ranked = sorted(
                range(5), key=lambda k: (shares[k] - floors[k], k), reverse=True
            )
            odd = ranked[: whole - sum(floors)]
            assert given == [floor + (k in odd) for k, floor in enumerate(floors)]


@EXACT.mark
def test_the_order_of_the_trees_changes_no_vote() -> None:
    one = case("eight classes, impure leaves")
    rows = adversarial(one, 10_000, seed=5)
    votes = [np.asarray(v, dtype=np.float32) for v in leaf_votes(one.forest, 8)]
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # scikit-learn sums the rows to look for NaN
        leaves = one.forest.apply(rows)
    expected = answered(session_of("eight classes, impure leaves"), rows)["votes"]
    for seed in range(5):
        total = np.zeros((len(rows), 8), dtype=np.float32)
        for tree in np.random.default_rng(seed).permutation(len(votes)):
            total += votes[tree][leaves[:, tree]]
        assert total.tobytes() == expected.tobytes()


@EXACT.unguarded
def test_a_hundred_float32_hundredths_are_not_one_and_depend_on_their_order(
    record_property: Record,
) -> None:
    hundredth = np.float32(1.0 / 100.0)
    total = np.float32(0.0)
    for _ in range(100):
        total += hundredth
    record_property("sum_of_a_hundred_hundredths", f"{total:.8f}")
    assert total != 1.0
    forest, rows = hundred_trees()
    shares = [
        (tree.predict_proba(rows[:2000]) / 100.0).astype(np.float32)
        for tree in forest.estimators_
    ]
    impure = [
        np.float32(0.3) * one + np.float32(0.7) * other
        for one, other in pairwise(shares)
    ]
    forwards, backwards = np.zeros_like(impure[0]), np.zeros_like(impure[0])
    for one, other in zip(impure, reversed(impure), strict=True):
        forwards, backwards = forwards + one, backwards + other
    assert (forwards != backwards).any()


# Dead sensors


@MISSING.unguarded
def test_the_stock_conversion_answers_a_dead_sensor_wrongly(
    record_property: Record,
) -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(2000, 18)).astype(np.float32)
    y = (x[:, 2] + x[:, 5] + 0.3 * rng.normal(size=2000) > 0).astype(int) + 2 * (
        x[:, 8] > 0
    )
    x[rng.random(2000) < 0.1, :3] = np.nan
    forest = RandomForestClassifier(100, random_state=0, n_jobs=2).fit(x, y)
    rows = rng.normal(size=(3000, 18)).astype(np.float32)
    rows[:, :3] = np.nan
    wrong = float(np.mean(stock(forest)(rows) != forest.predict(rows)))
    record_property("share_of_labels_unlike_predict_with_one_sensor_dead", wrong)
    assert wrong > 0.1


@MISSING.unguarded
def test_scikit_learn_refuses_inf_where_a_converted_forest_answers_it() -> None:
    forest, _ = hundred_trees()
    rows = np.full((1, N_FEATURES), np.inf, dtype=np.float32)
    with pytest.raises(ValueError, match="infinity"):
        forest.predict(rows)
    assert stock(forest)(rows)[0] in range(4)


# Small forests


@SMALL.unguarded
def test_the_stock_conversion_of_a_forest_of_one_class_answers_another_class() -> None:
    x = np.random.default_rng(0).normal(size=(10, N_FEATURES)).astype(np.float32)
    forest = ExtraTreesClassifier(3, random_state=0).fit(x, np.full(10, 2))
    assert set(forest.predict(x)) == {2}
    assert set(stock(forest)(x).tolist()) == {1}


# Golden sequences


def other_trees(path: Path) -> bytes:
    """The file with every leaf voting for another class, and a seal that holds."""
    model = onnx.load_from_string(path.read_bytes())
    (trees,) = [
        node for node in model.graph.node if node.op_type == "TreeEnsembleRegressor"
    ]
    (targets,) = [
        attribute for attribute in trees.attribute if attribute.name == "target_ids"
    ]
    targets.CopyFrom(
        helper.make_attribute("target_ids", [7 - target for target in targets.ints])
    )
    return with_metadata(model.SerializeToString())


@GOLDEN.mark
def test_a_file_whose_trees_answer_otherwise_than_when_it_was_made_is_refused_at_load(
    eight_classes: Built, tmp_path: Path
) -> None:
    path = tmp_path / "m.onnx"
    path.write_bytes(other_trees(eight_classes.model))
    with pytest.raises(GoldenMismatch, match="differs from the golden sequence"):
        Model(path)


@GOLDEN.unguarded
def test_without_the_golden_sequences_such_a_file_opens_and_its_answers_are_believed(
    eight_classes: Built, record_property: Record
) -> None:
    card = Model(eight_classes.model).card
    both = [
        golden_answers(
            open_session(data), card.n_channels, card.unit, card.settle_samples
        )["situation"]
        for data in (eight_classes.model.read_bytes(), other_trees(eight_classes.model))
    ]
    record_property("share_of_answers_that_differ", float(np.mean(both[0] != both[1])))
    assert (both[0] != both[1]).mean() > 0.5
