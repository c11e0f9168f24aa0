"""Artifact folder -> one verified, sealed ONNX file, written only if everything agrees."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import onnx

from holdfast.core.errors import UsageError
from holdfast.core.reading import Json
from holdfast.core.writing import require_writable, write_whole
from holdfast.edge_runtime.model_file import CARD_SUFFIX
from holdfast.export.artifact import read_artifact
from holdfast.export.builder import GraphBuilder
from holdfast.export.heads import Head, add_heads
from holdfast.export.seal import model_card, seal
from holdfast.export.spec import StepSpec
from holdfast.export.step_graph import add_step
from holdfast.export.verify import ExportReport, verify

MODEL_NAME = "holdfast.onnx"


def whole_graph(spec: StepSpec, heads: list[Head]) -> onnx.ModelProto:
    """The complete step: guard, bank, detectors, features, forests, calibration."""
    graph = GraphBuilder(spec.n_sensors)
    add_heads(graph, add_step(graph, spec), heads)
    return graph.model()


def export_artifact(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    say: Callable[[str], None] = lambda line: None,
) -> tuple[Path, ExportReport]:
    """Export an artifact folder; returns the path of the file, and what was verified.

    The card is written beside the file. say: called with what begins now.
    """
    folder = Path(folder)
    path = Path(out or folder / MODEL_NAME)
    if path.suffix == CARD_SUFFIX:
        raise UsageError(
            f"--out {path}: the model's card is written there and would overwrite the model",
            next_step=f"write --out {path.with_suffix('.onnx')}",
        )
    artifact = read_artifact(folder)
    require_writable(path.parent)
    say("building the graph")
    model = whole_graph(artifact.spec, artifact.heads)
    verification = verify(model, artifact.spec, artifact.heads, artifact.rows, say=say)
    say("sealing: card, golden sequences, SHA-256")
    card = model_card(artifact)
    data = seal(model, card, artifact.spec)
    write_whole(path, data)
    write_whole(path.with_suffix(CARD_SUFFIX), readable_card(card, path.name, data))
    return path, ExportReport.of(verification, len(data))


def readable_card(card: Json, name: str, data: bytes) -> str:
    """The card of a file as readable JSON, with name, size and SHA-256, without fingerprints."""
    training = {
        key: value for key, value in card["training"].items() if key != "recordings"
    }
    file = {
        "name": name,
        "bytes": len(data),
        "sha256": hashlib.sha256(data).hexdigest(),
    }
    return json.dumps({"file": file, **card, "training": training}, indent=1) + "\n"
