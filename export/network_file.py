"""A network as a file of plain arrays (.npz, no pickle)."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from holdfast.edge_runtime.archives import require_modest_archive
from holdfast.edge_runtime.writing import write_whole
from holdfast.export.network import Inputs, Layer, Network

INPUTS, LAYER = ("knee", "gain", "offset"), ("weights", "bias", "scale")


def write_network(path: Path, network: Network) -> None:
    """Write it whole."""
    arrays = {name: getattr(network.inputs, name) for name in INPUTS}
    for number, layer in enumerate(network.layers):
        arrays |= {f"{name}{number}": getattr(layer, name) for name in LAYER}
    buffer = io.BytesIO()
    np.savez(buffer, votes_in_all=np.int64(network.votes_in_all), **arrays)
    write_whole(path, buffer.getvalue())


def read_network(path: Path) -> Network:
    """Read it. Raises TooLarge, KeyError or ValueError, or what NOT_AN_ARCHIVE names."""
    require_modest_archive(path)
    with np.load(path, allow_pickle=False) as arrays:
        layers = [
            Layer(*(_float32(arrays[f"{name}{number}"]) for name in LAYER))
            for number in range(sum(name.startswith("weights") for name in arrays.files))
        ]
        inputs = Inputs(*(_float32(arrays[name]) for name in INPUTS))
        network = Network(inputs, tuple(layers), int(arrays["votes_in_all"]))
    _require_chain(network)
    return network


def _float32(array: np.ndarray) -> np.ndarray:
    if array.dtype != np.float32 or not np.isfinite(array).all():
        raise ValueError("a network's numbers are not finite float32")
    return array


def _require_chain(network: Network) -> None:
    """Raise ValueError where one layer does not follow the other."""
    width = network.n_features
    if not network.layers or {len(network.inputs.gain), len(network.inputs.offset)} != {width}:
        raise ValueError("a network's inputs and layers are not complete")
    for layer in network.layers:
        if layer.weights.shape != (width, len(layer.bias)) or layer.scale.shape != layer.bias.shape:
            raise ValueError("a network's layers do not fit each other")
        width = len(layer.bias)
