"""Recordings -> critical points -> balanced windows -> forest -> evaluation; and when a camera saw a slip begin."""

import edge_runtime as edge_runtime  # first of all: it switches onnxruntime's telemetry off
