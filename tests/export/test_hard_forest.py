"""Hard cases of forest and file: a million rows on every edge, ties, exact votes, and what stock
conversion answers.

Tests marked unguarded use scikit-learn's forest and skl2onnx as they come, and watch what happens.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort
import pytest
from hard_marks import GOLDEN, MILLION, TIES
from onnx import helper
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier
from small_model import with_metadata

from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.core.errors import GoldenMismatch
from holdfast.edge_runtime.graph import open_session
from holdfast.edge_runtime.monitor import Model
from holdfast.export.exporting import whole_graph
from holdfast.export.structure import edge_rows, threshold_rows
from holdfast.export.verify import CHUNK, cut_learners
from holdfast.step.heads import Head, VoteCalibration, riskier_argmax, situation_votes
from holdfast.step.learner import Forest, Learner, reference_votes
from holdfast.step.spec import StepSpec

if TYPE_CHECKING:
    from conftest import Built

SPEC = StepSpec(
    n_sensors=2, rate_hz=50.0, unit="N", groups=("now",), force_decides=False
)
"""The learner alone: what force decides after it is in test_contact.py."""
N_FEATURES = 6
Rows = npt.NDArray[np.float32]


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
        "situation",
        one.classes,
        Learner(one.forest),
        VoteCalibration(4.0 * np.eye(k), np.zeros(k)),
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
    name: str, n: int
) -> None:
    one = case(name)
    rows = adversarial(one, n, seed=3)
    got, votes = (
        answered(session_of(name), rows),
        reference_votes(Learner(one.forest), rows, len(one.classes)),
    )
    by_situation = situation_votes(votes)
    labels = riskier_argmax(by_situation)
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
    name: str, batch: int, n: int
) -> None:
    rows = adversarial(case(name), n, seed=4)[:n]
    many, few = (
        answered(session_of(name), rows),
        answered(session_of(name), rows, batch),
    )
    assert {name: part.tobytes() for name, part in few.items()} == {
        name: part.tobytes() for name, part in many.items()
    }


# Stock conversion


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
        [
            Head(
                "situation",
                SITUATIONS,
                Learner(forest),
                VoteCalibration(np.eye(4), np.zeros(4)),
            )
        ],
    )
    assert answered(open_session(cut_learners(model)), x[:1])["situation"][0] == max(
        present
    )


# Exact votes


# Dead sensors


# Small forests


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
