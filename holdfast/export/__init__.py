"""Everything ONNX: builds the step graph, joins the forest to it, verifies, seals.

It reads an artifact folder (forests as skops, the rest as JSON and plain arrays) and never imports
training.
"""

if __name__ == "export":  # imported by the link at the top of a checkout
    from holdfast.core.links import link

    link(__name__)
