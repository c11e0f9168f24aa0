"""A small neural network as integer votes: every product and sum is exact, so are the votes.

    q = round(gain * x / (knee + |x|) + offset)      whole numbers within +-INPUT_MOST
    h = clip(round((q W + b) * scale), 0, HIDDEN_MOST)    for each hidden layer
    l = round((h W + b) * scale)                     logits in steps of 1 / LOGIT_STEPS
    e = table[max(l) - l]                            exp(-d / LOGIT_STEPS) as whole numbers
    votes = floor(e / sum(e) * (votes in all))       the riskiest class gets what rounding left

Weights are whole numbers, and no unit's weights can add up to 2^24: float32 holds each partial sum
exactly, in any order. The other operators work number by number, and IEEE 754 fixes their results.
Features are finite: the guard lets nothing else through, and no divisor is 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.step.builder import GraphBuilder

Float32Array = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
EXACT_FLOAT32 = 2**24
"""float32 holds every whole number up to this one."""
INPUT_MOST = 511
"""Largest magnitude of a quantised input."""
HIDDEN_MOST = 255
"""Largest value of a hidden unit."""
WEIGHT_MOST = 2**15 - 1
"""Largest magnitude of a weight: the C form keeps weights in 16 bits."""
LOGIT_STEPS = 64
"""Steps of a logit in one nat."""
TABLE_LENGTH = 1024
"""Steps in the table of exponentials; a class 16 nats behind the first has no votes."""
EXPONENTIALS = np.round(2.0**16 * np.exp(-np.arange(TABLE_LENGTH) / LOGIT_STEPS))
"""exp(-d / LOGIT_STEPS) in units of 2^-16, for d of 0 .. TABLE_LENGTH - 1.

Whole numbers of at most 2^16, so that float32 adds those of up to 255 classes exactly.
"""
VOTES = 1 << 20
"""Votes of a network that stands alone; in a committee it has as many as the trees."""


@dataclass(frozen=True)
class Layer:
    """weights [I, O] and bias [O]: whole numbers as float32. scale [O]: after the sum.

    A scale need not be whole: it is one product for each number, which IEEE 754 fixes.
    """

    weights: Float32Array
    bias: Float32Array
    scale: Float32Array


@dataclass(frozen=True)
class InputScale:
    """knee, gain and offset [F], which make whole numbers of features. Raises ValueError."""

    knee: Float32Array
    gain: Float32Array
    offset: Float32Array

    def __post_init__(self) -> None:
        if not (self.knee > 0.0).all():
            raise ValueError("a knee is not above 0")

        # |s| is below 1, so |gain s + offset| is at most their sum
        largest = np.abs(self.gain.astype(float)) + np.abs(self.offset)
        if not (largest <= INPUT_MOST).all():
            raise ValueError(f"an input exceeds {INPUT_MOST}")

    def quantised(self, rows: Float32Array) -> Float32Array:
        """q [N, F] of rows [N, F]: whole numbers as float32."""
        squashed = rows / (np.abs(rows) + self.knee)
        scaled = squashed * self.gain + self.offset
        return np.asarray(np.round(scaled), dtype=np.float32)


@dataclass(frozen=True)
class Network:
    """inputs; layers, of which the last gives the logits of K classes.

    votes_in_all: the sum of a row's votes. Raises ValueError for numbers that are not exact.
    """

    inputs: InputScale
    layers: tuple[Layer, ...]
    votes_in_all: int = VOTES

    def __post_init__(self) -> None:
        largest_input = INPUT_MOST
        for layer in self.layers:
            _require_exact(layer, largest_input)
            largest_input = HIDDEN_MOST

        if not 0 < self.votes_in_all < EXACT_FLOAT32:
            raise ValueError("too many votes for float32 to add exactly")

    @property
    def n_features(self) -> int:
        """The number of features, F."""
        return len(self.inputs.knee)

    @property
    def n_classes(self) -> int:
        """The number of classes, K."""
        return len(self.layers[-1].bias)

    @property
    def n_weights(self) -> int:
        return sum(layer.weights.size + layer.bias.size for layer in self.layers)

    @property
    def shared_votes(self) -> int:
        """Votes that shares are taken of: rounding can add less than two a class."""
        return self.votes_in_all - 2 * self.n_classes


def _require_exact(layer: Layer, largest_input: int) -> None:
    """Raise ValueError where a sum of the layer could be inexact in float32."""
    weights = layer.weights.astype(np.float64)
    bias = layer.bias.astype(np.float64)
    whole_weights = (weights == np.round(weights)).all()
    whole_bias = (bias == np.round(bias)).all()
    magnitudes = np.abs(weights)
    too_large = magnitudes.max(initial=0.0) > WEIGHT_MOST
    if not whole_weights or not whole_bias or too_large:
        raise ValueError(f"a weight is not a whole number within +-{WEIGHT_MOST}")

    # magnitudes bound every partial sum, in any order of the terms
    largest_sum = largest_input * magnitudes.sum(axis=0) + np.abs(bias)
    if not (largest_sum < EXACT_FLOAT32).all():
        raise ValueError("a unit's weights are too large for float32 to add exactly")
    if not np.isfinite(layer.scale).all():
        raise ValueError("a scale is not finite")


def network_votes(network: Network, rows: Float32Array) -> IntArray:
    """Votes [N, K] of float32 rows [N, F]: the reference for the exported graph."""
    shares = network_shares(network, rows)
    of_votes = shares * np.float32(network.shared_votes)
    votes = np.floor(of_votes).astype(np.int64)
    # the last class is the riskiest: it gets what rounding left
    votes[:, -1] = network.votes_in_all - votes[:, :-1].sum(axis=1)
    return np.asarray(votes)


def network_shares(network: Network, rows: Float32Array) -> Float32Array:
    """Share [N, K] of every class, in float32 as in the file; a row's shares add up to 1."""
    values = network.inputs.quantised(rows)
    for layer in network.layers[:-1]:
        values = hidden_values(layer, values)

    # The exponential of a library differs between processors; a table and a quotient do not.
    logits = _layer(network.layers[-1], values)
    behind = logits.max(axis=1, keepdims=True) - logits
    place = np.minimum(behind, TABLE_LENGTH - 1).astype(np.int64)
    raised = EXPONENTIALS.astype(np.float32)[place]
    total = raised.sum(axis=1, keepdims=True)
    return np.asarray(raised / total, dtype=np.float32)


def hidden_values(layer: Layer, values: Float32Array) -> Float32Array:
    """h [N, O] of a hidden layer: whole numbers within 0 and HIDDEN_MOST."""
    rounded = _layer(layer, values)
    return np.clip(rounded, np.float32(0.0), np.float32(HIDDEN_MOST))


def _layer(layer: Layer, values: Float32Array) -> Float32Array:
    """round((values W + b) * scale) [N, O], not limited."""
    sums = values @ layer.weights + layer.bias
    return np.asarray(np.round(sums * layer.scale), np.float32)


def add_network(
    graph: GraphBuilder,
    network: Network,
    features: str,
    moved: Float32Array | None = None,
    out: str = "",
) -> str:
    """Add the network; returns votes [B, K] float32 that hold exact integers.

    moved: whole numbers [K, K] that the votes are multiplied by.
    """
    k = network.n_classes
    shares = add_shares(graph, network, features)
    of_votes = graph.node("Mul", shares, np.float32(network.shared_votes))
    votes = graph.node("Floor", of_votes)

    # one product and one sum, both exact, give the last class the rest of the votes:
    # all votes, minus what the others got
    last = np.eye(k, dtype=np.float32)[-1] * np.float32(network.votes_in_all)
    rest = _rest_to_the_last(k)
    if moved is not None:
        last, rest = last @ moved, rest @ moved
    return graph.node("Gemm", votes, rest, last, out=out)


def add_shares(graph: GraphBuilder, network: Network, features: str) -> str:
    """Add the network up to its shares [B, K] float32."""
    values = _add_inputs(graph, network.inputs, features)
    for layer in network.layers[:-1]:
        least = graph.constant(0.0, np.float32)
        most = graph.constant(HIDDEN_MOST, np.float32)
        rounded = _add_layer(graph, layer, values)
        values = graph.node("Clip", rounded, least, most)

    logits = _add_layer(graph, network.layers[-1], values)
    return _add_raised(graph, logits, network.n_classes)


def _add_inputs(graph: GraphBuilder, inputs: InputScale, features: str) -> str:
    """Add q [B, F]; number by number, so a batch equals a single row."""
    # x / (knee + |x|) instead of tanh: IEEE 754 fixes every bit of a quotient
    size = graph.node("Abs", features)
    below = graph.node("Add", size, inputs.knee)
    squashed = graph.node("Div", features, below)
    scaled = graph.node("Mul", squashed, inputs.gain)
    shifted = graph.node("Add", scaled, inputs.offset)
    return graph.node("Round", shifted)


def _add_layer(graph: GraphBuilder, layer: Layer, values: str) -> str:
    """Add round((values W + b) * scale) [B, O]; the product and the sum are exact."""
    total = graph.node("Gemm", values, layer.weights, layer.bias)
    scaled = graph.node("Mul", total, layer.scale)
    return graph.node("Round", scaled)


def _add_raised(graph: GraphBuilder, logits: str, n_classes: int) -> str:
    """exp of the logits behind the first, by a table, as shares of their sum."""
    first = graph.node("ReduceMax", logits, [1], keepdims=1)
    behind = graph.node("Sub", first, logits)

    # a table, because the exponential of a runtime differs between processors
    steps = np.flatnonzero(EXPONENTIALS)
    raised = graph.node(
        "LabelEncoder",
        behind,
        domain="ai.onnx.ml",
        keys_floats=steps.astype(float).tolist(),
        values_floats=EXPONENTIALS[steps].tolist(),
        default_float=0.0,
    )

    # whole numbers up to 2^16 each, so a sum over the classes is exact in any order
    everywhere = np.ones((n_classes, n_classes), np.float32)
    total = graph.node("MatMul", raised, everywhere)
    return graph.node("Div", raised, total)


def _rest_to_the_last(n_classes: int) -> Float32Array:
    """[K, K] that keeps all votes but the last class', and takes them from the last class."""
    matrix = np.eye(n_classes, dtype=np.float32)
    matrix[:, -1] = -1.0
    matrix[-1, -1] = 0.0
    return matrix
