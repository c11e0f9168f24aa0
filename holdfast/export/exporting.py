"""Artifact folder -> one verified, sealed ONNX file, written only if everything agrees.

Sealing puts the model card, the golden sequences and the SHA-256 of the file into its metadata.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import onnx

from holdfast.core.contract import NORMAL_FLOOR, Json, channel_names
from holdfast.core.errors import OutputError, UsageError
from holdfast.core.writing import require_free, require_writable, write_whole
from holdfast.edge_runtime.graph import open_session
from holdfast.edge_runtime.model import golden_answers, golden_to_json
from holdfast.edge_runtime.model_file import (
    CARD_KEY,
    CARD_SUFFIX,
    DIGITS,
    FORMAT,
    GOLDEN_KEY,
    SEAL_KEY,
)
from holdfast.export.verify import ExportReport, verify
from holdfast.step.artifact import INDEX, ROWS, Artifact, read_artifact
from holdfast.step.builder import GraphBuilder
from holdfast.step.detectors import detector_names
from holdfast.step.features import add_step
from holdfast.step.heads import Head, add_heads
from holdfast.step.learner import vote_bits, votes_in_all
from holdfast.step.spec import NOISE_RMS, POOLED, RANGE_LIMIT, StepSpec

if TYPE_CHECKING:
    from holdfast.core.hand_card import HandCard

MODEL_NAME = "holdfast.onnx"
"""In the artifact's folder, where --out names no other file."""


def export_artifact(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    hand: HandCard | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> tuple[Path, ExportReport]:
    """Export an artifact folder; returns the path of the file, and what was verified.

    The model card is written next to the file. hand: another one than it was trained on, where all
    features are pooled. report: called with the name of each stage.
    """
    folder = Path(folder)
    path = Path(out or folder / MODEL_NAME)
    if path.suffix == CARD_SUFFIX:
        raise UsageError(
            f"--out {path}: the model's card is written there and would overwrite the model",
            next_step=f"write --out {path.with_suffix('.onnx')}",
        )

    artifact = read_artifact(folder)
    if hand is not None:
        artifact = replace(artifact, spec=spec_for_hand(artifact.spec, hand, folder))
    # before the verification, which takes minutes for a large forest
    require_writable(path.parent)
    report("building the graph")
    model = whole_graph(artifact.spec, artifact.heads)
    verification = verify(
        model, artifact.spec, artifact.heads, artifact.rows, report=report
    )

    report("sealing: card, golden sequences, SHA-256")
    data = seal(model, model_card(artifact), artifact.spec)
    write_model(path, data)
    return path, ExportReport(**vars(verification), bytes=len(data))


def spec_for_hand(spec: StepSpec, hand: HandCard, where: str | Path = "") -> StepSpec:
    """The same step for another hand. Raises UsageError where features know single sensors."""
    if not spec.is_pooled:
        of_sensors = [name for name in spec.groups if not name.startswith(POOLED)]
        raise UsageError(
            f"{where}: this model fits the hand that it was trained on, and no other",
            cause=f"features of single sensors: {', '.join(of_sensors)}",
            next_step="export a model whose features are all pooled (docs/how-it-works.md)",
        )
    return msgspec.structs.replace(
        spec, n_sensors=hand.n_sensors, hand=hand, min_valid_sensors=0
    )


def require_replaceable(artifact: Path, model: Path, *, force: bool) -> None:
    """Raise OutputError where model or card would replace part of the artifact, or another file."""
    for path in (model, model.with_suffix(CARD_SUFFIX)):
        inside = path.resolve().parent == artifact.resolve()
        is_part = path.name in (INDEX, ROWS) or path.suffix in (".skops", ".npz")
        if inside and is_part:
            raise OutputError(
                "is part of the artifact",
                where=path,
                cause="the card of a model is written to MODEL.json",
                next_step="name another file, such as --out holdfast.onnx",
            )
        require_free(path, force=force or inside)


def whole_graph(spec: StepSpec, heads: list[Head]) -> onnx.ModelProto:
    """The complete step: guard, bank, detectors, features, learners, calibration."""
    graph = GraphBuilder(spec.n_sensors)
    features, empty = add_step(graph, spec)
    add_heads(graph, features, heads, empty)
    return graph.model()


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
        "contact": msgspec.to_builtins(spec.contact),
        "window_samples": spec.window_samples,
        "history_samples": spec.history_samples,
        "settle_samples": spec.settle_samples,
        "gap_samples": spec.gap_samples,
        "bands_hz": list(spec.usable_bands()),
        "bands_left_out_hz": list(spec.lost_bands()),
        "detectors": list(detector_names(spec)),
        "heads": {head.name: _head_card(head) for head in artifact.heads},
        "tie_rule": "the riskier class wins",
        "preparation": artifact.preparation.to_json(),
        "decision": artifact.decision,
        "training": artifact.training,
    }


def _head_card(head: Head) -> Json:
    """What a consumer needs to know about a head: classes, size, votes and calibration."""
    card: Json = {"classes": list(head.classes)}
    forest, network = head.learner.forest, head.learner.network
    if forest is not None:
        trees = forest.estimators_
        card["trees"] = len(trees)
        card["nodes"] = sum(int(tree.tree_.node_count) for tree in trees)
        card["vote_bits"] = vote_bits(len(trees))
        card["kind"] = type(forest).__name__
    if network is not None:
        card["learner"] = "network" if forest is None else "committee"
        card["layers"] = [len(layer.bias) for layer in network.layers]
        card["votes"] = votes_in_all(head.learner)
    if head.label_weights is not None:
        card["label_weights"] = list(head.label_weights)

    card["calibration"] = head.calibration.to_json()
    return card


def write_model(path: Path, data: bytes) -> None:
    """Write a sealed file, and beside it its card for people: nothing that runs reads that."""
    card = json.loads(metadata_of(onnx.load_from_string(data))[CARD_KEY])
    # one fingerprint a recording would make the card unreadable
    card["training"].pop("recordings", None)
    digest = hashlib.sha256(data).hexdigest()
    file = {"name": path.name, "bytes": len(data), "sha256": digest}
    readable = json.dumps({"file": file, **card}, indent=1)
    write_whole(path, data)
    write_whole(path.with_suffix(CARD_SUFFIX), readable + "\n")


def seal(
    model: onnx.ModelProto,
    card: Json,
    spec: StepSpec,
    more: Mapping[str, str] | None = None,
) -> bytes:
    """The serialised model with card, golden sequences and hash. more: of its metadata."""
    session = open_session(model.SerializeToString())
    # a file that answers otherwise on another machine is refused there when it is opened
    answers = golden_answers(session, spec.n_channels, spec.unit, spec.settle_samples)

    metadata = {
        CARD_KEY: json.dumps(card, separators=(",", ":")),
        GOLDEN_KEY: json.dumps(golden_to_json(answers), separators=(",", ":")),
        **(more or {}),
    }
    return sealed_with(model, metadata)


def sealed_with(model: onnx.ModelProto, metadata: Mapping[str, str]) -> bytes:
    """The serialised model with these metadata, and the hash of the file as the last of them."""
    # the hash covers the whole file, with zeros where the hash itself stands
    onnx.helper.set_model_props(model, {**metadata, SEAL_KEY: "0" * DIGITS})
    zeroed = model.SerializeToString()
    digest = hashlib.sha256(zeroed).hexdigest()

    # In protobuf, two bytes (field number and length) stand between the key and its digits.
    start = zeroed.rfind(SEAL_KEY.encode()) + len(SEAL_KEY) + 2
    return zeroed[:start] + digest.encode() + zeroed[start + DIGITS :]


def metadata_of(model: onnx.ModelProto) -> dict[str, str]:
    """In the order of the file, on which its bytes depend."""
    return {entry.key: entry.value for entry in model.metadata_props}
