"""For: what runs on the hand: one sealed model file, one step a sample, one decision.
May import: core; of libraries only numpy, msgspec and onnxruntime.
Begin with: monitor.py, the live path (model.py opens a model file).
"""

if __name__ == "edge_runtime":  # imported by the link at the top of a checkout
    from holdfast.core.links import link

    link(__name__)
