"""A model file on whole streams: what a user feels of it, beside baselines, and what a closing hand
makes of it."""

import edge_runtime as edge_runtime  # first of all: it switches onnxruntime's telemetry off

MOST_FALSE_PER_MIN = 0.5
"""False alarms a minute that are allowed where a confidence is chosen, unless told."""
