"""What accuracy costs in time, as ratios of one run, beside the jitter of the machine."""

import holdfast as holdfast  # first: it switches off onnxruntime's telemetry
