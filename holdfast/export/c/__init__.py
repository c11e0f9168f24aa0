"""A sealed model file as C99 without a library: `holdfast export MODEL.onnx --to c --out DIR`.

graph.py reads the nodes, memory.py gives each tensor its place, one module writes each kind of
operator, compiled.py makes the two halves of a step of them, and source.py joins these with the
hand-written files in templates/.
"""
