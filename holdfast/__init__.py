"""Know a grip is about to fail before it does: slip from magnetic fingertips."""

import os

# onnxruntime from 1.31 on collects and sends usage data unless this turns it off before its import.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"
