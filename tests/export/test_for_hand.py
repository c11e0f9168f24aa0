"""One learner, a file for every hand: the votes stay, the step is that of the hand card."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import small_model
from small_model import card_of

from holdfast.cli.main import main
from holdfast.core.contract import FloatArray
from holdfast.core.errors import UsageError
from holdfast.core.hand_card import read_hand_card
from holdfast.edge_runtime.graph import open_session, run_recording
from holdfast.edge_runtime.model_file import read_sealed
from holdfast.edge_runtime.monitor import Model
from holdfast.export.changed import changed
from holdfast.export.exporting import export_artifact
from holdfast.live.model_checks import model_checks
from holdfast.step.artifact import write_artifact
from holdfast.step.pooled import FAMILIES
from holdfast.step.spec import StepSpec

HANDS = ("two-pad-gripper", "three-fingertips", "twelve-sensors", "pinch-pad")
"""The self-check that reads the wall clock, which a busy machine may fail."""
NAMES = ["votes", "situation", "p_class", "unknown"]


@cache
def made() -> small_model.Artifact:
    spec = small_model.spec(tuple(FAMILIES), n_sensors=6)
    return small_model.with_networks(small_model.artifact(spec, extra=False))


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("six") / "artifact"
    write_artifact(folder, made())
    path, _ = export_artifact(folder)
    return path


def votes(path: Path, values: FloatArray) -> dict[str, np.ndarray]:
    return answered(path.read_bytes(), values)


def answered(data: bytes, values: FloatArray) -> dict[str, np.ndarray]:
    session = open_session(data)
    valid = np.ones((len(values), values.shape[1] // 3), dtype=np.bool_)
    return run_recording(session, values, valid, [*NAMES, "features"])


@pytest.mark.parametrize("hand", HANDS)
def test_a_file_for_another_hand_opens_tests_itself_and_answers(
    six: Path, hand: str, tmp_path: Path
) -> None:
    out = tmp_path / "hand.onnx"
    assert main(["export", str(six), "--hand", hand, "--out", str(out)]) == 0
    card = read_hand_card(hand)
    model = Model(out)
    assert model.card.n_channels == 3 * card.n_sensors
    assert StepSpec.from_json(model.card.raw["spec"]).hand == card_without_text(hand)
    assert {one.status for one in model_checks(out)} == {"ok"}
    assert json.loads(out.with_suffix(".json").read_text("utf-8"))["spec"]["hand"]


def card_without_text(hand: str) -> object:
    spec = StepSpec(
        read_hand_card(hand).n_sensors, 50.0, "N", ("now",), hand=read_hand_card(hand)
    )
    return StepSpec.from_json(spec.to_json()).hand


def test_the_folder_and_the_file_give_the_same_file(six: Path, tmp_path: Path) -> None:
    hand = read_hand_card("three-fingertips")
    of_folder, _ = export_artifact(six.parent, tmp_path / "folder.onnx", hand=hand)
    data = changed(read_sealed(six), hand)
    of_file = tmp_path / "file.onnx"
    of_file.write_bytes(data)
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(0.0, 0.1, (80, 9)), axis=0) + 1.0
    first, second = votes(of_folder, values), votes(of_file, values)
    for name, rows in first.items():
        np.testing.assert_array_equal(rows, second[name])


def test_a_file_exported_again_keeps_its_card_and_its_answers(six: Path) -> None:
    data = changed(read_sealed(six))
    assert card_of(data) == Model(six).card.raw
    values = np.random.default_rng(2).normal(1.0, 1.0, size=(200, 18))
    before, after = votes(six, values), answered(data, values)
    for name, rows in before.items():
        np.testing.assert_array_equal(rows, after[name])
    again = changed(data)
    assert sorted(answered(again, values)) == sorted(after)


def test_twelve_sensors_with_half_the_force_each_read_as_six(
    six: Path, tmp_path: Path
) -> None:
    """All but the direction of the mean shear, which counts less at a small force."""
    out = tmp_path / "twelve.onnx"
    hand = read_hand_card("twelve-sensors")
    data = changed(read_sealed(six), hand)
    out.write_bytes(data)
    rng = np.random.default_rng(1)
    values = np.cumsum(rng.normal(0.0, 0.05, (80, 6, 3)), axis=0)
    values += np.array([0.3, 0.1, 3.0])
    halves = np.repeat(0.5 * values, 2, axis=1)
    few = votes(six, values.reshape(80, 18))
    many = votes(out, halves.reshape(80, 36))
    known = ~few["unknown"]
    assert known.any()
    of_direction = []
    for name, family in FAMILIES.items():
        has_direction = name in ("pooled_along", "pooled_ratio")
        of_direction += [has_direction] * len(family.features)
    same = ~np.array(of_direction)
    got, expected = (one["features"][known][:, same] for one in (many, few))
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-5)


def test_a_model_of_single_sensors_is_refused_in_plain_words(tmp_path: Path) -> None:
    hand = read_hand_card("three-fingertips")
    with pytest.raises(UsageError, match="fits the hand that it was trained on") as no:
        changed(small_model.sealed_bytes(), hand)
    assert "now" in str(no.value)


def test_rules_of_the_decision_change_and_the_answers_do_not(
    six: Path, tmp_path: Path
) -> None:
    out = tmp_path / "changed.onnx"
    asked = ["--rule", "evidence_ms=300", "--rule", "min_risky_permille=650"]
    assert main(["export", str(six), "--out", str(out), *asked]) == 0
    before, after = Model(six).card.raw, Model(out).card.raw
    rules = {"evidence_ms": 300, "min_risky_permille": 650}
    assert after == before | {"decision": before["decision"] | rules}
    beside = json.loads(out.with_suffix(".json").read_text("utf-8"))
    assert beside["decision"] == after["decision"]
    values = np.random.default_rng(1).normal(0.0, 1.0, size=(200, 18))
    answers, as_before = votes(out, values), votes(six, values)
    assert all(np.array_equal(answers[name], as_before[name]) for name in answers)


@pytest.mark.parametrize(
    ("rules", "says"),
    [
        ({"evidence": 300}, "no rule 'evidence' of the decision; next: choose from"),
        ({"evidence_ms": 0}, "rule evidence_ms = 0, not a whole number from 1 to"),
        ({"answer_permille": 900}, "rule a full answer is not above answer_permille"),
    ],
)
def test_a_rule_that_cannot_be_is_an_error(
    six: Path, rules: dict[str, int], says: str
) -> None:
    with pytest.raises(UsageError, match=says):
        changed(read_sealed(six), rules=rules)
