"""Everything ONNX: builds the step graph, joins the forest to it, verifies, seals.

Reads an artifact folder (a forest as skops, the rest as JSON and plain arrays); never imports
training.
"""

import edge_runtime as edge_runtime  # first of all: it switches onnxruntime's telemetry off
