"""A sealed model file as C99 without a library: `holdfast export MODEL.onnx --to c --out DIR`.

graph.py reads the nodes, plan.py puts them in order, one module writes each kind of operator, and
source.py joins what they wrote with the hand-written files in templates/.
"""
