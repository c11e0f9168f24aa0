"""What a model file may hold: our exporter's operators, and the inputs and outputs of its card.

Checked on the bytes, before onnxruntime sees them. A file that passes cannot fail at a later
sample: votes are whole and have the sum that the card says, a situation is 0 to 3, and every output
has the type and shape that the monitor reads.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from holdfast.core.contract import SITUATIONS
from holdfast.edge_runtime.golden import golden_length
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.onnx_bytes import (
    BOOL,
    DOUBLE,
    FLOAT,
    INT32,
    INT64,
    Node,
    OnnxModel,
    TensorSpec,
)
from holdfast.edge_runtime.onnx_correction import require_correction
from holdfast.edge_runtime.onnx_network import require_network
from holdfast.edge_runtime.onnx_ranges import require_indices
from holdfast.edge_runtime.onnx_shapes import shapes_of
from holdfast.edge_runtime.onnx_tensors import Tensor
from holdfast.edge_runtime.onnx_trees import EXACT_FLOAT32, require_trees

IR_VERSION = 10
OPSETS = {"": 20, "ai.onnx.ml": 3}
_TREES = (
    "nodes_treeids",
    "nodes_nodeids",
    "nodes_modes",
    "nodes_featureids",
    "nodes_values",
    "nodes_truenodeids",
    "nodes_falsenodeids",
    "target_ids",
    "target_treeids",
    "target_nodeids",
    "target_weights",
    "n_targets",
    "aggregate_function",
    "post_transform",
)
ALLOWED: dict[tuple[str, str], frozenset[str]] = {
    **{
        ("", op): frozenset()
        for op in (
            "Abs",
            "Add",
            "And",
            "Clip",
            "Div",
            "Floor",
            "Greater",
            "GreaterOrEqual",
            "Less",
            "MatMul",
            "Max",
            "Min",
            "Mul",
            "Reshape",
            "Round",
            "Slice",
            "Sqrt",
            "Sub",
            "Where",
        )
    },
    **{
        ("", op): frozenset({"axis"})
        for op in ("Concat", "Flatten", "Gather", "Softmax", "Split")
    },
    **{
        ("", op): frozenset({"keepdims"})
        for op in ("ReduceL2", "ReduceMax", "ReduceMin", "ReduceSum")
    },
    ("", "ArgMax"): frozenset({"axis", "keepdims", "select_last_index"}),
    ("", "Cast"): frozenset({"to"}),
    ("", "Transpose"): frozenset({"perm"}),
    ("ai.onnx.ml", "TreeEnsembleRegressor"): frozenset(_TREES),
}
"""(domain, operator) -> the attributes that it may have.

All that export/ writes, with any options.
"""

STEP = ("settled", "unknown", "usable_sensors", "detectors", "features", "state_out")
ANSWERS = (
    "votes",
    "situation",
    "p_situation",
    "detectors",
    "settled",
    "unknown",
    "usable_sensors",
)
WEIGHS = ("p_class", "weight")
"""Outputs that the monitor reads: always (ANSWERS), and where the model knows light and heavy."""
INPUTS = ("sample", "valid", "reset", "state")
_HEAD = re.compile(r"p_[a-z0-9_]{1,60}")
MOST_TREES, MOST_BITS = 100_000, 16
MOST_GOLDEN = 1_000_000
"""Numbers of the golden input, which are made one by one; the default model has 4,536."""


def require_ours(model: OnnxModel, card: ModelCard) -> None:
    """Raise ValueError, in plain words, where the file is not what our exporter writes."""
    require_allowed(model)
    _require_heads(card)
    _require_inputs(model, card)
    steps = golden_length(card.settle_samples)
    if steps * card.n_channels > MOST_GOLDEN:
        raise ValueError(
            f"its golden sequences have {steps} samples of {card.n_channels} channels"
        )
    tensors = shapes_of(model, steps)
    _require_outputs(model, card, tensors)
    require_indices(model, tensors)
    _require_votes(model, card, tensors)


def require_allowed(model: OnnxModel) -> None:
    """Raise ValueError for an operator, attribute or operator set that our exporter omits."""
    if model.ir_version != IR_VERSION or model.opsets != OPSETS:
        raise ValueError(
            f"it has IR version {model.ir_version} and operator sets {model.opsets}"
        )
    for node in model.nodes:
        kind = (node.domain, node.op_type)
        if kind not in ALLOWED:
            raise ValueError(
                f"it has the operator {kind[0]}:{kind[1]}, which holdfast export never writes"
            )
        more = sorted(set(node.attributes) - ALLOWED[kind])
        if more or not node.outputs:
            raise ValueError(
                f"operator {node.op_type} has attributes that holdfast export never writes: "
                f"{more!s:.80}"
            )


def _require_heads(card: ModelCard) -> None:
    """A further head is a probability of its own; its name must be new to the graph."""
    taken = {*INPUTS, *STEP, *ANSWERS, *WEIGHS}
    for name in card.heads:
        if name in taken or not _HEAD.fullmatch(name):
            raise ValueError(
                f"its card names a head {name!r}, which cannot be the name of a further probability"
            )


def _require_inputs(model: OnnxModel, card: ModelCard) -> None:
    rows = model.inputs.get("state", TensorSpec(0, ("B", 0, 0))).shape[1:2]
    wanted = {
        "sample": TensorSpec(DOUBLE, ("B", 1, card.n_channels)),
        "valid": TensorSpec(BOOL, ("B", 1, card.n_channels // 3)),
        "reset": TensorSpec(BOOL, ("B", 1, 1)),
        "state": TensorSpec(DOUBLE, ("B", *rows, card.n_channels)),
    }
    whole = all(isinstance(size, int) for size in rows)
    if model.inputs != wanted or not whole:
        raise ValueError("its inputs are not those that its card names")


def _require_outputs(
    model: OnnxModel, card: ModelCard, tensors: dict[str, Tensor]
) -> None:
    """Names, types and shapes: card, file and operators must agree."""
    wanted = _outputs_of(model, card)
    if set(model.outputs) != set(wanted):
        raise ValueError(
            f"its outputs are {_words(model.outputs)}, its card names {_words(wanted)}"
        )
    for name, expected in wanted.items():
        made = tensors.get(name, Tensor(0, ()))
        batched = TensorSpec(
            made.element, ("B", *made.shape[1:]) if made.shape[:1] == (1,) else ()
        )
        if not model.outputs[name] == batched == expected:
            raise ValueError(
                f"its output {name} has not the type and shape that its card says"
            )


def _outputs_of(model: OnnxModel, card: ModelCard) -> dict[str, TensorSpec]:
    """The outputs of a graph with this card. The number of features is free."""
    features = model.outputs.get("features", TensorSpec(FLOAT, ("B", 1))).shape
    wanted = {
        "settled": TensorSpec(BOOL, ("B",)),
        "unknown": TensorSpec(BOOL, ("B",)),
        "usable_sensors": TensorSpec(INT32, ("B",)),
        "detectors": TensorSpec(BOOL, ("B", len(card.detectors))),
        "features": TensorSpec(FLOAT, features),
        "votes": TensorSpec(FLOAT, ("B", len(card.classes))),
        "p_situation": TensorSpec(FLOAT, ("B", len(SITUATIONS))),
        "situation": TensorSpec(INT64, ("B",)),
        "state_out": model.inputs["state"],
    }
    if card.has_weight:
        wanted |= {
            "p_class": TensorSpec(FLOAT, ("B", len(card.classes))),
            "weight": TensorSpec(BOOL, ("B",)),
        }
    for name in card.heads:
        wanted |= {
            name: TensorSpec(FLOAT, ("B",)),
            f"votes_{name}": TensorSpec(FLOAT, ("B", 2)),
        }
    return wanted


def _words(names: Any) -> str:
    return ", ".join(sorted(name[:40] for name in names))[:400]


def _require_votes(
    model: OnnxModel, card: ModelCard, tensors: dict[str, Tensor]
) -> None:
    """Votes come from trees or a network, and a situation is the largest of four."""
    made_by = {name: node for node in model.nodes for name in node.outputs}
    situation = made_by["situation"]
    if situation.op_type != "ArgMax" or tensors[situation.inputs[0]].shape != (
        1,
        len(SITUATIONS),
    ):
        raise ValueError("its situation is not the one with the most votes")
    for head in ("situation", *card.heads):
        name = "votes" if head == "situation" else f"votes_{head}"
        about = card.raw["heads"][head]
        if "correction" in about:
            name = require_correction(name, len(about["classes"]), made_by, tensors)
        _require_learner(name, about, made_by, tensors)


def _require_learner(
    votes: str, head: Any, made_by: dict[str, Node], tensors: dict[str, Tensor]
) -> None:
    """Trees, a network, or the sum of both, as the card says."""
    kind = head.get("learner", "forest")
    if kind == "forest":
        _require_forest(made_by[votes], head, tensors)
        return
    in_all = head.get("votes")
    if (
        kind not in ("network", "committee")
        or type(in_all) is not int
        or in_all >= EXACT_FLOAT32
    ):
        raise ValueError("its card does not say what votes, and with how many votes")
    if kind == "committee":
        if made_by[votes].op_type != "Add" or made_by[votes].inputs[0] not in made_by:
            raise ValueError("its votes are not the sum of trees and network")
        trees, votes = made_by[votes].inputs
        _require_forest(made_by[trees], head, tensors)
        in_all -= head["trees"] << head["vote_bits"]
    require_network(votes, in_all, made_by, tensors)


def votes_in_all(head: Mapping[str, Any]) -> int:
    """The sum of a sample's votes, from a head's card."""
    if "votes" in head:
        return int(head["votes"])
    return int(head["trees"]) << int(head["vote_bits"])


def _require_forest(node: Node, head: Any, tensors: dict[str, Tensor]) -> None:
    trees, bits, classes = head.get("trees"), head.get("vote_bits"), head.get("classes")
    if (
        type(trees) is not int
        or type(bits) is not int
        or not (0 < trees <= MOST_TREES and 0 <= bits <= MOST_BITS)
    ):
        raise ValueError(
            "its card does not say how many trees vote, and with how many votes"
        )
    if node.op_type != "TreeEnsembleRegressor" or not isinstance(classes, list):
        raise ValueError("its votes do not come from trees")
    require_trees(node, tensors[node.inputs[0]].shape[1], len(classes), trees, bits)
