"""What runs on the hand: one sealed model file, one step a sample, one decision.

Start from `contract`; `model` opens a model file and `monitor` is the live path. Loads numpy and
onnxruntime only.
"""

import os

# onnxruntime from 1.31 on collects and sends usage data unless this turns it off before its import.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"
