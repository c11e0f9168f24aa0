"""The correction of an adapted model file: its votes stay whole, and their sum stays, for any row.

The operators must be those that export/correction.py writes: a network's share of each sample's
risky votes goes to safe slip. A share is within 0 and 1, and its product is rounded down, so no
class gets less than no votes.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import RISKY_SLIP, SAFE_SLIP, SITUATIONS
from holdfast.edge_runtime.onnx_bytes import Node
from holdfast.edge_runtime.onnx_network import Walk, logits_of_shares, require_layers
from holdfast.edge_runtime.onnx_tensors import Tensor

Matrix = npt.NDArray[np.float32]


def risky_of_shares(n_classes: int) -> Matrix:
    """[2, K]: the first of two shares for the risky classes, 0 for all others."""
    shares = np.zeros((2, n_classes), dtype=np.float32)
    shares[0, RISKY_SLIP * n_classes // len(SITUATIONS) :] = 1.0
    return shares


def risky_to_safe(n_classes: int) -> Matrix:
    """[K, K] that takes votes from risky classes and gives them to safe slip of the same weight."""
    per, moved = (
        n_classes // len(SITUATIONS),
        np.zeros((n_classes, n_classes), dtype=np.float32),
    )
    for k in range(per):
        risky, safe = RISKY_SLIP * per + k, SAFE_SLIP * per + k
        moved[risky, risky], moved[risky, safe] = -1.0, 1.0
    return moved


def require_correction(
    votes: str,
    n_classes: int,
    made_by: Mapping[str, Node],
    tensors: Mapping[str, Tensor],
) -> str:
    """The tensor of votes before the correction. votes: after it.

    Raises ValueError where corrected votes may be wrong.
    """
    walk = Walk(made_by, tensors)
    before, moved = walk.inputs(votes, "Add")
    whole, matrix = walk.with_constant(moved, "MatMul")
    given, part = walk.inputs(walk.up(whole, "Floor"), "Mul")
    shares, of_risky = walk.with_constant(part, "MatMul")
    if (
        given != before
        or not np.array_equal(matrix, risky_to_safe(n_classes))
        or not np.array_equal(of_risky, risky_of_shares(n_classes))
    ):
        raise ValueError("its correction moves other votes than those for risky slip")
    require_layers(walk, logits_of_shares(walk, shares))
    return before
