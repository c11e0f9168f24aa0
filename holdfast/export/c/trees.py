"""The trees as compact tables: twelve bytes a branch, and each different leaf once.

A branch holds its threshold, its feature, and where to go: a branch of the same tree (0 or more),
or a leaf (below 0, its number as ~leaf). Leaves hold whole votes for every class; their sums are
exact in any order. A feature that is NaN goes right, as in onnxruntime.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.export.c.graph import Node
from holdfast.export.c.literals import number, smallest_type
from holdfast.export.c.writer import Writer, block, counted

IntArray = npt.NDArray[np.int64]
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
    about = {}
    for name, values in node.attributes.items():
        is_real = name in ("nodes_values", "target_weights")
        about[name] = np.array(values, np.float32) if is_real else np.array(values)
    branch = about["nodes_modes"] != b"LEAF"
    tree = about["nodes_treeids"]

    first = np.flatnonzero(about["nodes_nodeids"] == 0)
    leaf_votes, leaf_of = _leaves(about, first, branch, n_classes)

    # a node's number in C: a branch counts from its tree's first branch, a leaf is ~leaf
    branches_so_far = np.cumsum(branch)
    place = branches_so_far - 1
    starts = np.concatenate([[0], branches_so_far])[first]
    meaning = np.where(branch, place - starts[tree], ~leaf_of)

    # the ids of the file count from each tree's first node, here rows count through all trees
    is_true = first[tree] + about["nodes_truenodeids"]
    is_false = first[tree] + about["nodes_falsenodeids"]
    # the true child of "above" is the right one
    is_above = about["nodes_modes"] == b"BRANCH_GT"
    left_rows = np.where(is_above, is_false, is_true)
    right_rows = np.where(is_above, is_true, is_false)
    left = meaning[left_rows[branch]]
    right = meaning[right_rows[branch]]
    roots = meaning[first]
    return Forest(
        threshold=about["nodes_values"][branch],
        feature=about["nodes_featureids"][branch],
        children=np.stack([left, right], axis=1),
        # a tree of one leaf begins at a branch that a walk may read and never follows
        starts=np.where(roots < 0, 0, starts),
        roots=roots,
        votes=leaf_votes,
    )


def _leaves(
    about: dict[str, Any],
    first: IntArray,
    branch: npt.NDArray[np.bool_],
    n_classes: int,
) -> tuple[IntArray, IntArray]:
    """(votes of every different leaf, the number of each node's leaf)."""
    votes = np.zeros((len(branch), n_classes), dtype=np.int64)
    rows = first[about["target_treeids"]] + about["target_nodeids"]
    weights = about["target_weights"].astype(np.int64)
    # add.at, because += would count a place that occurs twice only once
    np.add.at(votes, (rows, about["target_ids"]), weights)

    # many leaves have the same votes: the table holds each different one once
    different, number_of = np.unique(votes[~branch], axis=0, return_inverse=True)
    leaf_of = np.zeros(len(branch), dtype=np.int64)
    leaf_of[~branch] = number_of.ravel()
    return different, leaf_of


def write_trees(node: Node, writer: Writer) -> list[str]:
    """Walk all trees, some at a time, and add up the votes of their leaves."""
    (out,) = node.outputs
    name = writer.name(out)
    x = writer.name(node.inputs[0])
    n_classes = writer.graph.shape(out)[1]
    forest = read_forest(node, n_classes)
    n_trees = len(forest.roots)
    together = next(n for n in range(TOGETHER, 0, -1) if n_trees % n == 0)
    # bytes of a branch in C: a float, the feature, and two children of 16 or 32 bits
    # Children count from the start of their tree, so 16 bits also serve large forests.
    kind, width = ("short", 12) if forest.is_short else ("long", 16)

    tables = writer.tables
    prefix = f"hf_{name}"
    votes_type = smallest_type(forest.votes)
    votes = tables.add(f"{prefix}_leaves", forest.votes, votes_type)
    starts = tables.add(f"{prefix}_starts", forest.starts, "int32_t")
    roots = tables.add(f"{prefix}_roots", forest.roots, "int32_t")

    branches = f"{prefix}_branches"
    text = _branches(branches, forest, kind)
    tables.add_text(branches, text, width * len(forest.threshold))

    following = f"hf_next_{kind}({branches} + {starts}[t + k], at[k], {x})"
    places = [f"at[{k}]" for k in range(together)]
    all_at = " & ".join(places)

    # Behind the walk at[k] is below 0, and its complement is the number of a leaf.
    add = [
        f"const {votes_type} *leaf = {votes} + {n_classes} * ~at[k];",
        *counted("j", n_classes, ["total[j] += leaf[j];"]),
    ]

    # Every tree of a group steps in each pass; one that has reached its leaf stays there (hf_next).
    walk = [
        f"int32_t at[{together}];",
        *counted("k", together, [f"at[k] = {roots}[t + k];"]),
        # the sign of the conjunction is negative only where all have reached a leaf
        *block(
            f"while (({all_at}) >= 0)",
            counted("k", together, [f"at[k] = {following};"]),
        ),
        *counted("k", together, add),
    ]

    # whole votes are added as integers: their sum is exact in any order
    loop = f"for (int t = 0; t < {n_trees}; t += {together})"
    return [
        f"int32_t total[{n_classes}] = {{0}};",
        *block(loop, walk),
        *counted("j", n_classes, [f"{name}[j] = (float)total[j];"]),
    ]


def _branches(name: str, forest: Forest, kind: str) -> str:
    """The table of branches; a forest of single leaves has one that no walk reads."""
    head = f"static const hf_branch_{kind} {name}"
    if not len(forest.threshold):
        return f"{head}[1] = {{{{0.0f, 0, {{-1, -1}}}}}};\n"

    # number by number, plain lists are much faster than numpy arrays
    thresholds = forest.threshold.tolist()
    features = forest.feature.tolist()
    children = forest.children.tolist()
    lines = []
    for threshold, feature, both in zip(thresholds, features, children, strict=True):
        low, high = both
        limit = number(threshold, "float")
        lines.append(f"    {{{limit}, {feature}, {{{low}, {high}}}}}")

    rows = ",\n".join(lines)
    return f"{head}[{len(lines)}] = {{\n{rows}\n}};\n"
