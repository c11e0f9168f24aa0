"""A model file on whole streams: events, baselines, states, and what a closing hand would keep."""

import edge_runtime as edge_runtime  # first of all: it switches onnxruntime's telemetry off

MOST_FALSE_PER_MIN = 0.5
"""Default: false alarms a minute that are allowed where a confidence is chosen."""
