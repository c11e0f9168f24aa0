"""The trees as compact tables: twelve bytes a branch, and each different leaf once.

A branch holds its threshold, its feature, and where to go: a branch of the same tree (0 or more),
or a leaf (below 0, its number as ~leaf). Leaves hold whole votes for every class; their sums are
exact in any order. A feature that is NaN goes right, as in onnxruntime.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import IntArray
from holdfast.export.c.graph import Node
from holdfast.export.c.literals import number, smallest_type, template
from holdfast.export.c.loops import Writer
from holdfast.export.structure import votes_of_nodes

TOGETHER = 4
"""Trees that are walked at once where their number allows: while one waits, the others go on."""
MOST_SHORT = 2**15
"""Branches of one tree, and different leaves, that 16 bits can name."""


@dataclass(frozen=True)
class Forest:
    """Branches in the order of the trees, children by C's rule. starts: a tree's first branch.

    threshold, feature [branches]. children [branches, 2]: left, then right.
    roots: where each tree begins: 0, or ~leaf for a tree that is one leaf. votes [leaves, K].
    """

    threshold: npt.NDArray[np.float32]
    feature: IntArray
    children: IntArray
    starts: IntArray
    roots: IntArray
    votes: IntArray

    @property
    def is_short(self) -> bool:
        """Whether 16 bits name every child."""
        least = self.children.min(initial=0)
        most = self.children.max(initial=0)
        return least >= -MOST_SHORT and most < MOST_SHORT


def read_forest(node: Node, n_classes: int) -> Forest:
    """The trees of a TreeEnsembleRegressor, which are checked already (edge_runtime)."""
    about = {name: np.array(values) for name, values in node.attributes.items()}
    branch = about["nodes_modes"] != b"LEAF"
    tree = about["nodes_treeids"]

    first = np.flatnonzero(about["nodes_nodeids"] == 0)

    # many leaves have the same votes: the table holds each different one once
    votes = votes_of_nodes(node.attributes, n_classes).astype(np.int64)
    leaves, number_of = np.unique(votes[~branch], axis=0, return_inverse=True)

    # a node's number in C: a branch counts from its tree's first branch, a leaf is ~leaf
    branches_so_far = np.cumsum(branch)
    starts = np.concatenate([[0], branches_so_far])[first]
    meaning = branches_so_far - 1 - starts[tree]
    meaning[~branch] = ~number_of.ravel()

    # the ids of the file count from each tree's first node, here rows count through all trees
    is_true = first[tree] + about["nodes_truenodeids"]
    is_false = first[tree] + about["nodes_falsenodeids"]
    # the true child of "above" is the right one
    is_above = about["nodes_modes"] == b"BRANCH_GT"
    left_rows = np.where(is_above, is_false, is_true)
    right_rows = np.where(is_above, is_true, is_false)
    children = [meaning[left_rows[branch]], meaning[right_rows[branch]]]
    roots = meaning[first]
    return Forest(
        threshold=about["nodes_values"][branch].astype(np.float32),
        feature=about["nodes_featureids"][branch],
        children=np.stack(children, axis=1),
        # a tree of one leaf begins at a branch that a walk may read and never follows
        starts=np.where(roots < 0, 0, starts),
        roots=roots,
        votes=leaves,
    )


def write_trees(node: Node, writer: Writer) -> list[str]:
    """Walk all trees, some at a time, and add up the votes of their leaves."""
    (out,) = node.outputs
    n_classes = writer.graph.shape(out)[1]
    forest = read_forest(node, n_classes)
    n_trees = len(forest.roots)
    # bytes of a branch in C: a float, the feature, and two children of 16 or 32 bits
    # Children count from the start of their tree, so 16 bits also serve large forests.
    kind, width = ("short", 12) if forest.is_short else ("long", 16)
    votes_type = smallest_type(forest.votes)
    tables = writer.tables
    branches = f"hf_{out}_branches"
    text = _branches(branches, forest, kind)
    tables.add_text(branches, text, width * len(forest.threshold))
    words = {
        "BRANCHES": branches,
        "STARTS": tables.add(f"hf_{out}_starts", forest.starts, "int32_t"),
        "ROOTS": tables.add(f"hf_{out}_roots", forest.roots, "int32_t"),
        "LEAVES": tables.add(f"hf_{out}_leaves", forest.votes, votes_type),
        "VOTES_TYPE": votes_type,
        "KIND": kind,
        "FEATURES": f"t_{node.inputs[0]}",
        "VOTES": f"t_{out}",
        "CLASSES": n_classes,
        "TREES": n_trees,
        "TOGETHER": next(n for n in range(TOGETHER, 0, -1) if n_trees % n == 0),
    }
    return template("trees.c", words).splitlines()


def _branches(name: str, forest: Forest, kind: str) -> str:
    """The table of branches; a forest of single leaves has one that no walk reads."""
    # number by number, plain lists are much faster than numpy arrays
    numbers = zip(
        forest.threshold.tolist(),
        forest.feature.tolist(),
        forest.children.tolist(),
        strict=True,
    )
    lines = []
    for threshold, feature, (low, high) in numbers:
        lines.append(f"{{{number(threshold, 'float')}, {feature}, {{{low}, {high}}}}}")
    lines = lines or ["{0.0f, 0, {-1, -1}}"]
    rows = ",\n    ".join(lines)
    return f"static const hf_branch_{kind} {name}[{len(lines)}] = {{\n    {rows}\n}};\n"
