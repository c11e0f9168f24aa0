"""Everything ONNX: builds the step graph, joins the forest to it, verifies, seals.

It reads an artifact folder (forests as skops, the rest as JSON and plain arrays) and never imports
training.
"""
