"""Force decides "nothing": contact with hysteresis, over a zero that follows an empty hand."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import onnx
import onnxruntime as ort
import pytest

import holdfast
from holdfast.cli.main import main
from holdfast.core.contract import CLASSES, SITUATIONS, BoolArray, FloatArray
from holdfast.core.errors import UsageError
from holdfast.edge_runtime.graph import StepGraph, open_session, run_recording
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import CONTACT_KEY
from holdfast.export.artifact import read_artifact
from holdfast.export.changed import changed
from holdfast.export.exporting import model_card, seal, whole_graph
from holdfast.export.features import feature_graph
from holdfast.export.guard import reference_contact
from holdfast.export.heads import ByForce
from holdfast.export.spec import ContactRule, StepSpec
from holdfast.export.verify import touching_input

if TYPE_CHECKING:
    from conftest import Built

RATE_HZ = 100.0
SPEC = StepSpec(6, RATE_HZ, "N", ("now", "scaled_sums"))


def rule_of(spec: StepSpec = SPEC) -> ContactRule:
    assert spec.contact is not None
    return spec.contact


@cache
def session_of(spec: StepSpec) -> ort.InferenceSession:
    return open_session(feature_graph(spec).SerializeToString())


def empty_of(values: FloatArray, spec: StepSpec = SPEC) -> BoolArray:
    """[T] whether the graph says that the hand is empty."""
    valid = np.ones((len(values), spec.n_sensors), np.bool_)
    out = run_recording(session_of(spec), values, valid, ["empty"])
    flags: BoolArray = out["empty"][:, 0]
    return flags


def stepped(
    values: FloatArray, valid: BoolArray, spec: StepSpec
) -> tuple[BoolArray, FloatArray]:
    """empty [T] and the zero after each sample [T, C], read from the state."""
    graph = StepGraph(session_of(spec), 1, ["empty"])
    # behind the history and its places (guard.py)
    row = spec.history_samples + 1
    empty, zero = [], []
    for now, flags in zip(values, valid, strict=True):
        graph.sample[0] = now
        graph.valid[0] = flags
        empty.append(bool(graph.step()["empty"][0, 0]))
        zero.append(graph.state[0, row].copy())
    return np.array(empty), np.array(zero)


def quiet(seconds: float, noise_n: float, drift_n_s: float = 0.0) -> FloatArray:
    """[T, C] of an open hand; every axis drifts, up or down."""
    rng = np.random.default_rng(7)
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    drift = drift_n_s * t_s[:, None] * rng.choice([-1.0, 1.0], SPEC.n_channels)
    return drift + rng.normal(scale=noise_n, size=drift.shape)


@pytest.mark.parametrize("noise_n", [0.0, 0.003, 0.01, 0.04])
@pytest.mark.parametrize("drift_n_s", [0.0, 0.02])
def test_an_open_hand_with_any_noise_and_drift_is_empty(
    noise_n: float, drift_n_s: float
) -> None:
    empty = empty_of(quiet(20.0, noise_n, drift_n_s))
    assert empty[SPEC.settle_samples :].mean() >= 0.99
    assert not empty[: SPEC.settle_samples - 1].any()


def test_a_hold_is_seen_and_let_go_within_a_fifth_of_a_second() -> None:
    values = quiet(4.0, 0.02)
    values[100:250, 2::3] += 0.5
    empty = empty_of(values)
    assert empty[60:100].all()
    assert not empty[105:250].any()
    assert empty[270:].all()


def test_between_both_thresholds_the_last_answer_stays() -> None:
    between = (rule_of().on + rule_of().off) / 2.0
    values = np.zeros((400, SPEC.n_channels))
    values[100:] = between / np.sqrt(SPEC.n_channels)
    values[120:200, 2] += 5.0
    empty = empty_of(values)
    assert empty[60:120].all()
    assert not empty[125:].any()


@pytest.mark.parametrize("least", [6, 4])
def test_the_graph_follows_the_rule_in_plain_python(least: int) -> None:
    spec = msgspec.structs.replace(SPEC, min_valid_sensors=least)
    values, valid = touching_input(spec, rule_of(spec), seed=3)
    expected, zeros = reference_contact(values, valid, spec, rule_of(spec))
    empty, zero = stepped(values, valid, spec)
    assert expected.any()
    assert not expected.all()
    np.testing.assert_array_equal(empty, expected)
    np.testing.assert_allclose(zero, zeros, rtol=0, atol=1e-12)


def test_the_zero_stands_still_in_a_hold_and_while_the_state_is_unknown() -> None:
    values = quiet(6.0, 0.0, 0.02)
    valid = np.ones((600, 6), np.bool_)
    values[100:300, 2::3] += 1.0
    valid[400:420, 1] = False
    _, zero = stepped(values, valid, SPEC)
    moved = np.abs(np.diff(zero, axis=0)).max(axis=1)
    assert (moved[105:299] == 0.0).all()
    # lost for too long, the sensor settles again for as long as the history
    assert (moved[400 : 400 + 20 + SPEC.settle_samples - 2] == 0.0).all()
    assert (moved[60:95] > 0.0).all()


def test_a_hand_that_is_loaded_from_the_start_keeps_its_zero() -> None:
    values = quiet(3.0, 0.003)
    values[:, 2::3] += 0.2
    empty, zero = stepped(values, np.ones((300, 6), np.bool_), SPEC)
    assert not empty.any()
    assert not zero.any()


def test_a_touch_that_grows_more_slowly_than_the_zero_follows_is_missed() -> None:
    t_s = np.arange(2000) / RATE_HZ
    seen = []
    for factor in (0.8, 4.0):
        values = np.zeros((2000, SPEC.n_channels))
        values[:, 2] = factor * rule_of().zero_per_s * t_s
        seen.append(not empty_of(values)[SPEC.settle_samples :].all())
    assert seen == [False, True]


@pytest.mark.parametrize(("step_n", "ends"), [(0.15, True), (0.3, False)])
def test_a_small_offset_step_is_taken_in_a_large_one_stays_a_touch(
    step_n: float, ends: bool
) -> None:
    values = quiet(10.0, 0.003)
    values[300:, 2] += step_n
    empty = empty_of(values)
    assert empty[60:300].all()
    assert empty[900:].all() == ends
    if not ends:
        # it ends with the offset
        values[700:, 2] -= step_n
        assert empty_of(values)[760:].all()


def test_while_the_zero_stays_0_every_feature_has_its_old_bits() -> None:
    values = np.zeros((300, SPEC.n_channels))
    values[100:] = np.random.default_rng(1).normal(1.0, 1.0, (200, SPEC.n_channels))
    valid = np.ones((300, 6), np.bool_)
    names = ["features", "detectors"]
    old = msgspec.structs.replace(SPEC, force_decides=False)
    by_force = run_recording(session_of(SPEC), values, valid, names)
    plain = run_recording(session_of(old), values, valid, names)
    for name in names:
        assert by_force[name].tobytes() == plain[name].tobytes()


def test_votes_of_an_empty_hand_are_for_nothing_and_in_contact_for_anything_else() -> (
    None
):
    votes = np.array([[50, 30, 10, 5, 1, 1, 1, 2]])
    rule = ByForce("situation", CLASSES, 100)
    assert rule.in_contact(votes).tolist() == [[0, 0, 60, 35, 1, 1, 1, 2]]
    assert rule.without_contact().tolist() == [50, 50, 0, 0, 0, 0, 0, 0]
    four = ByForce("situation", SITUATIONS, 7)
    assert four.in_contact(np.array([[3, 2, 1, 1]])).tolist() == [[0, 5, 1, 1]]
    assert four.without_contact().tolist() == [7, 0, 0, 0]
    question = ByForce("p_risky_250ms", ("no", "yes"), 7)
    assert question.in_contact(np.array([[3, 4]])).tolist() == [[3, 4]]
    assert question.without_contact().tolist() == [7, 0]


def test_a_unit_without_a_noise_limit_leaves_nothing_to_the_learner() -> None:
    for unit in ("uT", "count"):
        assert (
            msgspec.structs.replace(SPEC, unit=unit, force_decides=None).contact is None
        )
    assert StepSpec.from_json(SPEC.to_json()) == SPEC


# -- files of before the rule


@pytest.fixture(scope="module")
def older(eight_classes: Built, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file as an earlier version wrote it."""
    artifact = read_artifact(eight_classes.artifact)
    spec = msgspec.structs.replace(artifact.spec, force_decides=False)
    card = model_card(replace(artifact, spec=spec))
    del card[CONTACT_KEY], card["spec"]["force_decides"]
    path = tmp_path_factory.mktemp("older") / "older.onnx"
    path.write_bytes(seal(whole_graph(spec, artifact.heads), card, spec))
    return path


def test_an_older_file_loads_and_warns_once_in_plain_words(
    older: Path, eight_classes: Built
) -> None:
    with pytest.warns(UserWarning, match="decides 'nothing' by noise") as given:
        holdfast.load(older, live=False)
    assert len(given) == 1
    holdfast.load(eight_classes.model, live=False)


def test_an_older_file_is_exported_again_with_its_own_learner(older: Path) -> None:
    old = older.read_bytes()
    card, new = changed(old)
    assert card[CONTACT_KEY] == rule_of(StepSpec.from_json(card["spec"])).to_json()
    assert learner_digest(old) == learner_digest(new)

    path = older.with_name("new.onnx")
    path.write_bytes(new)
    assert Model(path).card.decides_by_force
    with pytest.raises(UsageError, match="up to date"):
        changed(new)


def learner_digest(data: bytes) -> str:
    """SHA-256 of all numbers behind the features: trees, weights, calibration."""
    model = onnx.load_from_string(data)
    constants = {one.name: one for one in model.graph.initializer}
    behind = {"features"}
    digest = hashlib.sha256()
    for node in model.graph.node:
        of_rule = "empty" in node.input or (
            node.op_type == "MatMul" and node.input[0].startswith("learned_")
        )
        if behind.isdisjoint(node.input):
            continue
        behind.update(node.output)
        if of_rule:
            continue
        digest.update(node.op_type.encode())
        for attribute in node.attribute:
            digest.update(attribute.SerializeToString(deterministic=True))
        for name in node.input:
            if name in constants:
                digest.update(onnx.numpy_helper.to_array(constants[name]).tobytes())
    return digest.hexdigest()


def test_a_run_of_an_older_file_says_so_once(
    older: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--source", "virtual://ft232h", "--seconds", "0.1"]
    assert main(["run", str(older), *words]) == 0
    assert capsys.readouterr().err.count("decides 'nothing' by noise") == 1
