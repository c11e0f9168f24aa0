"""What accuracy costs in time, as ratios of one run, beside the jitter of the machine."""

from holdfast import (
    edge_runtime as edge_runtime,  # first of all: it switches onnxruntime's telemetry off
)
