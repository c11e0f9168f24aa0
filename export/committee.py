"""A forest and a network that vote together: each has as many votes as the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.export.builder import GraphBuilder
from holdfast.export.forest import (
    EXACT_FLOAT32,
    Forest,
    IntArray,
    add_forest,
    forest_votes,
    votes_of_trees,
)
from holdfast.export.network import Float32Array, Network, add_network, network_votes


@dataclass(frozen=True)
class Committee:
    """Raises ValueError where their votes differ in number, or are too many to add exactly."""

    forest: Forest
    network: Network

    def __post_init__(self) -> None:
        votes = votes_of_trees(len(self.forest.estimators_))
        if votes != self.network.votes_in_all or 2 * votes >= EXACT_FLOAT32:
            raise ValueError(f"{votes} votes of trees, {self.network.votes_in_all} of the network")


def committee_votes(committee: Committee, rows: Float32Array, n_classes: int) -> IntArray:
    """Exact integer votes [N, n_classes] of float32 rows [N, F]."""
    of_trees = forest_votes(committee.forest, rows, n_classes)
    return np.asarray(of_trees + network_votes(committee.network, rows))


def add_committee(
    graph: GraphBuilder, committee: Committee, features: str, n_classes: int, out: str
) -> str:
    """Add both; returns votes [B, n_classes] float32 that hold exact integers."""
    trees = add_forest(graph, committee.forest, features, n_classes, "")
    return graph.node("Add", trees, add_network(graph, committee.network, features), out=out)
