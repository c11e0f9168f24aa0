"""`holdfast selftest MODEL --deep`: the graph of a model file, judged by the `onnx` package.

When a file is opened, its seal, sizes, operators, inputs and outputs are checked, and its golden
sequences are replayed. This looks at what only shows later or costs much: every shape follows from
the operators, every constant is a number, no tensor is huge, and every walk through a tree ends in
a leaf that gives whole votes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from holdfast.core.contract import CheckResult
from holdfast.core.errors import ModelError
from holdfast.edge_runtime.model_file import read_sealed
from holdfast.edge_runtime.onnx_bytes import ALLOWED, MOST_ELEMENTS

NODES = (
    "nodes_treeids",
    "nodes_nodeids",
    "nodes_featureids",
    "nodes_truenodeids",
    "nodes_falsenodeids",
)
"""Columns of a tree ensemble with one entry a node."""
TREE_MODES = {b"BRANCH_LEQ", b"LEAF"}
"""What an export writes: left where feature <= threshold, or a leaf."""
TARGETS = ("target_treeids", "target_nodeids", "target_ids", "target_weights")
"""Columns of a tree ensemble with one entry a vote."""


def deep_checks(path: str | Path) -> Iterator[CheckResult]:
    """Each check as soon as it is done; none of a file whose seal does not hold."""
    try:
        model = onnx.load_from_string(read_sealed(path))
    except ModelError:
        return  # the self-test has reported it in its first line

    for what, check in CHECKS.items():
        try:
            yield CheckResult(what, True, check(model))
        # a check that raises has failed, whatever onnx raises, and the others still run
        except Exception as error:
            reason = " ".join(str(error).split())
            yield CheckResult(what, False, f"{type(error).__name__}: {reason:.200}")


def _check_operators(model: onnx.ModelProto) -> str:
    """Only operators that an export writes."""
    for node in model.graph.node:
        name = f"{node.domain}.{node.op_type}" if node.domain else node.op_type
        if name not in ALLOWED:
            raise ValueError(f"{name} is not an operator that holdfast export writes")

    n_operators = len(model.graph.node)
    return f"{n_operators} operators, all of those that holdfast export writes"


def _check_shapes(model: onnx.ModelProto) -> str:
    """The checker's rules, and shapes that follow from the operators for one sample."""
    onnx.checker.check_model(model, full_check=True)

    # a copy: the file that was opened stays as it is
    alone = onnx.ModelProto()
    alone.CopyFrom(model)
    for value in (*alone.graph.input, *alone.graph.output):
        # without the batch as a word, every size is a number
        value.type.tensor_type.shape.dim[0].dim_value = 1

    inferred = onnx.shape_inference.infer_shapes(
        alone, check_type=True, strict_mode=True, data_prop=True
    )
    largest = 0
    for value in inferred.graph.value_info:
        sizes = [one.dim_value for one in value.type.tensor_type.shape.dim]
        largest = max(largest, math.prod(sizes))

    if largest > MOST_ELEMENTS:
        raise ValueError(f"a tensor would have {largest} numbers")
    return f"the largest tensor of one sample has {largest} numbers"


def _check_constants(model: onnx.ModelProto) -> str:
    """No NaN, and no infinity where numbers enter sums."""
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        # a float64 limit may be infinite; a float32 number enters sums
        is_wrong = np.isnan(values)
        if values.dtype == np.float32:
            is_wrong |= np.isinf(values)
        if is_wrong.any():
            raise ValueError(f"constant {tensor.name[:40]} is not finite")

    return f"{len(model.graph.initializer)} constants, all finite"


def _check_trees(model: onnx.ModelProto) -> str:
    """Every walk through a tree ends, in a leaf that votes."""
    n_trees = 0
    for node in model.graph.node:
        if node.op_type != "TreeEnsembleRegressor":
            continue
        columns = {one.name: helper.get_attribute_value(one) for one in node.attribute}
        n_features = _width(model, node.input[0])
        n_trees += _require_walks(columns, n_features)

    return f"{n_trees} trees: every walk ends in a leaf, every leaf gives equal votes"


def _width(model: onnx.ModelProto, name: str) -> int:
    """How many features a row has that goes into the trees."""
    inferred = onnx.shape_inference.infer_shapes(model)
    for value in (*inferred.graph.value_info, *inferred.graph.output):
        if value.name == name:
            return int(value.type.tensor_type.shape.dim[1].dim_value)
    raise ValueError(f"the shape of {name[:40]} is unknown")


def _require_walks(columns: dict[str, Any], n_features: int) -> int:
    """How many trees there are. Raises ValueError where a walk or a vote goes wrong."""
    tree, number, feature, if_true, if_false = (
        np.array(columns[name]) for name in NODES
    )
    modes = columns["nodes_modes"]
    if len(columns["nodes_values"]) != len(tree) or not set(modes) <= TREE_MODES:
        raise ValueError("its nodes are not all leaves and thresholds")
    if columns["aggregate_function"] != b"SUM":
        raise ValueError("its trees do not add up their votes")

    branch = np.array([mode == b"BRANCH_LEQ" for mode in modes])

    # Children and votes name a node by its tree and its number there, not by its row.
    row_of = {}
    for place, key in enumerate(zip(tree.tolist(), number.tolist(), strict=True)):
        row_of[key] = place

    if len(row_of) != len(tree):
        raise ValueError("two nodes of a tree have one number")
    if (feature < 0).any() or (feature >= n_features).any():
        raise ValueError("a tree uses a feature that does not exist")

    for row in np.flatnonzero(branch):
        for child in (if_true[row], if_false[row]):
            # a child that comes after its node cannot lead back to it
            key = (int(tree[row]), int(child))
            if row_of.get(key, -1) <= row:
                raise ValueError("a branch leads to no later node of its tree")

    _require_votes(columns, row_of, branch)
    return len(set(tree.tolist()))


def _require_votes(
    columns: dict[str, Any], row_of: dict[tuple[int, int], int], branch: Any
) -> None:
    """Raise ValueError unless leaves alone vote, in whole numbers of one sum."""
    trees, numbers, classes, weights = (np.array(columns[name]) for name in TARGETS)
    if (classes < 0).any() or (classes >= columns["n_targets"]).any():
        raise ValueError("a vote is for a class that does not exist")
    # Only sums of whole numbers are exact in float32 whatever the order of the trees.
    if (weights < 0).any() or (weights != np.floor(weights)).any():
        raise ValueError("a vote is not a whole number")

    given = np.zeros(len(branch))
    keys = zip(trees.tolist(), numbers.tolist(), strict=True)
    for key, weight in zip(keys, weights, strict=True):
        if key not in row_of:
            raise ValueError("a vote is for a node that does not exist")
        given[row_of[key]] += weight

    # calibration divides votes by one sum for all rows
    votes_of_leaves = set(given[~branch].tolist())
    if given[branch].any() or len(votes_of_leaves) != 1 or not min(votes_of_leaves):
        raise ValueError("the leaves do not give equally many votes")


CHECKS = {
    "deep: operators": _check_operators,
    "deep: shapes": _check_shapes,
    "deep: constants": _check_constants,
    "deep: trees": _check_trees,
}
