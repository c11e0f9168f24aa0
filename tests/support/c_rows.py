"""Rows and streams that are hard for a C form: thresholds, ties, lost and impossible samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.model_file import ModelCard
from holdfast.export.c.graph import Graph
from holdfast.export.c.trees import read_forest
from holdfast.export.structure import edge_rows

Rows = npt.NDArray[Any]
STREAM = 500
"""Samples of one stream."""


def hard_features(graph: Graph, n: int, seed: int) -> Rows:
    """[n, F] float32: thresholds of trees and one step beside them, edges, ties; for trees alone
    also NaN and inf."""
    rng, f = np.random.default_rng(seed), graph.n_features
    by_feature = thresholds(graph)
    rows = np.stack([rng.choice(by_feature[k], n) for k in range(f)], axis=1)
    side = rng.choice(np.array([-np.inf, 0.0, np.inf], np.float32), rows.shape)
    rows = np.where(side == 0.0, rows, np.nextafter(rows, side)).astype(np.float32)
    edges = edge_rows(f)[:, 0]
    is_network = any(node.op_type == "LabelEncoder" for node in graph.nodes)
    none = edges if is_network else np.array([np.nan, np.inf, -np.inf])
    for share, values in ((0.05, edges), (0.01, none)):
        rows = np.where(
            rng.random(rows.shape) < share, rng.choice(values, rows.shape), rows
        )
    grid = rng.integers(-20, 20, rows.shape) / 4.0
    return np.where(rng.random((n, 1)) < 0.2, grid, rows).astype(np.float32)


def thresholds(graph: Graph) -> list[Rows]:
    """All thresholds of every feature; 0 for a feature that no tree reads."""
    found: list[list[float]] = [[0.0] for _ in range(graph.n_features)]
    for node in graph.nodes:
        if node.op_type == "TreeEnsembleRegressor":
            forest = read_forest(node, graph.shape(node.outputs[0])[1])
            for feature, at in zip(
                forest.feature.tolist(), forest.threshold, strict=True
            ):
                found[feature].append(float(at))
    return [np.array(one, np.float32) for one in found]


def hard_streams(card: ModelCard, streams: int, seed: int) -> tuple[Rows, Rows]:
    """values [streams, STREAM, C] and valid [streams, STREAM, S]."""
    rng, c = np.random.default_rng(seed), card.n_channels
    shape, unit = (streams, STREAM, c), card.range_limit / 500.0
    steady = np.repeat(rng.uniform(-2.0, 6.0, (streams, STREAM // 50, c)), 50, axis=1)
    noise = rng.normal(size=shape) * rng.choice([0.0, 0.01, 1.0], (streams, 1, 1))
    values = np.round((steady + noise) * 64.0) / 64.0 * unit
    values = np.where(
        rng.random((streams, 1, 1)) < 0.5, values, (steady + noise) * unit
    )
    _on_the_cone(values, rng, unit)
    limit = card.range_limit
    evil = [
        np.nan,
        np.inf,
        -np.inf,
        1e30,
        limit,
        np.nextafter(limit, 0.0),
        -limit,
        -0.0,
    ]
    values = np.where(rng.random(shape) < 0.001, rng.choice(evil, shape), values)
    valid = rng.random((streams, STREAM, c // 3)) > 0.002
    for _ in range(10 * streams):
        one, first, finger = (int(rng.integers(n)) for n in (streams, STREAM, c // 3))
        valid[
            one, first : first + int(rng.integers(1, 2 * card.gap_samples + 4)), finger
        ] = False
    return values, valid


def _on_the_cone(values: Rows, rng: np.random.Generator, unit: float) -> None:
    """Shear of 5 a and a normal where 0.8 of it is just that, or one step beside it; in place."""
    n = values.shape[0] * values.shape[1] // 10
    rows = values.reshape(-1, values.shape[2])
    at, a = (
        rng.choice(len(rows), n, replace=False),
        rng.integers(1, 64, n) / 64.0 * unit,
    )
    normal = np.nextafter(6.25 * a, rng.choice([-np.inf, np.inf], n))
    rows[at, :3] = np.stack(
        [3 * a, 4 * a, np.where(rng.random(n) < 0.5, 6.25 * a, normal)], axis=1
    )
