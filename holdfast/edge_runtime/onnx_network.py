"""The network of a model file: its votes are whole and add up, for any later row of features.

The operators are followed backwards from the votes and must be those that export/network.py writes,
in that order. Then every number is finite: a feature that is not finite counts as 0, x / (|x| + k)
is within 1, and what follows has finite constants. The votes of all classes but the last are whole
shares of a sum, and the last class gets the rest.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.onnx_bytes import FLOAT, INT64, Node
from holdfast.edge_runtime.onnx_tensors import Tensor
from holdfast.edge_runtime.onnx_trees import EXACT_FLOAT32

LARGEST_FEATURE = LARGEST_SCALE = 2.0**100
MOST_LAYERS = 8
INPUT_MOST = 511
"""Largest magnitude of a quantised input."""
Values = npt.NDArray[np.float64]


def require_network(
    votes: str,
    votes_in_all: int,
    made_by: Mapping[str, Node],
    tensors: Mapping[str, Tensor],
) -> None:
    """Raise ValueError where a network's votes may be wrong. votes: the tensor's name."""
    if not 0 < votes_in_all < EXACT_FLOAT32:
        raise ValueError("its votes are too many for float32 to add exactly")
    walk = Walk(made_by, tensors)
    require_layers(walk, _votes_follow(walk, votes, votes_in_all))


def require_layers(walk: Walk, logits: str) -> None:
    """Raise ValueError where logits do not follow from bounded inputs by exact sums."""
    values, layers = walk.up(logits, "Round"), 0
    while (before := _before_layer(walk, values)) is not None:
        values, layers = before, layers + 1
        if layers > MOST_LAYERS:
            raise ValueError(f"its network has more than {MOST_LAYERS} layers")
    if not layers:
        raise ValueError("its network has no layer")


class Walk:
    """Operators from what they make to what they read."""

    def __init__(
        self, made_by: Mapping[str, Node], tensors: Mapping[str, Tensor]
    ) -> None:
        self._made_by, self._tensors = made_by, tensors

    def inputs(self, name: str, op: str) -> tuple[str, ...]:
        """The inputs of the operator that makes a tensor. Raises ValueError for another one."""
        node = self._made_by.get(name)
        if node is None or node.op_type != op:
            raise ValueError(f"{name[:40]} of its network is not made by {op}")
        return node.inputs

    def op(self, name: str) -> str:
        """The operator that makes a tensor, or ""."""
        node = self._made_by.get(name)
        return "" if node is None else node.op_type

    def up(self, name: str, op: str) -> str:
        """The one input of the operator that makes a tensor."""
        return self.inputs(name, op)[0]

    def over_classes(self, name: str, op: str) -> str:
        """The input of a reduction over the second axis."""
        values, axes = self.inputs(name, op)
        given = self._tensors[axes].values
        if given is None or given.tolist() != [1]:
            raise ValueError(f"{op} of its network is not over the classes")
        return values

    def with_constant(self, name: str, op: str) -> tuple[str, Values]:
        """The first input, and the constant that is the second."""
        first, second = self.inputs(name, op)
        return first, self.constant(second)

    def constant(self, name: str) -> Values:
        """A constant's finite float32 numbers. Raises ValueError."""
        tensor = self._tensors[name]
        if (
            tensor.values is None
            or tensor.element != FLOAT
            or not np.isfinite(tensor.values).all()
            or (np.abs(tensor.values) > LARGEST_SCALE).any()
        ):
            raise ValueError(f"{name[:40]} of its network is not a finite constant")
        return tensor.values.astype(np.float64)

    def element(self, name: str) -> int:
        """The element type of a tensor."""
        return self._tensors[name].element


def _votes_follow(walk: Walk, votes: str, votes_in_all: int) -> str:
    """The logits that whole votes are made of."""
    others, last = walk.with_constant(votes, "Add")
    whole, rest = walk.with_constant(others, "MatMul")
    n = len(last)
    kept = np.eye(n)
    kept[:, -1], kept[-1, -1] = -1.0, 0.0
    if not np.array_equal(rest, kept) or not np.array_equal(
        last, np.eye(n)[-1] * votes_in_all
    ):
        raise ValueError(
            "the last class of its network does not get the rest of the votes"
        )
    shares, of = walk.with_constant(walk.up(whole, "Floor"), "Mul")
    if of.shape != () or not 0 < float(of) <= votes_in_all - 2 * n:
        raise ValueError("its network shares out more votes than it has")
    return logits_of_shares(walk, shares)


def logits_of_shares(walk: Walk, shares: str) -> str:
    """The logits that shares of 1 are made of. Raises ValueError where they may not add up."""
    raised, total = walk.inputs(shares, "Div")
    if walk.over_classes(total, "ReduceSum") != raised:
        raise ValueError("its network's shares do not add up to 1")
    return _raised_from(walk, raised)


def _raised_from(walk: Walk, raised: str) -> str:
    """The logits behind a table of whole numbers; the largest logit has the first entry."""
    table, place = walk.inputs(raised, "Gather")
    entries = walk.constant(table)
    nearest, end = walk.with_constant(walk.up(place, "Cast"), "Min")
    first, logits = walk.inputs(nearest, "Sub")
    if walk.over_classes(first, "ReduceMax") != logits or walk.element(place) != INT64:
        raise ValueError(
            "its network does not look up how far a logit is behind the first"
        )
    whole = (entries == np.floor(entries)) & (entries >= 0.0) & (entries <= 2.0**16)
    if entries.ndim != 1 or not whole.all() or entries[0] < 1.0:
        raise ValueError("its network's table is not of whole numbers")
    if end.shape != () or not 0.0 <= float(end) < len(entries):
        raise ValueError("its network may look outside of its table")
    return logits


def _before_layer(walk: Walk, scaled: str) -> str | None:
    """What enters a layer, as its scaled sum; None at the inputs."""
    if walk.op(scaled) == "Add":
        _require_inputs(walk, scaled)
        return None
    total, _ = walk.with_constant(scaled, "Mul")
    product, bias = walk.with_constant(total, "Add")
    values, weights = walk.with_constant(product, "MatMul")
    if walk.op(values) == "Clip":
        scaled_before, least, most = walk.inputs(values, "Clip")
        largest = float(walk.constant(most))
        if float(walk.constant(least)) != 0.0 or largest <= 0.0:
            raise ValueError("its network's hidden values are not within bounds")
        values = scaled_before
    else:
        largest = INPUT_MOST
    whole = (weights == np.floor(weights)).all() and (bias == np.floor(bias)).all()
    sums = largest * np.abs(weights).sum(axis=0) + np.abs(bias)
    if weights.ndim != 2 or not whole or not (sums < EXACT_FLOAT32).all():
        raise ValueError("its network's sums are not exact in float32")
    return walk.up(values, "Round")


def _require_inputs(walk: Walk, moved: str) -> None:
    """Features are squashed into +-1, then scaled and moved to whole numbers."""
    scaled, offset = walk.with_constant(moved, "Add")
    squashed, gain = walk.with_constant(scaled, "Mul")
    finite, below = walk.inputs(squashed, "Div")
    size, knee = walk.with_constant(below, "Add")
    known, features, zero = walk.inputs(finite, "Where")
    magnitude, limit = walk.with_constant(known, "Less")
    if not (
        walk.up(size, "Abs") == finite
        and walk.up(magnitude, "Abs") == features
        and not walk.constant(zero).any()
        and float(limit) <= LARGEST_FEATURE
        and (knee > 0.0).all()
        and (np.abs(gain) + np.abs(offset) <= INPUT_MOST).all()
    ):
        raise ValueError("its network's inputs are not within bounds")
