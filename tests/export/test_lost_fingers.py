"""A hand that has lost fingers calls no slip safe: live, evaluated, in a loop and in C alike."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from c_form import CForm, c_form, run
from hazard_marks import LOST_SENSOR
from made_once import made_once
from made_prediction import prediction
from small_model import artifact, graph_of, spec

from holdfast.core.contract import SITUATIONS, BoolArray, FloatArray, Sample
from holdfast.data.recording import Recording
from holdfast.edge_runtime.batch import ManyHands
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules
from holdfast.edge_runtime.grip_control import forces_of, sense_of
from holdfast.edge_runtime.model import situations_of
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.evaluation.model_outputs import OUTPUTS, read_outputs, steps_with
from holdfast.export.c.graph import read_graph
from holdfast.export.exporting import model_card, seal
from holdfast.simulation.loop.sensing import HandModels
from holdfast.step.pooled import FAMILIES
from holdfast.training.crossval import stepped
from holdfast.training.plan import ForestPlan

RATE_HZ = 50.0
SENSORS = 6
LOST = [np.array(one) for one in product([False, True], repeat=SENSORS)][1:]
"""All 63 subsets of lost sensors."""
LENGTH, FROM = 70, 30
"""Samples of a hand; a subset is lost from FROM on, when the model has settled."""
FELT = np.dtype(
    [
        ("label", "i4"),
        ("forces", "f8", 2),
        ("p", "f8", 2),
        ("known", "u1"),
        ("empty", "u1"),
        ("act", "u1"),
    ]
)
Array = npt.NDArray[Any]


@pytest.fixture(scope="module")
def form(tmp_path_factory: pytest.TempPathFactory) -> CForm:
    """Six sensors, pooled features, four of six needed."""

    def write(folder: Path) -> None:
        usual = spec(tuple(FAMILIES), n_sensors=SENSORS, rate_hz=RATE_HZ)
        shape = msgspec.structs.replace(usual, min_valid_sensors=4)
        plan = ForestPlan(kind="random", n_estimators=3, max_depth=8)
        made = replace(
            artifact(shape, extra=False, plan=plan),
            decision=DecisionRules(act_samples=1, min_risky_permille=250).to_json(),
        )
        data = seal(graph_of(made), model_card(made), made.spec)
        (folder / "model.onnx").write_bytes(data)
        c_form(folder / "model.onnx", folder / "c")

    folder = made_once(tmp_path_factory, "lost-fingers", write)
    return CForm(folder / "model.onnx", folder / "c", read_graph(folder / "model.onnx"))


def pressed(lost: BoolArray, seed: int) -> tuple[FloatArray, BoolArray]:
    """(values [T, 18], valid [T, 6]) of a hand whose load wanders; lost [6] from FROM on."""
    rng = np.random.default_rng(seed)
    size = rng.choice([0.05, 0.3, 1.0])
    values = np.cumsum(rng.normal(0.0, size, (LENGTH, SENSORS, 3)), axis=0)
    values[..., 2] = np.abs(values[..., 2]) + 0.5
    valid = np.ones((LENGTH, SENSORS), dtype=np.bool_)
    valid[FROM:, lost] = False
    return values.reshape(LENGTH, -1), valid


HANDS = [pressed(lost, number) for number, lost in enumerate(LOST)]


def live(model: Model, values: FloatArray, valid: BoolArray) -> tuple[Array, Array]:
    """(what a hand feels at every sample, as in FELT; where the answer is degraded)."""
    monitor = GripMonitor(model, None, has_counters=True)
    felt = np.zeros(len(values), FELT)
    degraded = []
    for k, (row, flags) in enumerate(zip(values, valid, strict=True)):
        answer = monitor.feed(Sample(round(k * 1e9 / RATE_HZ), row, flags, k))
        sense = sense_of(answer, row, flags, model.card.thumb)
        label = UNKNOWN
        if answer.state != "unknown":
            label = SITUATIONS.index(answer.state)
        forces, p = (sense.grip_n, sense.load_n), (sense.p_risky, sense.p_safe)
        felt[k] = (label, forces, p, sense.known, sense.empty, answer.act)
        degraded.append(answer.degraded)
    return felt, np.array(degraded)


def recording_of(values: FloatArray, valid: BoolArray) -> Recording:
    return Recording("one", "one", values, valid, RATE_HZ, "N")


@LOST_SENSOR.mark
def test_no_subset_of_lost_sensors_gives_a_safe_slip_and_all_engines_agree(
    form: CForm,
) -> None:
    model = Model(form.model)
    felt, degraded = map(
        np.stack, zip(*[live(model, *hand) for hand in HANDS], strict=True)
    )
    assert {1, 3} <= set(felt["label"][degraded].tolist()) <= {0, 1, 3}
    assert (felt["p"][degraded, 1] == 0.0).all()
    # whole hands call some slips safe, and so would the model on those that lost a finger
    assert (felt["label"][:, :FROM] == 2).any()

    recordings = [recording_of(*hand) for hand in HANDS]
    computed = stepped(
        steps_with(model, OUTPUTS), recordings, [np.arange(LENGTH)] * len(LOST)
    )
    said = np.stack([one["situation"] for one in computed])
    assert (said[degraded] == 2).sum() > 20
    read = read_outputs(model, recordings, computed)
    assert (np.stack([one.situation for one in read]) == felt["label"]).all()

    record = [("sample", "f8", 18), ("valid", "u1", SENSORS), ("fresh", "u1")]
    given = np.zeros((len(HANDS), LENGTH), np.dtype(record))
    given["fresh"][:, 0] = 1
    for number, (values, valid) in enumerate(HANDS):
        given["sample"][number], given["valid"][number] = values, valid
    in_c = run(form.program("gcc", "-O2"), "hand", given, FELT).reshape(felt.shape)
    for name in ("label", "known", "empty", "act"):
        assert (in_c[name] == felt[name]).all(), name
    assert in_c["forces"].tobytes() == felt["forces"].tobytes()
    assert np.abs(in_c["p"] - felt["p"]).max() < 1e-6


def test_a_loop_of_hands_feels_of_its_other_fingers_what_the_live_path_feels(
    form: CForm,
) -> None:
    model = Model(form.model)
    many = HandModels(model, len(HANDS))
    never = np.zeros(len(HANDS), dtype=np.bool_)
    one_by_one = np.stack([live(model, *hand)[0] for hand in HANDS])
    for k in range(LENGTH):
        values = np.stack([hand[0][k] for hand in HANDS])
        valid = np.stack([hand[1][k] for hand in HANDS])
        sense = many.answer(values, valid, never, never)
        ones = one_by_one[:, k]
        forces = np.stack((sense.grip_n, sense.load_n), axis=1)
        assert forces.tobytes() == ones["forces"].tobytes()
        p = np.stack((sense.p_risky, sense.p_safe), axis=1)
        assert np.abs(p - ones["p"]).max() < 1e-6
        assert (sense.known == ones["known"]).all()


@pytest.mark.parametrize("thumb", [None, (True, True) + (False,) * 4, (True,) * 6])
def test_fingers_stand_in_for_lost_ones_with_the_same_bits_on_one_hand_and_on_many(
    thumb: tuple[bool, ...] | None,
) -> None:
    rng = np.random.default_rng(4)
    values = rng.normal(0.3, 1.0, (len(LOST), 18))
    valid = ~np.stack(LOST)
    of_many = forces_of(ManyHands(len(LOST)), [*values.T], [*valid.T], thumb)
    ones = [
        sense_of_one(row, flags, thumb)
        for row, flags in zip(values, valid, strict=True)
    ]
    assert np.stack(of_many, axis=1).tobytes() == np.array(ones).tobytes()


def sense_of_one(
    row: FloatArray, flags: BoolArray, thumb: tuple[bool, ...] | None
) -> tuple[float, float]:
    sense = sense_of(prediction(), row, flags, thumb)
    return sense.grip_n, sense.load_n


@pytest.mark.parametrize(
    ("p_situation", "usable", "label"),
    [
        ((0.0, 0.1, 0.6, 0.3), 5, 3),
        ((0.0, 0.3, 0.6, 0.1), 5, 1),
        ((0.0, 0.2, 0.6, 0.2), 5, 3),
        ((0.0, 0.1, 0.6, 0.3), 6, 2),
        ((0.7, 0.1, 0.1, 0.1), 5, 0),
        ((0.1, 0.7, 0.1, 0.1), 5, 1),
    ],
)
def test_a_safe_slip_of_a_hand_without_a_finger_is_the_likelier_of_risky_and_grasp(
    p_situation: tuple[float, ...], usable: int, label: int
) -> None:
    out = {
        "situation": np.array([int(np.argmax(p_situation))]),
        "p_situation": np.array([p_situation]),
        "usable_sensors": np.array([usable]),
    }
    assert situations_of(out, SENSORS).tolist() == [label]
