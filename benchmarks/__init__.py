"""What accuracy costs in time: speed as ratios taken in one run, beside the machine's own
jitter."""

import edge_runtime as edge_runtime  # first of all: it switches onnxruntime's telemetry off
