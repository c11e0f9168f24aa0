"""The one file: its seal, its card, its golden sequences, and everything that is not such a
file."""

from __future__ import annotations

import base64
import hashlib
import json
import pickle
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import onnx
import pytest
from hard_marks import GOLDEN, VERSIONS
from hypothesis import given, settings
from hypothesis import strategies as st
from small_model import Trap, metadata_of, with_metadata

from holdfast.core.contract import CLASSES, SITUATIONS, Sample
from holdfast.core.errors import (
    BrokenSeal,
    GoldenMismatch,
    ModelError,
    NotAModel,
    RuntimeRefused,
)
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.model import check_golden
from holdfast.edge_runtime.model_file import (
    CARD_KEY,
    GOLDEN_KEY,
    SEAL_KEY,
    WRONG_RUNTIMES,
    check_runtime,
    read_sealed,
)
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.export.exporting import export_artifact, model_card, seal
from holdfast.step.artifact import read_artifact, write_artifact
from holdfast.training.fitting import VERSIONS_OF

if TYPE_CHECKING:
    from conftest import Built

PYPROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"


def stored(entry: dict[str, Any]) -> np.ndarray:
    """The golden answers of one output, as one row."""
    return np.frombuffer(base64.b64decode(entry["data"]), entry["dtype"]).copy()


def with_golden(
    data: bytes, name: str, change: Callable[[np.ndarray], np.ndarray]
) -> bytes:
    """The file, sealed again, with other stored answers of one output."""
    golden = json.loads(metadata_of(data)[GOLDEN_KEY])
    numbers = change(stored(golden[name]))
    golden[name]["data"] = base64.b64encode(numbers.tobytes()).decode()
    return with_metadata(data, **{GOLDEN_KEY: json.dumps(golden)})


@cache
def content(path: Path) -> bytes:
    return path.read_bytes()


def refused(path: Path, data: bytes) -> ModelError:
    """The error a model file with this content ends in; always one line that names the file and a
    next step."""
    path.write_bytes(data)
    with pytest.raises(ModelError) as caught:
        Model(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    return caught.value


def test_a_sealed_file_opens_and_says_who_it_is(
    eight_classes: Built, four_situations: Built
) -> None:
    eight, four = Model(eight_classes.model).card, Model(four_situations.model).card
    assert (eight.classes, eight.heads, eight.has_weight) == (CLASSES, (), True)
    assert (four.classes, four.has_weight) == (SITUATIONS, False)
    assert four.heads == ("p_risky_250ms",)
    seal = metadata_of(content(eight_classes.model))[SEAL_KEY]
    assert seal.startswith(eight.model_id)


def test_the_seal_is_the_sha256_of_the_file_with_its_own_digits_zeroed(
    eight_classes: Built,
) -> None:
    data = content(eight_classes.model)
    digits = metadata_of(data)[SEAL_KEY].encode()
    assert re.fullmatch(rb"[0-9a-f]{64}", digits)
    assert data.count(digits) == 1
    assert (
        hashlib.sha256(data.replace(digits, b"0" * 64)).hexdigest().encode() == digits
    )


@given(
    place=st.floats(0.0, 1.0, exclude_max=True),
    digit=st.none() | st.integers(0, 63),
    flip=st.integers(1, 255),
)
@settings(max_examples=150)
def test_one_altered_byte_anywhere_is_refused(
    eight_classes: Built,
    tmp_path_factory: pytest.TempPathFactory,
    place: float,
    digit: int | None,
    flip: int,
) -> None:
    """Anywhere in the file, or one digit of its seal."""
    data = content(eight_classes.model)
    altered = bytearray(data)
    at = int(place * len(data))
    if digit is not None:
        at = data.index(metadata_of(data)[SEAL_KEY].encode()) + digit
    altered[at] ^= flip
    path = tmp_path_factory.getbasetemp() / "altered.onnx"
    path.write_bytes(bytes(altered))
    # on the bytes alone, before a parser sees them
    with pytest.raises((BrokenSeal, NotAModel)):
        read_sealed(path)


def test_a_file_cut_short_anywhere_is_refused(
    eight_classes: Built, tmp_path: Path
) -> None:
    data = content(eight_classes.model)
    whole = len(data)
    ends = {*range(70), *range(70, whole, whole // 40), *range(whole - 100, whole)}
    for length in ends:
        error = refused(tmp_path / "m.onnx", data[:length])
        assert isinstance(error, BrokenSeal | NotAModel)
    assert isinstance(refused(tmp_path / "m.onnx", data[: whole // 2]), BrokenSeal)


@pytest.mark.parametrize(
    "more", [b"\n", b"\0", b"0" * 64, SEAL_KEY.encode() + b"\x12\x40" + b"0" * 64]
)
def test_so_is_one_with_something_after_its_end(
    eight_classes: Built, tmp_path: Path, more: bytes
) -> None:
    assert isinstance(
        refused(tmp_path / "m.onnx", content(eight_classes.model) + more), BrokenSeal
    )


FOREIGN: dict[str, tuple[Callable[[], bytes], str]] = {
    "a pickle": (lambda: pickle.dumps(Trap()), "pickle, which Holdfast never reads"),
    "a zip archive": (lambda: b"PK\x03\x04" + bytes(99), "zip archive"),
    "text": (lambda: b"Time,X1,Y1,Z1\n0,1,2,3\n", "not a sealed Holdfast model"),
    "an empty file": (lambda: b"", "empty file"),
    "noise": (
        lambda: np.random.default_rng(0).bytes(5000),
        "not a sealed Holdfast model",
    ),
    "another tool's ONNX file": (
        lambda: onnx.helper.make_model(
            onnx.helper.make_graph([], "g", [], [])
        ).SerializeToString(),
        "not a sealed Holdfast model",
    ),
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_what_is_no_model_is_called_by_its_name(tmp_path: Path, kind: str) -> None:
    make, message = FOREIGN[kind]
    error = refused(tmp_path / "holdfast.onnx", make())
    assert type(error) is NotAModel
    assert message in str(error)
    assert error.next_step


@VERSIONS.mark
@pytest.mark.parametrize("version", WRONG_RUNTIMES)
def test_a_runtime_known_to_be_wrong_is_refused_by_name(version: str) -> None:
    with pytest.raises(RuntimeRefused, match=re.escape(version)):
        check_runtime(version)


@pytest.mark.parametrize("version", ["1.20.0", "1.21.1", "1.25.9", "1.26.1", "11.21.0"])
def test_other_runtimes_are_not(version: str) -> None:
    check_runtime(version)


@VERSIONS.mark
def test_the_runtimes_refused_are_the_runtimes_that_are_never_installed() -> None:
    requirements = tomllib.loads(PYPROJECT.read_text("utf-8"))["project"][
        "dependencies"
    ]
    (onnxruntime,) = [line for line in requirements if line.startswith("onnxruntime")]
    assert sorted(re.findall(r"!=([\d.]+)", onnxruntime)) == sorted(WRONG_RUNTIMES)


@GOLDEN.mark
@pytest.mark.parametrize("built", ["eight_classes", "four_situations"])
def test_every_golden_answer_is_compared(
    built: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """One stored number of one output is altered: by one, by a flag, or by ten times its
    tolerance."""
    data = content(request.getfixturevalue(built).model)
    published = {output.name for output in onnx.load_from_string(data).graph.output}
    golden = json.loads(metadata_of(data)[GOLDEN_KEY])
    assert set(golden) == published - {"features", "state_out"}
    for name in golden:
        error = refused(tmp_path / "m.onnx", with_golden(data, name, moved))
        assert type(error) is GoldenMismatch
        assert repr(name) in str(error)


def moved(numbers: np.ndarray) -> np.ndarray:
    """With another number in the middle."""
    middle = len(numbers) // 2
    number = numbers[middle]
    if number.dtype.kind == "b":
        numbers[middle] = not number
    elif number.dtype.kind == "i":
        numbers[middle] += 1
    else:
        numbers[middle] += 3e-5 * max(1.0, abs(number))
    return numbers


GARBLED: dict[str, dict[str, str | None]] = {
    "no card": {CARD_KEY: None},
    "a card that is no JSON": {CARD_KEY: "{"},
    "a card that is a list": {CARD_KEY: "[]"},
    "a card of another format": {CARD_KEY: '{"format": 1}'},
    "a card without a rate": {CARD_KEY: '{"format": 2, "spec": {}}'},
    "no golden sequences": {GOLDEN_KEY: None},
    "golden sequences that are no JSON": {GOLDEN_KEY: "{"},
    "golden sequences that are a list": {GOLDEN_KEY: "[]"},
    "golden sequences without shapes": {GOLDEN_KEY: '{"votes": {}}'},
    "golden sequences of no output": {GOLDEN_KEY: "{}"},
}


@pytest.mark.parametrize("fault", GARBLED)
def test_a_file_whose_seal_holds_is_still_no_model_with(
    eight_classes: Built, tmp_path: Path, fault: str
) -> None:
    data = with_metadata(content(eight_classes.model), **GARBLED[fault])
    assert isinstance(refused(tmp_path / "m.onnx", data), NotAModel | GoldenMismatch)


def test_golden_sequences_that_are_cut_short_are_refused(
    eight_classes: Built, tmp_path: Path
) -> None:
    data = content(eight_classes.model)
    golden = json.loads(metadata_of(data)[GOLDEN_KEY])
    for one in golden.values():
        raw, rows = base64.b64decode(one["data"]), one["shape"][0]
        one["data"] = base64.b64encode(raw[: len(raw) // rows * (rows - 1)]).decode()
        one["shape"][0] = rows - 1
    data = with_metadata(data, **{GOLDEN_KEY: json.dumps(golden)})
    assert isinstance(refused(tmp_path / "m.onnx", data), GoldenMismatch)


CONTRADICTED: dict[str, tuple[str, object]] = {
    "other channels": ("spec.n_sensors", 16),
    "a head that is not there": ("heads.p_doom", {"classes": ["no", "yes"]}),
    "more detectors than there are": ("detectors", [f"d{k}" for k in range(9)]),
    "an unknown unit": ("spec.unit", "lb"),
    "an endless time to settle": ("settle_samples", 10**12),
    "a rate that is none": ("spec.rate_hz", float("nan")),
    "unknown rules": ("decision", {"dither": 1}),
    "acting on no sample": ("decision", {"act_samples": 0}),
    "releasing on no sample": ("decision", {"release_samples": 0}),
    "more votes than all": ("decision", {"min_risky_permille": 1001}),
    "an act that never times out": ("decision", {"evidence_ms": 10**9}),
    "a bias of text": ("preparation.bias_rows", "many"),
}
"""A place in the card, and what it says there."""


@pytest.mark.hard_case(
    "What comes from outside",
    "a sealed file whose card lies about its graph",
    elsewhere="the seal is valid, because anyone can seal a file, "
    "and the process ends at the first sample",
    here="card and graph are compared when the file is opened, and every value of the card has "
    "its range",
)
@pytest.mark.parametrize("fault", CONTRADICTED)
def test_a_card_that_contradicts_its_graph_is_refused(
    four_situations: Built, tmp_path: Path, fault: str
) -> None:
    place, value = CONTRADICTED[fault]
    data = content(four_situations.model)
    card = json.loads(metadata_of(data)[CARD_KEY])
    *outer, last = place.split(".")
    inner = card
    for name in outer:
        inner = inner[name]
    inner[last] = value
    data = with_metadata(data, **{CARD_KEY: json.dumps(card)})
    assert isinstance(refused(tmp_path / "m.onnx", data), NotAModel)


def test_golden_sequences_meet_settling_loss_and_more_than_one_answer(
    eight_classes: Built,
) -> None:
    golden = json.loads(metadata_of(content(eight_classes.model))[GOLDEN_KEY])
    for name in ("unknown", "settled", "usable_sensors", "situation", "detectors"):
        assert len(np.unique(stored(golden[name]))) > 1
    assert len(np.unique(stored(golden["votes"]).reshape(-1, 8), axis=0)) > 5


def test_the_card_lists_everything_a_consumer_needs(eight_classes: Built) -> None:
    card = Model(eight_classes.model).card.raw
    data, training = eight_classes.data, card["training"]
    spec = {"rate_hz": 50.0, "n_sensors": 6, "unit": "N", "min_valid_sensors": 6}
    assert spec.items() <= card["spec"].items()
    rules = {"band_ratio", "floor_tau_s", "quiet_s", "friction", "min_normal_n"}
    assert rules <= set(card["spec"]["detectors"])
    expected = {
        "window_samples": 6,
        "history_samples": 25,
        "settle_samples": 26,
        "bands_hz": [10.0, 15.0, 20.0],
        "bands_left_out_hz": [25.0, 30.0, 35.0, 40.0, 45.0, 50.0, 55.0],
        "decision": DecisionRules().to_json(),
        "detectors": ["band_pass", "band_pass_point", "friction_cone"],
        "preparation": data.preparation.to_json(),
    }
    assert {name: card[name] for name in expected} == expected
    assert card["heads"]["situation"]["classes"] == list(CLASSES)
    assert card["tie_rule"]
    assert set(training["versions"]) == {"python", *VERSIONS_OF}
    assert re.fullmatch(r"[0-9a-f]{64}", training["data_sha256"])
    assert len(training["recordings"]) == len(data.recordings)
    assert (training["seed"], training["caveat"]) == (0, data.caveat)


def test_an_artifact_read_and_written_again_exports_to_the_same_bytes(
    eight_classes: Built, tmp_path: Path
) -> None:
    write_artifact(tmp_path, read_artifact(eight_classes.artifact))
    assert export_artifact(tmp_path)[0].read_bytes() == content(eight_classes.model)


def test_the_decision_rules_of_the_card_are_the_ones_that_decide(
    eight_classes: Built, tmp_path: Path
) -> None:
    artifact = read_artifact(eight_classes.artifact)
    rules = {**artifact.decision, "arm_samples": 10**4, "act_samples": 10**4}
    never = model_card(replace(artifact, decision=rules))
    path = tmp_path / "m.onnx"
    graph = onnx.load_from_string(content(eight_classes.model))
    path.write_bytes(seal(graph, never, artifact.spec))
    pulled = next(r for r in eight_classes.data.recordings if r.action == "pull")

    def armed(model: Path) -> bool:
        monitor = GripMonitor(Model(model), None)
        samples = zip(pulled.samples, pulled.valid, strict=True)
        return any(
            monitor.feed(Sample(k * 20_000_000, row, ok, k)).arm
            for k, (row, ok) in enumerate(samples)
        )

    assert armed(eight_classes.model)
    assert not armed(path)


@pytest.mark.parametrize(
    ("dtype", "tolerance"), [("float64", 1e-9), ("float32", 1e-6), ("int64", 0)]
)
def test_golden_answers_agree_within_the_tolerance_of_their_type(
    dtype: str, tolerance: float
) -> None:
    stored = {"votes": np.array([0, 1, 1000], dtype)}
    for share, fits in ((0.9, True), (1.9, True), (2.2, False), (-2.2, False)):
        # at 1 the relative and the absolute tolerance add up
        other = {"votes": stored["votes"] + np.array([0, share * tolerance, 0], dtype)}
        if fits or not tolerance:
            check_golden(stored, other)
            continue
        with pytest.raises(GoldenMismatch, match="'votes' differs"):
            check_golden(stored, other)
