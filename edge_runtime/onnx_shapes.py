"""What every tensor of a graph is when one sample is stepped: element type, shape, and what the
step costs.

A rule for each operator that our exporter writes, and for no other. A graph that passes cannot ask
onnxruntime for more memory or time than is checked here, and none of its operators can fail on some
later sample: shapes hold for every sample, a table's index stays within the table (onnx_ranges.py),
and no integer is divided by zero. https://onnx.ai/onnx/operators/ says what each operator does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_runtime.onnx_bytes import (
    BOOL,
    DOUBLE,
    DTYPES,
    FLOAT,
    INT32,
    INT64,
    MOST_ELEMENTS,
    Node,
    OnnxModel,
)
from edge_runtime.protobuf import IntArray

MOST_WORK = 10**10
"""Numbers made or multiplied when the golden sequences are replayed: seconds. The default model:
3.4e7."""
_ELEMENTS = {np.dtype(dtype): element for element, dtype in DTYPES.items()}


@dataclass(frozen=True)
class Tensor:
    """Element type (TensorProto.DataType) and shape; values only of constants."""

    element: int
    shape: tuple[int, ...]
    values: npt.NDArray[Any] | None = None


class Call:
    """One operator with its inputs: what a rule may ask for."""

    def __init__(self, node: Node, tensors: list[Tensor]) -> None:
        self.node, self.tensors = node, tensors

    @property
    def first(self) -> Tensor:
        """The first input."""
        return self.tensors[0]

    def attribute(self, name: str, default: int) -> int:
        """A whole number."""
        value = self.node.attributes.get(name, default)
        require(isinstance(value, int), self.node, f"{name} is no whole number")
        return int(value)

    def axis(self, default: int = 0) -> int:
        """The attribute `axis`, within the first input's dimensions."""
        return self.dimension(self.attribute("axis", default))

    def dimension(self, axis: int) -> int:
        """An axis, within the first input's dimensions."""
        require(0 <= axis < len(self.first.shape), self.node, "its axis is outside of its input")
        return axis

    def ints(self, k: int) -> IntArray:
        """The k-th input, which is a constant row of int64."""
        require(k < len(self.tensors), self.node, "an input is missing")
        values = self.tensors[k].values
        require(values is not None, self.node, "what should be constant is computed")
        assert values is not None
        require(
            values.dtype == np.int64 and values.ndim == 1,
            self.node,
            "what should be indices are not",
        )
        return values

    def same_element(self, *elements: int) -> int:
        """The inputs' common element type, one of these (none: any)."""
        element = self.first.element
        require(
            all(one.element == element for one in self.tensors),
            self.node,
            "its inputs have different types",
        )
        require(
            not elements or element in elements,
            self.node,
            "its inputs have a type that it does not take",
        )
        return element


def require(holds: object, node: Node, what: str) -> None:
    """Raise ValueError that names the operator."""
    if not holds:
        raise ValueError(f"operator {node.op_type} for {node.outputs[0]}: {what}")


def shapes_of(model: OnnxModel, steps: int = 1) -> dict[str, Tensor]:
    """Every tensor by its name, for a batch of one; ValueError where a shape cannot be, or so many
    steps cost too much.
    """
    known = {
        name: Tensor(_ELEMENTS[values.dtype], values.shape, values)
        for name, values in model.constants.items()
    }
    for name, declared in model.inputs.items():
        known[name] = Tensor(
            declared.element, tuple(1 if isinstance(d, str) else d for d in declared.shape)
        )
        _require_size(known[name], name)
    work = 0
    for node in model.nodes:
        made, cost = _step(node, known)
        known.update(made)
        work += cost
        if work * steps > MOST_WORK:
            raise ValueError(f"{steps} steps of it cost more than {MOST_WORK} multiplications")
    return known


def _step(node: Node, known: dict[str, Tensor]) -> tuple[dict[str, Tensor], int]:
    """The outputs of one operator, and how many numbers are made or multiplied for them."""
    require(all(name in known for name in node.inputs), node, "an input comes from nowhere")
    require(
        node.inputs and not any(name in known for name in node.outputs),
        node,
        "an output has a name in use",
    )
    call = Call(node, [known[name] for name in node.inputs])
    outputs = RULES[node.op_type](call)
    require(
        len(outputs) == len(node.outputs) == len({*node.outputs}),
        node,
        "it has not the outputs it should",
    )
    made = dict(zip(node.outputs, outputs, strict=True))
    for name, tensor in made.items():
        _require_size(tensor, name)
    inner = call.first.shape[-1] if node.op_type == "MatMul" and call.first.shape else 1
    return made, sum(math.prod(tensor.shape) * inner for tensor in outputs) + math.prod(
        call.first.shape
    )


def _require_size(tensor: Tensor, name: str) -> None:
    if not all(size >= 1 for size in tensor.shape) or math.prod(tensor.shape) > MOST_ELEMENTS:
        raise ValueError(f"{name} would be of shape {list(tensor.shape)!s:.60}")


def _broadcast(call: Call) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*(one.shape for one in call.tensors))
    except ValueError:
        require(False, call.node, "its inputs' shapes do not fit")
        raise


NUMBERS = (FLOAT, DOUBLE, INT32, INT64)


def _alike(call: Call) -> list[Tensor]:
    """One input; the output is like it."""
    require(len(call.tensors) == 1, call.node, "it has not one input")
    return [Tensor(call.same_element(FLOAT, DOUBLE), call.first.shape)]


def _arithmetic(call: Call) -> list[Tensor]:
    require(len(call.tensors) == 2, call.node, "it has not two inputs")
    return [Tensor(call.same_element(*NUMBERS), _broadcast(call))]


def _division(call: Call) -> list[Tensor]:
    """A whole number divided by zero ends the process: only by constants above zero."""
    (made,) = _arithmetic(call)
    divisor = call.tensors[1].values
    fine = made.element in (FLOAT, DOUBLE) or (divisor is not None and bool((divisor > 0).all()))
    require(fine, call.node, "a whole number may be divided by zero")
    return [made]


def _comparison(call: Call) -> list[Tensor]:
    return [Tensor(BOOL, _arithmetic(call)[0].shape)]


def _both(call: Call) -> list[Tensor]:
    require(len(call.tensors) == 2, call.node, "it has not two inputs")
    return [Tensor(call.same_element(BOOL), _broadcast(call))]


def _where(call: Call) -> list[Tensor]:
    require(
        len(call.tensors) == 3 and call.first.element == BOOL, call.node, "it chooses by no flag"
    )
    return [Tensor(Call(call.node, call.tensors[1:]).same_element(), _broadcast(call))]


def _clip(call: Call) -> list[Tensor]:
    scalars = len(call.tensors) == 3 and call.tensors[1].shape == call.tensors[2].shape == ()
    require(scalars, call.node, "it has not two limits")
    return [Tensor(call.same_element(*NUMBERS), call.first.shape)]


def _cast(call: Call) -> list[Tensor]:
    to = call.attribute("to", 0)
    require(
        to in DTYPES and len(call.tensors) == 1,
        call.node,
        "it makes a type that holdfast export never writes",
    )
    return [Tensor(to, call.first.shape)]


def _concat(call: Call) -> list[Tensor]:
    axis, shapes = call.axis(), [one.shape for one in call.tensors]
    others = {(*shape[:axis], *shape[axis + 1 :]) for shape in shapes}
    fit = len(others) == 1 and len({len(shape) for shape in shapes}) == 1
    require(fit, call.node, "its inputs' shapes do not fit")
    joined = sum(shape[axis] for shape in shapes)
    return [Tensor(call.same_element(), (*shapes[0][:axis], joined, *shapes[0][axis + 1 :]))]


def _split(call: Call) -> list[Tensor]:
    axis, sizes, shape = call.axis(), call.ints(1).tolist(), call.first.shape
    require(min(sizes) > 0 and sum(sizes) == shape[axis], call.node, "its parts are not the whole")
    return [Tensor(call.first.element, (*shape[:axis], size, *shape[axis + 1 :])) for size in sizes]


def _slice(call: Call) -> list[Tensor]:
    require(len(call.tensors) == 4, call.node, "it has not four inputs")
    starts, stops, axes = (call.ints(k).tolist() for k in (1, 2, 3))
    require(
        len(starts) == len(stops) == len(axes) == len({*axes}), call.node, "its ends do not fit"
    )
    shape = list(call.first.shape)
    for start, stop, axis in zip(starts, stops, axes, strict=True):
        require(
            0 <= start < stop <= shape[call.dimension(axis)],
            call.node,
            "it reaches outside of its input",
        )
        shape[axis] = stop - start
    return [Tensor(call.first.element, tuple(shape))]


def _gather(call: Call) -> list[Tensor]:
    """Computed indices are bounded by onnx_ranges.py."""
    require(
        len(call.tensors) == 2 and call.tensors[1].element == INT64,
        call.node,
        "its indices are none",
    )
    axis, shape, indices = call.axis(), call.first.shape, call.tensors[1]
    if indices.values is not None:
        within = (indices.values >= 0) & (indices.values < shape[axis])
        require(within.all(), call.node, "an index is outside of its table")
    return [Tensor(call.first.element, (*shape[:axis], *indices.shape, *shape[axis + 1 :]))]


def _reshape(call: Call) -> list[Tensor]:
    target, shape = call.ints(1).tolist(), call.first.shape
    require(
        all(size > 0 or (size == 0 and k < len(shape)) for k, size in enumerate(target)),
        call.node,
        "to no shape",
    )
    made = tuple(size or shape[k] for k, size in enumerate(target))
    require(math.prod(made) == math.prod(shape), call.node, "its shapes do not fit")
    return [Tensor(call.first.element, made)]


def _flatten(call: Call) -> list[Tensor]:
    axis, shape = call.axis(1), call.first.shape
    return [Tensor(call.first.element, (math.prod(shape[:axis]), math.prod(shape[axis:])))]


def _transpose(call: Call) -> list[Tensor]:
    order = np.asarray(call.node.attributes.get("perm", ())).tolist()
    require(
        isinstance(order, list) and sorted(order) == [*range(len(call.first.shape))],
        call.node,
        "to no order",
    )
    return [Tensor(call.first.element, tuple(call.first.shape[k] for k in order))]


def _reduce(call: Call) -> list[Tensor]:
    axes, keep = (
        {call.dimension(axis) for axis in call.ints(1).tolist()},
        call.attribute("keepdims", 1),
    )
    kept = [
        1 if k in axes else size for k, size in enumerate(call.first.shape) if keep or k not in axes
    ]
    require(axes, call.node, "over nothing")
    return [Tensor(call.first.element, tuple(kept))]


def _arg_max(call: Call) -> list[Tensor]:
    axis, keep = call.axis(), call.attribute("keepdims", 1)
    kept = [
        1 if k == axis else size for k, size in enumerate(call.first.shape) if keep or k != axis
    ]
    return [Tensor(INT64, tuple(kept))]


def _softmax(call: Call) -> list[Tensor]:
    require(call.axis(-1) == len(call.first.shape) - 1, call.node, "its axis is not the last")
    return _alike(call)


def _matrix_product(call: Call) -> list[Tensor]:
    """As numpy.matmul: a row or a column that stands for a matrix goes again, the dimensions before
    are broadcast."""
    require(len(call.tensors) == 2, call.node, "it has not two inputs")
    left, right = (one.shape for one in call.tensors)
    require(left and right, call.node, "it has a number where a matrix belongs")
    wide, high = (1, *left) if len(left) == 1 else left, (*right, 1) if len(right) == 1 else right
    require(wide[-1] == high[-2], call.node, "its inputs' shapes do not fit")
    before = _broadcast(Call(call.node, [Tensor(0, wide[:-2]), Tensor(0, high[:-2])]))
    shape = (*before, *wide[-2:-1][: len(left) > 1], *high[-1:][: len(right) > 1])
    return [Tensor(call.same_element(*NUMBERS), shape)]


def _trees(call: Call) -> list[Tensor]:
    """onnx_trees.py looks into the trees."""
    alone = len(call.tensors) == 1 and len(call.first.shape) == 2 and call.first.element == FLOAT
    require(alone, call.node, "its input is no row of features")
    return [Tensor(FLOAT, (call.first.shape[0], call.attribute("n_targets", 0)))]


Rule = Callable[[Call], list[Tensor]]
RULES: dict[str, Rule] = {
    "Abs": _alike,
    "Add": _arithmetic,
    "And": _both,
    "ArgMax": _arg_max,
    "Cast": _cast,
    "Clip": _clip,
    "Concat": _concat,
    "Div": _division,
    "Flatten": _flatten,
    "Gather": _gather,
    "Greater": _comparison,
    "GreaterOrEqual": _comparison,
    "Less": _comparison,
    "MatMul": _matrix_product,
    "Max": _arithmetic,
    "Min": _arithmetic,
    "Mul": _arithmetic,
    "ReduceL2": _reduce,
    "ReduceMax": _reduce,
    "ReduceMin": _reduce,
    "ReduceSum": _reduce,
    "Reshape": _reshape,
    "Slice": _slice,
    "Softmax": _softmax,
    "Split": _split,
    "Sqrt": _alike,
    "Sub": _arithmetic,
    "Transpose": _transpose,
    "TreeEnsembleRegressor": _trees,
    "Where": _where,
}
"""Operator -> its outputs."""
