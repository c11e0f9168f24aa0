"""One learner, a file for every hand: the votes stay, the step is that of the hand card."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import onnx
import pytest
import small_model

from holdfast.cli.main import main
from holdfast.core.contract import FloatArray, Sample
from holdfast.core.errors import UsageError
from holdfast.core.hand_card import read_hand_card
from holdfast.edge_runtime.graph import open_session, run_recording
from holdfast.edge_runtime.grip_control import sense_of
from holdfast.edge_runtime.model_file import CONTACT_KEY, read_sealed
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.export.artifact import write_artifact
from holdfast.export.changed import changed
from holdfast.export.exporting import (
    export_artifact,
    model_card,
    seal,
    whole_graph,
)
from holdfast.export.pooled import FAMILIES
from holdfast.export.spec import StepSpec
from holdfast.live.model_checks import model_checks

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
    _, data = changed(read_sealed(six), hand)
    of_file = tmp_path / "file.onnx"
    of_file.write_bytes(data)
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(0.0, 0.1, (80, 9)), axis=0) + 1.0
    first, second = votes(of_folder, values), votes(of_file, values)
    for name, rows in first.items():
        np.testing.assert_array_equal(rows, second[name])


def test_twelve_sensors_with_half_the_force_each_read_as_six(
    six: Path, tmp_path: Path
) -> None:
    """All but the direction of the mean shear, which counts less at a small force."""
    out = tmp_path / "twelve.onnx"
    hand = read_hand_card("twelve-sensors")
    _, data = changed(read_sealed(six), hand)
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
        has_direction = name in ("pooled_along", "pooled_across", "pooled_ratio")
        of_direction += [has_direction] * len(family)
    same = ~np.array(of_direction)
    got, expected = (one["features"][known][:, same] for one in (many, few))
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-5)


def test_a_model_of_single_sensors_is_refused_in_plain_words(tmp_path: Path) -> None:
    hand = read_hand_card("three-fingertips")
    with pytest.raises(UsageError, match="fits the hand that it was trained on") as no:
        changed(small_model.sealed_bytes(), hand)
    assert "now" in str(no.value)


def test_a_file_that_got_the_contact_rule_changes_for_a_hand_too(six: Path) -> None:
    artifact = made()
    spec = msgspec.structs.replace(artifact.spec, force_decides=False)
    card = model_card(replace(artifact, spec=spec))
    del card[CONTACT_KEY]
    del card["spec"]["force_decides"]
    older = seal(whole_graph(spec, artifact.heads), card, spec)
    _, ruled = changed(older)
    values = np.random.default_rng(2).normal(0.0, 1.0, size=(200, 6))
    hand = read_hand_card("two-pad-gripper")
    answers = [answered(changed(one, hand)[1], values) for one in (ruled, older)]
    _, of_six = changed(six.read_bytes(), hand)
    expected = answered(of_six, values)
    for name in NAMES:
        np.testing.assert_array_equal(answers[0][name], expected[name])
        np.testing.assert_array_equal(answers[1][name], expected[name])


def test_the_learner_behind_the_features_is_the_same(six: Path) -> None:
    _, data = changed(read_sealed(six), read_hand_card("two-pad-gripper"))
    numbers = [
        numbers_of(onnx.load_from_string(one)) for one in (six.read_bytes(), data)
    ]
    assert numbers[0] == numbers[1]


def numbers_of(model: onnx.ModelProto) -> list[bytes]:
    """Trees, and every constant that a node behind the features reads."""
    constants = {one.name: one for one in model.graph.initializer}
    behind = {"features"}
    found = []
    for node in model.graph.node:
        if behind.isdisjoint(node.input):
            continue
        behind.update(node.output)
        for attribute in node.attribute:
            found.append(attribute.SerializeToString(deterministic=True))
        for name in node.input:
            if name in constants:
                found.append(onnx.numpy_helper.to_array(constants[name]).tobytes())
    return sorted(found)


def test_a_degraded_hand_says_so_and_a_hand_without_a_side_is_unknown(
    six: Path, tmp_path: Path
) -> None:
    out = tmp_path / "three.onnx"
    _, data = changed(read_sealed(six), read_hand_card("three-fingertips"))
    out.write_bytes(data)
    model = Model(out)
    monitor = GripMonitor(model, None)
    period_ns = round(1e9 / model.card.rate_hz)
    answers = []
    for k in range(120):
        valid = np.ones(3, dtype=np.bool_)
        if 60 <= k < 80:
            valid[2] = False
        if k >= 100:
            valid[0] = False
        values = np.full(9, 1.0 + k / 1024)
        answers.append(monitor.feed(Sample(k * period_ns, values, valid, k)))
    assert all(one.degraded and one.state != "unknown" for one in answers[62:80])
    assert all(one.state == "unknown" for one in answers[102:])
    assert answers[100].why == "sensors"


def test_the_grip_of_a_hand_with_a_card_keeps_the_force_of_a_dead_finger() -> None:
    """Six fingers of 1 N hold with 3 N a side, also while one of each side is not read."""
    forces = np.tile([0.5, 0.0, 1.0], 6)
    thumb = (True, True, False, False, False, False)
    prediction: Any = SimpleNamespace(
        p_risky=0.0,
        p_situation={"safe_slip": 0.0},
        state="grasp",
        opening=False,
        overridden=False,
    )
    valid = np.ones(6, dtype=np.bool_)
    whole = sense_of(prediction, forces, valid, thumb)
    assert whole.grip_n == sense_of(prediction, forces, valid).grip_n == 3.0
    valid[[0, 5]] = False
    degraded = sense_of(prediction, forces, valid, thumb)
    assert degraded.grip_n == pytest.approx(3.0)
    assert degraded.load_n == pytest.approx(whole.load_n)
    # a pinch whose sensors all lie on one side: the other side bears the same
    one_side = sense_of(prediction, forces, np.ones(6, np.bool_), (True,) * 6)
    assert one_side.grip_n == pytest.approx(6.0)


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


def test_a_rule_changes_with_the_hand(six: Path, tmp_path: Path) -> None:
    out = tmp_path / "pads.onnx"
    asked = ["--hand", "two-pad-gripper", "--rule", "evidence_ms=300"]
    assert main(["export", str(six), "--out", str(out), *asked]) == 0
    card = Model(out).card
    assert (card.n_channels, card.decision.evidence_ms) == (6, 300)


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


def test_a_rule_is_of_a_model_file_and_has_a_number(
    six: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "new.onnx")]
    assert main(["export", str(six), *out, "--rule", "evidence_ms"]) == 2
    assert "write NAME=NUMBER" in capsys.readouterr().err
    assert main(["export", str(six.parent), *out, "--rule", "evidence_ms=3"]) == 2
    assert "export the folder first" in capsys.readouterr().err
    words = ["export", str(six), "--to", "c", "--rule", "evidence_ms=3"]
    assert main(words) == 2
    assert "--rule with --to c" in capsys.readouterr().err
