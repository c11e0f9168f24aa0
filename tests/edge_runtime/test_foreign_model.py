"""Model files that were altered and sealed again: what is refused when they are opened, before
onnxruntime sees them, and what `holdfast selftest` and its `--deep` find."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hazard_marks import FOREIGN_MODEL, HUGE_INPUT
from onnx import TensorProto, helper, numpy_helper
from small_model import (
    EXTRA_HEAD,
    artifact,
    card_of,
    graph_of,
    resealed,
    sealed_again,
    sealed_bytes,
    spec,
    with_networks,
)

from holdfast.core.contract import Unit
from holdfast.core.errors import ModelError, NotAModel
from holdfast.edge_runtime.model import Model, read_model
from holdfast.edge_runtime.onnx_bytes import (
    ALLOWED,
    MOST_FIELDS,
    VARINT,
    Field,
    Reader,
    read_onnx,
)
from holdfast.export.artifact import Artifact
from holdfast.export.c.graph import decoded
from holdfast.export.deep_check import deep_checks
from holdfast.export.exporting import model_card, seal
from holdfast.export.features import GROUPS
from holdfast.export.learner import FOREST_KINDS
from holdfast.live.graph_checks import check_answers
from holdfast.training.plan import RAW_BASELINE, hand_plan

ROOT = Path(__file__).resolve().parents[2]
RELEASED = sorted((ROOT / "models").glob("*.onnx"))


def opened(eight: bool = True) -> onnx.ModelProto:
    return onnx.load_from_string(sealed_bytes(eight))


def maker(model: onnx.ModelProto, output: str) -> onnx.NodeProto:
    (node,) = [node for node in model.graph.node if output in node.output]
    return node


def attribute(node: onnx.NodeProto, name: str) -> onnx.AttributeProto:
    (found,) = [one for one in node.attribute if one.name == name]
    return found


def output(model: onnx.ModelProto, name: str) -> onnx.ValueInfoProto:
    (found,) = [one for one in model.graph.output if one.name == name]
    return found


def constant(model: onnx.ModelProto, name: str, values: Any) -> str:
    model.graph.initializer.append(numpy_helper.from_array(np.asarray(values), name))
    return name


def after(
    model: onnx.ModelProto, name: str, op: str, *inputs: str, **attributes: Any
) -> None:
    """An output is changed by one more operator, which takes its name."""
    node = maker(model, name)
    node.output[list(node.output).index(name)] = f"{name}_before"
    for later in model.graph.node:
        for k, one in enumerate(later.input):
            later.input[k] = f"{name}_before" if one == name else one
    model.graph.node.append(
        helper.make_node(op, [f"{name}_before", *inputs], [name], **attributes)
    )


# -- outputs that are not what the card says


def situation_plus_seven(model: onnx.ModelProto) -> None:
    after(model, "situation", "Add", constant(model, "seven", np.int64(7)))


def eight_situations(model: onnx.ModelProto) -> None:
    after(model, "p_situation", "Concat", "p_class_half", axis=1)
    maker(model, "p_situation").input[1] = "p_situation_before"
    output(model, "p_situation").type.tensor_type.shape.dim[1].dim_value = 8


def missing_shape(model: onnx.ModelProto) -> None:
    output(model, "detectors").type.tensor_type.ClearField("shape")


def missing_dimension(model: onnx.ModelProto) -> None:
    output(model, "detectors").type.tensor_type.shape.dim[1].Clear()


def other_type(model: onnx.ModelProto) -> None:
    after(model, "unknown", "Cast", to=TensorProto.FLOAT)
    output(model, "unknown").type.tensor_type.elem_type = TensorProto.FLOAT


def one_output_more(model: onnx.ModelProto) -> None:
    model.graph.output.append(
        helper.make_tensor_value_info("state_before", TensorProto.DOUBLE, ["B", 1, 6])
    )


def one_output_less(model: onnx.ModelProto) -> None:
    model.graph.output.remove(output(model, "settled"))


# -- operators and parts of a file that our exporter never writes


def endless_loop(model: onnx.ModelProto) -> None:
    after(model, "p_situation", "Loop")


def hidden_subgraph(model: onnx.ModelProto) -> None:
    """An attribute that an allowed operator does not have, with a graph in it."""
    body = helper.make_graph([], "body", [], [])
    maker(model, "settled").attribute.append(helper.make_attribute("body", body))


def local_function(model: onnx.ModelProto) -> None:
    model.functions.add().name = "Abs"


def custom_domain(model: onnx.ModelProto) -> None:
    maker(model, "settled").domain = "com.microsoft"


def newer_operator_set(model: onnx.ModelProto) -> None:
    model.opset_import[0].version = 21


def external_data(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def sparse_constant(model: onnx.ModelProto) -> None:
    model.graph.sparse_initializer.add().dims.append(10**12)


# -- what costs memory or time


def huge_constant(model: onnx.ModelProto) -> None:
    model.graph.initializer[0].dims[:] = [10**6, 10**6]


def doubled_forty_times(model: onnx.ModelProto) -> None:
    wide = "sample"
    for k in range(40):
        model.graph.node.append(
            helper.make_node("Concat", [wide, wide], [f"wide{k}"], axis=1)
        )
        wide = f"wide{k}"


def outer_product(model: onnx.ModelProto) -> None:
    high = constant(model, "high", np.zeros((9000, 1)))
    wide = constant(model, "wide", np.zeros((1, 9000)))
    model.graph.node.append(helper.make_node("Add", [high, wide], ["outer"]))


# -- trees


def trees(model: onnx.ModelProto) -> onnx.NodeProto:
    return maker(model, "learned_votes")


def zero_leaves(model: onnx.ModelProto) -> None:
    weights = attribute(trees(model), "target_weights").floats
    weights[:] = [0.0] * len(weights)


def half_votes(model: onnx.ModelProto) -> None:
    weights = attribute(trees(model), "target_weights").floats
    weights[0] += 0.5
    weights[1] -= 0.5


def negative_votes(model: onnx.ModelProto) -> None:
    node = trees(model)
    weights = attribute(node, "target_weights").floats
    places = attribute(node, "target_nodeids").ints
    k = next(k for k in range(len(places) - 1) if places[k] == places[k + 1])
    weights[k], weights[k + 1] = weights[k] + weights[k + 1] + 5.0, -5.0


def tree_that_loops(model: onnx.ModelProto) -> None:
    attribute(trees(model), "nodes_truenodeids").ints[0] = 0


def feature_outside(model: onnx.ModelProto) -> None:
    attribute(trees(model), "nodes_featureids").ints[0] = 2**31 - 1


def vote_for_no_node(model: onnx.ModelProto) -> None:
    attribute(trees(model), "target_nodeids").ints[0] = 10**6


def another_mode(model: onnx.ModelProto) -> None:
    attribute(trees(model), "nodes_modes").strings[0] = b"BRANCH_EQ"


def a_column_short(model: onnx.ModelProto) -> None:
    attribute(trees(model), "nodes_values").floats.pop()


# -- the rest


def not_a_number(model: onnx.ModelProto) -> None:
    constant(model, "nan", np.float64("nan"))


def input_from_nowhere(model: onnx.ModelProto) -> None:
    maker(model, "settled").input[0] = "nowhere"


def other_state(model: onnx.ModelProto) -> None:
    model.graph.input[3].type.tensor_type.shape.dim[1].dim_value += 1


Alteration = Callable[[onnx.ModelProto], None]
AT_LOAD: tuple[Alteration, ...] = (
    eight_situations,
    missing_shape,
    missing_dimension,
    other_type,
    one_output_more,
    one_output_less,
    endless_loop,
    hidden_subgraph,
    local_function,
    custom_domain,
    newer_operator_set,
    external_data,
    sparse_constant,
    huge_constant,
    other_state,
)
"""Refused before onnxruntime opens the file."""
DEEP: dict[Alteration, str] = {
    doubled_forty_times: "shapes",
    outer_product: "shapes",
    input_from_nowhere: "shapes",
    not_a_number: "constants",
    zero_leaves: "trees",
    half_votes: "trees",
    negative_votes: "trees",
    tree_that_loops: "trees",
    feature_outside: "trees",
    vote_for_no_node: "trees",
    another_mode: "trees",
    a_column_short: "trees",
}
"""Found by `selftest --deep`, each by one of its checks."""


def refused_unopened(data: bytes) -> NotAModel:
    """The error; read_model never calls onnxruntime."""
    with pytest.raises(ModelError) as caught:
        read_model(data, "m.onnx")
    assert type(caught.value) is NotAModel
    assert str(caught.value).startswith("m.onnx: ")
    assert "\n" not in str(caught.value)
    return caught.value


def altered(alter: Alteration, folder: Path, golden: bool = False) -> Path:
    """A model file that was altered and sealed again, with its golden sequences made anew."""
    model = opened()
    alter(model)
    path = folder / "m.onnx"
    path.write_bytes(resealed(model, golden=golden))
    return path


@FOREIGN_MODEL.mark
@pytest.mark.parametrize("alter", AT_LOAD, ids=lambda alter: alter.__name__)
def test_a_resealed_file_is_refused_before_onnxruntime_opens_it(
    alter: Alteration,
) -> None:
    model = opened()
    alter(model)
    assert refused_unopened(resealed(model)).next_step


@FOREIGN_MODEL.mark
@pytest.mark.parametrize("alter", DEEP, ids=lambda alter: alter.__name__)
def test_the_deep_check_finds_what_a_file_hides_until_later(
    alter: Alteration, tmp_path: Path
) -> None:
    failed = [one for one in deep_checks(altered(alter, tmp_path)) if not one.ok]
    assert f"deep: {DEEP[alter]}" in [one.what for one in failed]
    assert not any("\n" in one.figure for one in failed)


@pytest.mark.parametrize("eight", [True, False])
def test_the_deep_check_accepts_what_the_exporter_writes(
    eight: bool, tmp_path: Path
) -> None:
    (tmp_path / "m.onnx").write_bytes(sealed_bytes(eight))
    results = list(deep_checks(tmp_path / "m.onnx"))
    assert [one.what for one in results if not one.ok] == []
    assert len(results) == 4


def more_sensors_than_there_are(model: onnx.ModelProto) -> None:
    after(model, "usable_sensors", "Add", constant(model, "nine", np.int32(9)))


@FOREIGN_MODEL.mark
@pytest.mark.parametrize(
    ("alter", "found"),
    [
        (situation_plus_seven, "situation"),
        (more_sensors_than_there_are, "usable_sensors"),
    ],
)
def test_the_selftest_finds_answers_that_cannot_be(
    alter: Alteration, found: str, tmp_path: Path
) -> None:
    (result,) = check_answers(Model(altered(alter, tmp_path, golden=True)))
    assert not result.ok
    assert found in result.figure


def probabilities_that_are_no_number(model: onnx.ModelProto) -> None:
    product = maker(model, maker(model, maker(model, "p_class").input[0]).input[0])
    (weights,) = [
        one for one in model.graph.initializer if one.name == product.input[1]
    ]
    weights.raw_data = np.full_like(numpy_helper.to_array(weights), 3e38).tobytes()


@FOREIGN_MODEL.mark
def test_probabilities_that_are_no_number_are_refused_at_load(tmp_path: Path) -> None:
    path = altered(probabilities_that_are_no_number, tmp_path, golden=True)
    with pytest.raises(ModelError, match="p_"):
        Model(path)


@FOREIGN_MODEL.mark
@pytest.mark.parametrize(
    "name",
    [
        "features",
        "p_class",
        "votes_p_x",
        "",
        "p\x1b[2J",
    ],
)
def test_a_further_head_may_not_be_named_like_anything_else(name: str) -> None:
    card = card_of(sealed_bytes())
    card["heads"][name] = card["heads"].pop(EXTRA_HEAD)
    error = refused_unopened(resealed(opened(), card))
    assert "\x1b" not in str(error)


@HUGE_INPUT.mark
def test_a_card_whose_golden_sequences_would_take_hours_is_refused_before_they_are_made() -> (
    None
):
    card = card_of(sealed_bytes()) | {"settle_samples": 10_000}
    model = opened()
    for shape in (
        model.graph.input[0],
        model.graph.input[3],
        output(model, "state_out"),
    ):
        shape.type.tensor_type.shape.dim[2].dim_value = 30_000
    model.graph.input[1].type.tensor_type.shape.dim[2].dim_value = 10_000
    card["spec"] = {**card["spec"], "n_sensors": 10_000, "min_valid_sensors": 10_000}
    assert "golden" in str(refused_unopened(resealed(model, card)))


# -- bytes that two parsers could read differently


def varint(number: int) -> bytes:
    groups = [
        number >> 7 * k & 127 for k in range(max(1, -(-number.bit_length() // 7)))
    ]
    return bytes([*(group | 128 for group in groups[:-1]), groups[-1]])


def field(number: int, data: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(data)) + data


def a_second_graph(data: bytes) -> bytes:
    """protobuf joins two fields where one belongs: a parser that takes one of them sees another
    graph."""
    loop = helper.make_node("Loop", ["", ""], ["x"]).SerializeToString()
    return field(7, field(1, loop)) + data


def a_second_card(data: bytes) -> bytes:
    return field(14, field(1, b"holdfast.card") + field(2, b"{}")) + data


UNLIKE: dict[str, Callable[[bytes], bytes]] = {
    "a second graph": a_second_graph,
    "a second card": a_second_card,
    "a field of no number": lambda data: b"\x02\x00" + data,
    "an unknown field": lambda data: field(99, b"x") + data,
    "a group": lambda data: b"\x3b\x3c" + data,
    "eight bytes": lambda data: b"\x09" + bytes(8) + data,
    "a padded number": lambda data: data.replace(b"\x08\x0a", b"\x08\x8a\x00", 1),
    "an endless number": lambda data: b"\x08" + b"\xff" * 11 + data,
    "a length past the end": lambda data: b"\x3a\xff\xff\xff\x7f" + data,
    "a second IR version": lambda data: b"\x08\x0a" + data,
}


@FOREIGN_MODEL.mark
@pytest.mark.parametrize("kind", UNLIKE)
def test_bytes_that_two_parsers_could_read_differently_are_refused(kind: str) -> None:
    refused_unopened(sealed_again(UNLIKE[kind](sealed_bytes())))


@FOREIGN_MODEL.mark
def test_a_seal_that_is_not_in_the_metadata_is_refused() -> None:
    """The digits that are checked stand in the card, and the metadata name a model of their own
    choice."""
    model = opened()
    model.metadata_props[2].value = "f" * 64
    hidden = field(
        14, field(1, b"note") + field(2, b"holdfast.sha256\x12\x40" + b"0" * 64)
    )
    assert "seal" in str(
        refused_unopened(sealed_again(model.SerializeToString() + hidden))
    )


@HUGE_INPUT.mark
def test_reading_the_bytes_of_a_bomb_takes_little_memory() -> None:
    model = opened()
    huge_constant(model)
    doubled_forty_times(model)
    data = resealed(model)
    tracemalloc.start()
    refused_unopened(data)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20 * len(data)


@HUGE_INPUT.mark
def test_the_fields_that_are_read_are_counted_and_limited() -> None:
    reader = Reader()
    with pytest.raises(ValueError, match="more than"):
        reader.message(
            memoryview(b"\x08\x01" * (2 * MOST_FIELDS)),
            {1: Field("x", repeated=True, wire=VARINT)},
        )
    assert reader.fields == MOST_FIELDS + 1


@pytest.mark.parametrize(
    ("data", "says"),
    [
        ("08 7f", 127),
        ("08 80 01", 128),
        ("08 00", 0),
        (f"08 {'ff' * 9} 01", 2**64 - 1),
        (f"08 {'ff' * 9} 02", "too long"),
        (f"08 {'80' * 10} 01", "too long"),
        ("08 80 00", "padded"),
        ("08", "cut short"),
        ("08 80", "cut short"),
        ("12 00", b""),
        ("12 02 61 62", b"ab"),
        ("12 02 61", "a field is longer than its message"),
        ("72 01 61", b"a"),
        ("08 01 08 01", "its field x occurs twice"),
        ("18 01", "number 3, type 0"),
        ("0a 00", "number 1, type 2"),
        ("10 01", "number 2, type 0"),
        ("09 01", "number 1, type 1"),
    ],
)
def test_a_field_is_a_tag_and_a_value_and_nothing_else(data: str, says: object) -> None:
    schema = {1: Field("x", wire=VARINT), 2: Field("d"), 14: Field("d")}
    message = memoryview(bytes.fromhex(data))
    if isinstance(says, str):
        with pytest.raises(ValueError, match=says):
            Reader().message(message, schema)
    else:
        ((value,),) = Reader().message(message, schema).values()
        assert value == says


# -- what our exporter writes is what is allowed


@pytest.fixture(scope="module")
def artifacts() -> list[Artifact]:
    """Every feature group alone and all together, every unit, every size of forest, networks, with
    every option and without."""
    plans = [hand_plan(size).situation for size in ("tiny", "default")] + [
        RAW_BASELINE.situation
    ]
    assert {type(plan.build(0, n_jobs=1)) for plan in plans} == set(FOREST_KINDS)
    alone = [artifact(spec([group])) for group in GROUPS]
    whole = [
        artifact(
            spec([*GROUPS], unit, n_sensors, rate_hz),
            eight,
            extra,
            replace(plan, n_estimators=2),
        )
        for (unit, n_sensors, rate_hz, eight, extra), plan in zip(
            OPTIONS, plans, strict=True
        )
    ]
    return [*alone, *whole, with_networks(artifact(spec()))]


OPTIONS: tuple[tuple[Unit, int, float, bool, bool], ...] = (
    ("N", 6, 150.0, True, False),
    ("uT", 6, 50.0, False, True),
    ("count", 16, 100.0, False, False),
    ("N", 1, 58.9, True, True),
)
"""Unit, sensors, rate, whether of eight classes, whether with a further head."""


@FOREIGN_MODEL.mark
def test_the_allowed_operators_are_those_that_the_exporter_writes_over_all_its_options(
    artifacts,
) -> None:
    written = set()
    for one in artifacts:
        for node in graph_of(one).graph.node:
            written.add(f"{node.domain}.{node.op_type}".lstrip("."))
    assert written == ALLOWED


def test_whatever_the_exporter_writes_is_accepted(artifacts) -> None:
    for one in artifacts:
        card, *_ = read_model(seal(graph_of(one), model_card(one), one.spec), "m.onnx")
        assert card.n_channels == one.spec.n_channels


@pytest.mark.parametrize("path", RELEASED, ids=lambda path: path.name)
def test_every_released_model_is_accepted(path: Path) -> None:
    card, golden, _ = read_model(path.read_bytes(), path)
    assert set(golden) >= {"votes", "situation", *card.heads}


@pytest.mark.parametrize("eight", [True, False])
def test_the_bytes_are_read_as_onnx_reads_them(eight: bool) -> None:
    parsed, model = read_onnx(sealed_bytes(eight)), opened(eight)
    for node, other in zip(parsed.nodes, model.graph.node, strict=True):
        assert (node.domain, node.op_type) == (other.domain, other.op_type)
        assert (node.inputs, node.outputs) == ((*other.input,), (*other.output,))
        attributes = decoded(node).attributes
        for one in other.attribute:
            expected = helper.get_attribute_value(one)
            if one.name == "nodes_modes":
                expected = [word == b"BRANCH_LEQ" for word in expected]
            np.testing.assert_array_equal(attributes[one.name], expected)
    for tensor in model.graph.initializer:
        np.testing.assert_array_equal(
            parsed.constants[tensor.name], numpy_helper.to_array(tensor), strict=True
        )
    assert parsed.metadata == {entry.key: entry.value for entry in model.metadata_props}
