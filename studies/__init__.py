"""What a paper would hold: each study is a command that writes its figures as JSON and its report
as one page."""

import edge_runtime as edge_runtime  # first of all: it switches onnxruntime's telemetry off
