"""Studies as in a paper: each is a command that writes figures as JSON and a one-page report."""

from holdfast import (
    edge_runtime as edge_runtime,  # first of all: it switches onnxruntime's telemetry off
)
