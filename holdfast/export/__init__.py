"""For: what becomes of an artifact folder: one verified, sealed file, and its C form.
May import: step, edge_runtime, core.
Begin with: exporting.py, features and learner joined to one graph, and sealed.

verify.py in between: that graph against the reference (structure.py: every number). changed.py
writes a changed copy of such a file, c/ its C form. Nothing here imports training. export.py
is `holdfast export` as a script.
"""

from holdfast.core.links import link, link_old_names

if __name__ == "export":  # imported by the link at the top of a checkout
    link(__name__)
else:
    of_graph = ["builder", "detectors", "features", "guard", "history", "spec"]
    of_learner = ["artifact", "heads", "learner", "network", "pooled", "pooled_graph"]
    link_old_names(__name__, "step", of_graph + of_learner)
