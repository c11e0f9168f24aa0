"""What a network of whole numbers costs in time, beside the same in real numbers and the trees.

All answer the same rows one at a time from
their features on, interleaved; the numbers inside are of noise, on which the time does not depend.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from holdfast.core.contract import CLASSES
from holdfast.core.reading import Json
from holdfast.edge_runtime.graph import open_session
from holdfast.evaluation.latency.timing import busy_wait, time_in_turns
from holdfast.export.builder import IR_VERSION, OPSET
from holdfast.export.exporting import whole_graph
from holdfast.export.features import feature_count
from holdfast.export.heads import Calibration, Head
from holdfast.export.learner import Committee, Learner, votes_of_trees
from holdfast.export.spec import BandsLeftOut, StepSpec
from holdfast.export.verify import cut_learners
from holdfast.training.featurise import FloatRows
from holdfast.training.network_fit import Members, fit_members, in_whole_numbers
from holdfast.training.plan import CLOCK_FREE_GROUPS, SIZES

SPEC = StepSpec(n_sensors=6, rate_hz=150.0, unit="N", groups=CLOCK_FREE_GROUPS)
PLAN = SIZES["default"]
ROWS = 4000
SEED = 0
TURNS = 40
CALLS = 100
FLOOR_US = 20.0
REAL = "network, real numbers"
WHOLE = "network, whole numbers"


def measure() -> Json:
    """us by what answers: median, 99 %; and the ratio of whole numbers to real ones."""
    rng = np.random.default_rng(SEED)
    rows = rng.standard_t(3, size=(ROWS, feature_count(SPEC))).astype(np.float32)
    label = rng.integers(len(CLASSES), size=ROWS)
    forest = PLAN.situation.build(SEED, n_jobs=1).fit(rows, label)
    members = fit_members(PLAN.network, rows, label, SEED)
    votes = votes_of_trees(len(forest.estimators_))
    network = in_whole_numbers(members, rows, len(CLASSES), votes)
    calls = {
        "forest": _session(forest, rows),
        WHOLE: _session(network, rows),
        "committee": _session(Committee(forest, network), rows),
        REAL: _real_session(members, rows),
        "floor": busy_wait(FLOOR_US),
    }
    times = time_in_turns(calls, TURNS, CALLS)
    found = {
        name: {"p50_us": float(np.median(us)), "p99_us": float(np.quantile(us, 0.99))}
        for name, us in times.items()
    }
    return {
        "what": "from the features to the votes, labels and probabilities of one row",
        "times": found,
        "whole_over_real": found[WHOLE]["p50_us"] / found[REAL]["p50_us"],
        "network_weights": network.n_weights,
        "trees": len(forest.estimators_),
    }


def _session(learner: Learner, rows: FloatRows) -> Callable[[], object]:
    k = len(CLASSES)
    head = Head("situation", CLASSES, learner, Calibration(np.eye(k), np.zeros(k)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandsLeftOut)
        return _caller(cut_learners(whole_graph(SPEC, [head])), rows)


def _caller(model: bytes, rows: FloatRows) -> Callable[[], object]:
    """One row a call, in turn."""
    session = open_session(model)
    k = iter(np.resize(np.arange(len(rows)), 10**6).tolist())

    def call() -> object:
        at = next(k)
        return session.run(None, {"features": rows[at : at + 1]})

    return call


def _real_session(members: Members, rows: FloatRows) -> Callable[[], object]:
    """The networks as usual: standardised inputs, Gemm and Relu, the mean of the softmaxes."""
    nodes: list[onnx.NodeProto] = []
    constants: list[onnx.TensorProto] = []

    def constant(value: Any) -> str:
        name = f"c{len(constants)}"
        constants.append(numpy_helper.from_array(np.asarray(value, np.float32), name))
        return name

    def node(op: str, *inputs: str, **attributes: Any) -> str:
        nodes.append(
            helper.make_node(op, list(inputs), [f"n{len(nodes)}"], **attributes)
        )
        return str(nodes[-1].output[0])

    squash = members.squash
    below = node("Add", node("Abs", "features"), constant(squash.knee))
    moved = node("Sub", node("Div", "features", below), constant(squash.mean))
    inputs = node("Div", moved, constant(squash.deviation))
    shares = []
    for one in members.networks:
        value = inputs
        for number, (weights, bias) in enumerate(
            zip(one.coefs_, one.intercepts_, strict=True)
        ):
            value = node("Gemm", value, constant(weights), constant(bias))
            value = node("Relu", value) if number < len(one.coefs_) - 1 else value
        shares.append(node("Softmax", value, axis=1))
    votes = node("Mean", *shares)
    nodes.append(helper.make_node("ArgMax", [votes], ["situation"], axis=1, keepdims=0))
    graph = helper.make_graph(
        nodes,
        "real",
        [
            helper.make_tensor_value_info(
                "features", TensorProto.FLOAT, ["B", rows.shape[1]]
            )
        ],
        [
            helper.make_tensor_value_info("situation", TensorProto.INT64, ["B"]),
            helper.make_tensor_value_info(
                votes, TensorProto.FLOAT, ["B", len(CLASSES)]
            ),
        ],
        constants,
    )
    opsets = [helper.make_opsetid("", OPSET)]
    made = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION)
    return _caller(made.SerializeToString(), rows)
