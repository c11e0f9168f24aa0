"""Everything ONNX: an artifact folder becomes one verified, sealed file. The route:

features.py    from samples to features, as nodes of the step graph
learner.py     the forest by skl2onnx, its leaves as whole votes (network.py: a network's)
exporting.py   both joined to one graph with labels and probabilities (heads.py), and sealed
verify.py      in between: that graph against the reference (structure.py: every number)

changed.py writes a changed copy of such a file, c/ its C form. Nothing here imports training.
"""

if __name__ == "export":  # imported by the link at the top of a checkout
    from holdfast.core.links import link

    link(__name__)
