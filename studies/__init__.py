"""Studies as in a paper: each is a command that writes figures as JSON and a one-page report."""

import holdfast as holdfast  # first: it switches off onnxruntime's telemetry
