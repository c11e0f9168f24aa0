"""A fitted model as a session, one row a call: forests by skl2onnx, boosting by its own nodes.

skl2onnx 1.20 hands boosted trees' NumPy integers on to onnx 1.23, which refuses them.
"""

from __future__ import annotations

from typing import Any

import onnxruntime as ort
from onnx import TensorProto, helper
from skl2onnx import to_onnx
from sklearn.ensemble import HistGradientBoostingClassifier

from holdfast.edge_runtime.graph import open_session
from holdfast.training.featurise import FloatRows


def session_of(model: Any, rows: FloatRows) -> ort.InferenceSession:
    """A session with one input, rows [N, F]."""
    if isinstance(model, HistGradientBoostingClassifier):
        return open_session(boosted(model, rows.shape[1]))
    return open_session(
        to_onnx(model, rows[:1], options={"zipmap": False}).SerializeToString()
    )


def boosted(model: HistGradientBoostingClassifier, n_features: int) -> bytes:
    """Boosted trees as one TreeEnsembleRegressor: raw scores [N, K] of features [N, F], without
    their constant."""
    node = helper.make_node(
        "TreeEnsembleRegressor",
        ["features"],
        ["scores"],
        domain="ai.onnx.ml",
        n_targets=len(model.classes_),
        post_transform="NONE",
        **_nodes(model),
    )
    wide = helper.make_tensor_value_info(
        "features", TensorProto.FLOAT, [None, n_features]
    )
    scores = helper.make_tensor_value_info(
        "scores", TensorProto.FLOAT, [None, len(model.classes_)]
    )
    opsets = [helper.make_opsetid("", 18), helper.make_opsetid("ai.onnx.ml", 3)]
    made = helper.make_model(
        helper.make_graph([node], "boosted", [wide], [scores]),
        opset_imports=opsets,
        ir_version=9,
    )
    text: bytes = made.SerializeToString()
    return text


def _nodes(model: HistGradientBoostingClassifier) -> dict[str, Any]:
    """Attributes of the trees, tree after tree, each class's in turn."""
    names = (
        "treeids",
        "nodeids",
        "featureids",
        "values",
        "modes",
        "truenodeids",
        "falsenodeids",
    )
    nodes: dict[str, Any] = {f"nodes_{name}": [] for name in names}
    leaves: dict[str, Any] = {
        f"target_{name}": [] for name in ("treeids", "nodeids", "ids", "weights")
    }
    trees = [
        (target, tree.nodes)
        for once in model._predictors
        for target, tree in enumerate(once)
    ]
    for tree, (target, rows) in enumerate(trees):
        for number, one in enumerate(rows):
            leaf = bool(one["is_leaf"])
            values = (
                tree,
                number,
                int(one["feature_idx"]),
                float(one["num_threshold"]) if not leaf else 0.0,
                "LEAF" if leaf else "BRANCH_LEQ",
                int(one["left"]),
                int(one["right"]),
            )
            for name, value in zip(names, values, strict=True):
                nodes[f"nodes_{name}"].append(value)
            if leaf:
                for name, value in zip(
                    leaves, (tree, number, target, float(one["value"])), strict=True
                ):
                    leaves[name].append(value)
    return nodes | leaves
