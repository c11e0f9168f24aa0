"""Shape and type of every tensor of a graph when one sample is stepped, and the cost of the step.

onnx_operators.py has a rule for each operator that our exporter writes, and for no other. A graph
that passes cannot make onnxruntime use more memory or time than is checked here, and none of its
operators can fail at a later sample: shapes hold for every sample, a table's index stays within the
table (onnx_ranges.py), and no integer is divided by zero.
"""

from __future__ import annotations

import math

import numpy as np

from holdfast.edge_runtime.onnx_bytes import DTYPES, MOST_ELEMENTS, Node, OnnxModel
from holdfast.edge_runtime.onnx_operators import RULES
from holdfast.edge_runtime.onnx_tensors import Call, Tensor, require

MOST_WORK = 10**10
"""Numbers made or multiplied to replay the golden sequences: some seconds. Default model: 3.4e7."""
_ELEMENTS = {np.dtype(dtype): element for element, dtype in DTYPES.items()}


def shapes_of(model: OnnxModel, steps: int = 1) -> dict[str, Tensor]:
    """Every tensor by its name, for a batch of one.

    Raises ValueError where a shape is impossible or where this many steps cost too much.
    """
    known = {
        name: Tensor(_ELEMENTS[values.dtype], values.shape, values)
        for name, values in model.constants.items()
    }
    for name, declared in model.inputs.items():
        known[name] = Tensor(
            declared.element,
            tuple(1 if isinstance(d, str) else d for d in declared.shape),
        )
        _require_size(known[name], name)
    work = 0
    for node in model.nodes:
        made, cost = _step(node, known)
        known.update(made)
        work += cost
        if work * steps > MOST_WORK:
            raise ValueError(
                f"{steps} steps of it cost more than {MOST_WORK} multiplications"
            )
    return known


def _step(node: Node, known: dict[str, Tensor]) -> tuple[dict[str, Tensor], int]:
    """The outputs of one operator, and how many numbers are made or multiplied for them."""
    require(
        all(name in known for name in node.inputs), node, "an input comes from nowhere"
    )
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
        "it has the wrong number of outputs",
    )
    made = dict(zip(node.outputs, outputs, strict=True))
    for name, tensor in made.items():
        _require_size(tensor, name)
    inner = call.first.shape[-1] if node.op_type == "MatMul" and call.first.shape else 1
    return made, sum(math.prod(tensor.shape) * inner for tensor in outputs) + math.prod(
        call.first.shape
    )


def _require_size(tensor: Tensor, name: str) -> None:
    if (
        not all(size >= 1 for size in tensor.shape)
        or math.prod(tensor.shape) > MOST_ELEMENTS
    ):
        raise ValueError(f"{name} would be of shape {list(tensor.shape)!s:.60}")
