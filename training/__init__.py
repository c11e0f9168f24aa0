"""Recordings -> critical points -> balanced windows -> forest -> artifact."""

import edge_runtime as edge_runtime  # first of all: it switches onnxruntime's telemetry off
