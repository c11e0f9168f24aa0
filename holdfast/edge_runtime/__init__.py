"""What runs on the hand: one sealed model file, one step a sample, one decision.

Start from core/contract.py; `model` opens a model file and `monitor` is the live path. Loads numpy
and onnxruntime only.
"""

if __name__ == "edge_runtime":  # imported by the link at the top of a checkout
    from holdfast.core.links import link

    link(__name__)
