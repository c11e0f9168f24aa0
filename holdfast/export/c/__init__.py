"""A sealed model file as C99 without a library: `holdfast export MODEL.onnx --to c --out DIR`.

graph.py reads the nodes, plan.py puts them in order, one module writes each kind of operator,
compiled.py makes functions of them, and source.py joins these with the hand-written files in
templates/.
"""
