"""Networks and committees: whole votes, the same bits everywhere, refused where altered."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_model import artifact, spec

from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.core.errors import HoldfastError
from holdfast.edge_runtime.graph import open_session
from holdfast.edge_runtime.model import Model
from holdfast.export.exporting import export_artifact, whole_graph
from holdfast.export.verify import cut_learners, verify
from holdfast.step.artifact import Artifact, read_artifact, write_artifact
from holdfast.step.features import feature_count
from holdfast.step.heads import (
    Head,
    VoteCalibration,
    reference_label,
    riskier_argmax,
    weighted,
)
from holdfast.step.learner import Learner, reference_votes, votes_in_all
from holdfast.step.network import INPUT_MOST, InputScale, Layer, Network, network_votes
from holdfast.training.network_fit import fit_network
from holdfast.training.plan import ForestPlan, NetworkPlan

SPEC = spec(("now", "differences"))
PLAN = NetworkPlan(hidden=(12, 8), members=2, epochs=4, batch=32)
FOREST = ForestPlan(kind="random", n_estimators=3, max_depth=4)
FloatRows = npt.NDArray[np.float32]


def rows_of(n: int, seed: int = 0) -> FloatRows:
    """Heavy-tailed rows [n, F]."""
    rng = np.random.default_rng(seed)
    return rng.standard_t(2, size=(n, feature_count(SPEC))).astype(np.float32)


@cache
def learner_of(kind: str, n_classes: int = 8) -> Learner:
    """A learner of a rule that the first feature decides."""
    rows = rows_of(300)
    label = np.clip(
        (2.0 * rows[:, 0] + n_classes / 2).astype(np.int64), 0, n_classes - 1
    )
    if kind == "network":
        return Learner(network=fit_network(PLAN, rows, label, n_classes, 0))
    forest = FOREST.build(0, n_jobs=1).fit(rows, label)
    if kind == "forest":
        return Learner(forest)
    votes = votes_in_all(Learner(forest))
    return Learner(forest, fit_network(PLAN, rows, label, n_classes, 0, votes))


def made_of(
    kind: str,
    classes: tuple[str, ...] = CLASSES,
    weights: tuple[float, ...] | None = None,
) -> Artifact:
    """An artifact with one head of that learner."""
    k = len(classes)
    calibration = VoteCalibration(4.0 * np.eye(k), np.zeros(k))
    head = Head("situation", classes, learner_of(kind, k), calibration, weights)
    base = artifact(SPEC, extra=False)
    return Artifact(SPEC, base.preparation, base.decision, [head], rows_of(50), {})


@pytest.mark.parametrize("kind", ["network", "committee"])
@pytest.mark.parametrize("classes", [CLASSES, SITUATIONS])
@pytest.mark.parametrize("weights", [None, (1.0, 0.45, 0.3, 0.7)])
def test_an_exported_learner_answers_what_the_reference_does(
    kind, classes, weights, tmp_path
):
    write_artifact(tmp_path, made_of(kind, classes, weights))
    path, report = export_artifact(tmp_path, tmp_path / "out.onnx")
    head = report.heads["situation"]
    assert (head.label_mismatches, head.vote_mismatches) == (0, 0)
    assert head.rows > 5_000
    assert Model(path).card.classes == classes


def test_a_network_s_votes_are_near_those_of_the_network_that_it_was_made_of():
    rows = rows_of(300)
    label = (rows[:, 0] > 0.0).astype(np.int64)
    network = fit_network(
        NetworkPlan((16,), 1, epochs=40, batch=32, alpha=1e-3), rows, label, 2, 0
    )
    right = riskier_argmax(network_votes(network, rows)) == label
    assert right.mean() > 0.9


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 4, 8]))
@settings(max_examples=20, deadline=None)
def test_votes_are_whole_not_negative_and_add_up_for_any_network_and_row(
    seed, n_classes
):
    network = random_network(seed, n_classes)
    rng = np.random.default_rng(seed)
    rows = (
        10.0 ** rng.uniform(-40, 38, (50, 6)) * rng.choice([-1, 0, 1], (50, 6))
    ).astype(np.float32)
    votes = network_votes(network, rows)
    assert (votes >= 0).all()
    assert (votes.sum(axis=1) == network.votes_in_all).all()


def random_network(seed: int, n_classes: int) -> Network:
    """A network of random whole numbers, six features."""
    rng = np.random.default_rng(seed)
    gain = rng.uniform(-INPUT_MOST / 2, INPUT_MOST / 2, 6)
    inputs = InputScale(
        rng.uniform(1e-3, 10.0, 6).astype(np.float32),
        gain.astype(np.float32),
        rng.uniform(-250, 250, 6).astype(np.float32),
    )
    layers = []
    for width, out in ((6, 5), (5, n_classes)):
        weights = rng.integers(-3000, 3000, (width, out)).astype(np.float32)
        bias = rng.integers(-(10**6), 10**6, out).astype(np.float32)
        layers.append(
            Layer(weights, bias, rng.uniform(1e-6, 1e-3, out).astype(np.float32))
        )
    return Network(inputs, tuple(layers), int(rng.integers(1000, 2**23)))


@pytest.mark.parametrize("kind", ["network", "committee"])
def test_a_row_alone_in_a_batch_and_among_rows_that_are_not_finite_has_the_same_bits(
    kind,
):
    made = made_of(kind)
    session = open_session(cut_learners(whole_graph(SPEC, made.heads)))
    rows = rows_of(64, seed=3)
    spoilt = rows.copy()
    spoilt[1::2] = np.resize(
        np.array([np.nan, np.inf, -np.inf, 3e38], np.float32), rows[1::2].shape
    )
    alone = np.concatenate(
        [session.run(["votes"], {"features": rows[k : k + 1]})[0] for k in range(64)]
    )
    (together,) = session.run(["votes"], {"features": rows})
    (beside,) = session.run(["votes"], {"features": spoilt})
    assert alone.tobytes() == together.tobytes()
    assert beside[::2].tobytes() == together[::2].tobytes()
    assert (together.sum(axis=1) == votes_in_all(made.heads[0].learner)).all()


def test_the_label_of_the_reference_is_the_riskier_of_equal_weighted_votes():
    head = made_of("forest", SITUATIONS, (1.0, 0.5, 0.25, 1.0)).heads[0]
    votes = np.array([[100, 200, 400, 100], [4, 8, 0, 3]])
    assert reference_label(head, votes).tolist() == [3, 1]
    assert weighted(votes, None) is votes


@pytest.mark.parametrize("kind", ["network", "committee"])
def test_an_artifact_is_read_back_as_it_was_written(kind, tmp_path):
    made = made_of(kind, SITUATIONS, (1.0, 0.5, 0.25, 0.75))
    write_artifact(tmp_path, made)
    (head,) = read_artifact(tmp_path).heads
    rows = rows_of(100, seed=5)
    before = reference_votes(made.heads[0].learner, rows, 4)
    assert np.array_equal(reference_votes(head.learner, rows, 4), before)
    assert head.label_weights == (1.0, 0.5, 0.25, 0.75)


def spoil(network: Network, **changes: Any) -> Network:
    return Network(**{"inputs": network.inputs, "layers": network.layers, **changes})


@pytest.mark.parametrize(
    ("weight", "bias", "why"),
    [
        (0.5, 0.0, "whole number"),
        (40_000.0, 0.0, "whole number"),
        (0.0, 2.0**24, "too large"),
    ],
)
def test_numbers_that_are_not_exact_make_no_network(weight, bias, why):
    network = random_network(0, 4)
    first, last = network.layers
    spoilt = Layer(
        first.weights + np.float32(weight), first.bias + np.float32(bias), first.scale
    )
    with pytest.raises(ValueError, match=why):
        spoil(network, layers=(spoilt, last))


def test_a_committee_s_members_have_equally_many_votes():
    committee = learner_of("committee")
    with pytest.raises(ValueError, match="parts with"):
        Learner(committee.forest, spoil(committee.network, votes_in_all=1000))


def test_verify_refuses_a_file_with_other_weights():
    made = made_of("network")
    other = made_of("network")
    (head,) = other.heads
    network = head.learner.network
    first, *rest = network.layers
    flipped = Layer(-first.weights, first.bias, first.scale)
    changed = Head(
        head.name,
        head.classes,
        Learner(network=spoil(network, layers=(flipped, *rest))),
        head.calibration,
    )
    with pytest.raises(HoldfastError, match="differ"):
        verify(whole_graph(SPEC, [changed]), SPEC, made.heads, made.rows)
