"""What runs on the hand: one sealed model file, one step a sample, one decision.

Start from `contract`; `model` opens a model file and `monitor` is the live path. Loads numpy and
onnxruntime only.
"""
