"""What answers in a file: a forest, a network, or both together; each votes in whole numbers.

A forest and a network that vote together: each has as many votes as the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from holdfast.core.errors import NotANumber
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
            raise ValueError(
                f"{votes} votes of trees, {self.network.votes_in_all} of the network"
            )


def committee_votes(
    committee: Committee, rows: Float32Array, n_classes: int
) -> IntArray:
    """Exact integer votes [N, n_classes] of float32 rows [N, F]."""
    of_trees = forest_votes(committee.forest, rows, n_classes)
    return np.asarray(of_trees + network_votes(committee.network, rows))


def add_committee(
    graph: GraphBuilder, committee: Committee, features: str, n_classes: int, out: str
) -> str:
    """Add both; returns votes [B, n_classes] float32 that hold exact integers."""
    trees = add_forest(graph, committee.forest, features, n_classes, "")
    return graph.node(
        "Add", trees, add_network(graph, committee.network, features), out=out
    )


Learner: TypeAlias = Forest | Network | Committee
LEARNERS = ("forest", "network", "committee")


def forest_of(learner: Learner) -> Forest | None:
    """The trees in it."""
    if isinstance(learner, Committee):
        return learner.forest
    return None if isinstance(learner, Network) else learner


def network_of(learner: Learner) -> Network | None:
    """The network in it."""
    if isinstance(learner, Committee):
        return learner.network
    return learner if isinstance(learner, Network) else None


def kind_of(learner: Learner) -> str:
    """Of LEARNERS."""
    if isinstance(learner, Committee):
        return "committee"
    return "network" if isinstance(learner, Network) else "forest"


def votes_in_all(learner: Learner) -> int:
    """The sum of a row's votes."""
    forest, network = forest_of(learner), network_of(learner)
    of_trees = votes_of_trees(len(forest.estimators_)) if forest is not None else 0
    return of_trees + (network.votes_in_all if network is not None else 0)


def features_in(learner: Learner) -> int:
    """F."""
    forest, network = forest_of(learner), network_of(learner)
    if network is not None:
        return network.n_features
    assert forest is not None
    return int(forest.n_features_in_)


def reference_votes(
    learner: Learner, features: Float32Array, n_classes: int
) -> IntArray:
    """Exact integer votes [N, n_classes] of float32 rows [N, F]. Raises NotANumber."""
    rows = np.asarray(features, dtype=np.float32)
    if not np.isfinite(rows).all():
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        what = f"{len(bad)} rows have features that are not finite, the first is row {bad[0]}"
        raise NotANumber(what, where="feature rows")
    if isinstance(learner, Committee):
        return committee_votes(learner, rows, n_classes)
    if isinstance(learner, Network):
        return network_votes(learner, rows)
    return forest_votes(learner, rows, n_classes)


def add_learner(
    graph: GraphBuilder, learner: Learner, features: str, n_classes: int, out: str
) -> str:
    """Add it to a graph; returns votes [B, n_classes] float32 that hold exact integers."""
    if isinstance(learner, Committee):
        return add_committee(graph, learner, features, n_classes, out)
    if isinstance(learner, Network):
        return add_network(graph, learner, features, out)
    return add_forest(graph, learner, features, n_classes, out)
