"""Artifact folder -> one verified, sealed ONNX file. Nothing is written unless everything agrees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import onnx

from edge_runtime.writing import require_writable, write_whole
from export.artifact import read_artifact
from export.builder import GraphBuilder
from export.heads import Head, add_heads
from export.seal import model_card, seal
from export.spec import StepSpec
from export.step_graph import add_step
from export.verify import verify

MODEL_NAME = "holdfast.onnx"


def whole_graph(spec: StepSpec, heads: list[Head]) -> onnx.ModelProto:
    """The complete step: guard, bank, detectors, features, forests, calibration."""
    graph = GraphBuilder(spec.n_sensors)
    add_heads(graph, add_step(graph, spec), heads)
    return graph.model()


def export_artifact(folder: str | Path, out: str | Path | None = None) -> tuple[Path, dict[str, Any]]:
    """Export an artifact folder; returns the file's path and the verification report."""
    folder = Path(folder)
    path = Path(out or folder / MODEL_NAME)
    artifact = read_artifact(folder)
    require_writable(path.parent)
    model = whole_graph(artifact.spec, artifact.heads)
    report = verify(model, artifact.spec, artifact.heads, artifact.rows)
    data = seal(model, model_card(artifact), artifact.spec)
    return write_whole(path, data), {**report, "bytes": len(data)}
