"""Sealing a model file: card, golden sequences and SHA-256 go into its metadata."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping

import onnx

from holdfast.core.contact import NORMAL_FLOOR
from holdfast.core.contract import channel_names
from holdfast.core.reading import Json
from holdfast.edge_runtime.graph import open_session
from holdfast.edge_runtime.model import golden_answers, golden_to_json
from holdfast.edge_runtime.model_file import (
    CARD_KEY,
    DIGITS,
    FORMAT,
    GOLDEN_KEY,
    SEAL_KEY,
)
from holdfast.export.artifact import Artifact
from holdfast.export.detectors import detector_names
from holdfast.export.forest import vote_bits
from holdfast.export.heads import Head
from holdfast.export.learner import forest_of, kind_of, network_of, votes_in_all
from holdfast.export.spec import NOISE_RMS, RANGE_LIMIT, StepSpec

TIE_RULE = "the riskier class wins"


def model_card(artifact: Artifact) -> Json:
    """Everything a consumer of the file needs to know, as one JSON object."""
    spec = artifact.spec
    return {
        "format": FORMAT,
        "spec": spec.to_json(),
        "channels": list(channel_names(spec.n_sensors)),
        "range_limit": RANGE_LIMIT[spec.unit],
        "noise_rms": NOISE_RMS[spec.unit],
        "normal_floor": NORMAL_FLOOR[spec.unit],
        "window_samples": spec.window_samples,
        "history_samples": spec.history_samples,
        "settle_samples": spec.settle_samples,
        "gap_samples": spec.gap_samples,
        "bands_hz": list(spec.carried_bands()),
        "bands_left_out_hz": list(spec.lost_bands()),
        "detectors": list(detector_names(spec)),
        "heads": {head.name: _head_card(head) for head in artifact.heads},
        "tie_rule": TIE_RULE,
        "preparation": artifact.preparation.to_json(),
        "decision": artifact.decision,
        "training": artifact.training,
    }


def _head_card(head: Head) -> Json:
    card: Json = {"classes": list(head.classes)}
    forest, network = forest_of(head.learner), network_of(head.learner)
    if forest is not None:
        trees = forest.estimators_
        card["trees"] = len(trees)
        card["nodes"] = int(sum(tree.tree_.node_count for tree in trees))
        card["vote_bits"] = vote_bits(len(trees))
        card["kind"] = type(forest).__name__
    if network is not None:
        card["learner"] = kind_of(head.learner)
        card["layers"] = [len(layer.bias) for layer in network.layers]
        card["votes"] = votes_in_all(head.learner)
    if head.label_weights is not None:
        card["label_weights"] = list(head.label_weights)
    return {**card, "calibration": head.calibration.to_json()}


def seal(
    model: onnx.ModelProto,
    card: Json,
    spec: StepSpec,
    more: Mapping[str, str] | None = None,
) -> bytes:
    """The serialised model with card, golden sequences and its own hash. more: of its metadata."""
    session = open_session(model.SerializeToString())
    golden = golden_to_json(
        golden_answers(session, spec.n_channels, spec.unit, spec.settle_samples)
    )
    metadata = {
        CARD_KEY: json.dumps(card, separators=(",", ":")),
        GOLDEN_KEY: json.dumps(golden, separators=(",", ":")),
        **(more or {}),
    }
    return sealed_with(model, metadata)


def sealed_with(model: onnx.ModelProto, metadata: Mapping[str, str]) -> bytes:
    """The serialised model with these metadata, and its own hash as the last of them."""
    onnx.helper.set_model_props(model, {**metadata, SEAL_KEY: "0" * DIGITS})
    open_bytes = model.SerializeToString()
    digest = hashlib.sha256(open_bytes).hexdigest()
    at = open_bytes.rfind(SEAL_KEY.encode()) + len(SEAL_KEY) + 2
    return open_bytes[:at] + digest.encode() + open_bytes[at + DIGITS :]
