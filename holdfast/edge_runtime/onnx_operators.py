"""What each operator of a model file returns: a rule for every operator that our exporter writes.

https://onnx.ai/onnx/operators/ defines the operators.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from holdfast.edge_runtime.onnx_bytes import BOOL, DOUBLE, DTYPES, FLOAT, INT32, INT64
from holdfast.edge_runtime.onnx_tensors import Call, Tensor, require


def _broadcast(call: Call) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*(one.shape for one in call.tensors))
    except ValueError:
        require(False, call.node, "its inputs' shapes do not fit")
        raise


NUMBERS = (FLOAT, DOUBLE, INT32, INT64)


def _alike(call: Call) -> list[Tensor]:
    """One input; the output is like it."""
    require(len(call.tensors) == 1, call.node, "it must have one input")
    return [Tensor(call.same_element(FLOAT, DOUBLE), call.first.shape)]


def _arithmetic(call: Call) -> list[Tensor]:
    require(len(call.tensors) == 2, call.node, "it must have two inputs")
    return [Tensor(call.same_element(*NUMBERS), _broadcast(call))]


def _division(call: Call) -> list[Tensor]:
    """Dividing a whole number by zero ends the process: only constants above zero may divide it."""
    (made,) = _arithmetic(call)
    divisor = call.tensors[1].values
    fine = made.element in (FLOAT, DOUBLE) or (
        divisor is not None and bool((divisor > 0).all())
    )
    require(fine, call.node, "a whole number may be divided by zero")
    return [made]


def _comparison(call: Call) -> list[Tensor]:
    return [Tensor(BOOL, _arithmetic(call)[0].shape)]


def _both(call: Call) -> list[Tensor]:
    require(len(call.tensors) == 2, call.node, "it must have two inputs")
    return [Tensor(call.same_element(BOOL), _broadcast(call))]


def _where(call: Call) -> list[Tensor]:
    require(
        len(call.tensors) == 3 and call.first.element == BOOL,
        call.node,
        "its condition is not a flag",
    )
    return [Tensor(Call(call.node, call.tensors[1:]).same_element(), _broadcast(call))]


def _clip(call: Call) -> list[Tensor]:
    scalars = (
        len(call.tensors) == 3 and call.tensors[1].shape == call.tensors[2].shape == ()
    )
    require(scalars, call.node, "it must have two limits")
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
    return [
        Tensor(call.same_element(), (*shapes[0][:axis], joined, *shapes[0][axis + 1 :]))
    ]


def _split(call: Call) -> list[Tensor]:
    axis, sizes, shape = call.axis(), call.ints(1).tolist(), call.first.shape
    require(
        min(sizes) > 0 and sum(sizes) == shape[axis],
        call.node,
        "its parts do not add up to its input",
    )
    return [
        Tensor(call.first.element, (*shape[:axis], size, *shape[axis + 1 :]))
        for size in sizes
    ]


def _slice(call: Call) -> list[Tensor]:
    require(len(call.tensors) == 4, call.node, "it must have four inputs")
    starts, stops, axes = (call.ints(k).tolist() for k in (1, 2, 3))
    require(
        len(starts) == len(stops) == len(axes) == len({*axes}),
        call.node,
        "its ends do not fit",
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
        "its indices are not whole numbers",
    )
    axis, shape, indices = call.axis(), call.first.shape, call.tensors[1]
    if indices.values is not None:
        within = (indices.values >= 0) & (indices.values < shape[axis])
        require(within.all(), call.node, "an index is outside of its table")
    return [
        Tensor(call.first.element, (*shape[:axis], *indices.shape, *shape[axis + 1 :]))
    ]


def _reshape(call: Call) -> list[Tensor]:
    target, shape = call.ints(1).tolist(), call.first.shape
    require(
        all(
            size > 0 or (size == 0 and k < len(shape)) for k, size in enumerate(target)
        ),
        call.node,
        "its target shape is invalid",
    )
    made = tuple(size or shape[k] for k, size in enumerate(target))
    require(math.prod(made) == math.prod(shape), call.node, "its shapes do not fit")
    return [Tensor(call.first.element, made)]


def _flatten(call: Call) -> list[Tensor]:
    axis, shape = call.axis(1), call.first.shape
    return [
        Tensor(call.first.element, (math.prod(shape[:axis]), math.prod(shape[axis:])))
    ]


def _transpose(call: Call) -> list[Tensor]:
    order = np.asarray(call.node.attributes.get("perm", ())).tolist()
    require(
        isinstance(order, list) and sorted(order) == [*range(len(call.first.shape))],
        call.node,
        "its order of axes is invalid",
    )
    return [Tensor(call.first.element, tuple(call.first.shape[k] for k in order))]


def _reduce(call: Call) -> list[Tensor]:
    axes, keep = (
        {call.dimension(axis) for axis in call.ints(1).tolist()},
        call.attribute("keepdims", 1),
    )
    kept = [
        1 if k in axes else size
        for k, size in enumerate(call.first.shape)
        if keep or k not in axes
    ]
    require(axes, call.node, "it has no axes")
    return [Tensor(call.first.element, tuple(kept))]


def _arg_max(call: Call) -> list[Tensor]:
    axis, keep = call.axis(), call.attribute("keepdims", 1)
    kept = [
        1 if k == axis else size
        for k, size in enumerate(call.first.shape)
        if keep or k != axis
    ]
    return [Tensor(INT64, tuple(kept))]


def _softmax(call: Call) -> list[Tensor]:
    require(
        call.axis(-1) == len(call.first.shape) - 1,
        call.node,
        "its axis is not the last",
    )
    return _alike(call)


def _matrix_product(call: Call) -> list[Tensor]:
    """As numpy.matmul: a vector is taken as a matrix, leading dimensions are broadcast."""
    require(len(call.tensors) == 2, call.node, "it must have two inputs")
    left, right = (one.shape for one in call.tensors)
    require(left and right, call.node, "an input is a number, not a matrix")
    wide, high = (
        (1, *left) if len(left) == 1 else left,
        (*right, 1) if len(right) == 1 else right,
    )
    require(wide[-1] == high[-2], call.node, "its inputs' shapes do not fit")
    before = _broadcast(Call(call.node, [Tensor(0, wide[:-2]), Tensor(0, high[:-2])]))
    shape = (*before, *wide[-2:-1][: len(left) > 1], *high[-1:][: len(right) > 1])
    return [Tensor(call.same_element(*NUMBERS), shape)]


def _trees(call: Call) -> list[Tensor]:
    """onnx_trees.py looks into the trees."""
    alone = (
        len(call.tensors) == 1
        and len(call.first.shape) == 2
        and call.first.element == FLOAT
    )
    require(alone, call.node, "its input is not a row of features")
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
    "Floor": _alike,
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
    "Round": _alike,
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
