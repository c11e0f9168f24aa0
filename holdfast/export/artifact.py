"""The folder between training and export: forests as skops, the rest as JSON and plain arrays.

artifact.json lists everything, including the types inside the skops files; a type that is not in
ALLOWED_TYPES is never loaded. rows.npz holds the feature rows that an export is verified on.

A network as a file of plain arrays (.npz, no pickle).
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.archives import NOT_AN_ARCHIVE, require_modest_archive
from holdfast.core.contract import SITUATIONS
from holdfast.core.errors import ArtifactError, OutputError, TooLarge
from holdfast.core.reading import Json, json_of, text_of
from holdfast.core.writing import remove, write_whole
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.preparation import Preparation, preparation_from_json
from holdfast.export.features import feature_count
from holdfast.export.forest import FOREST_KINDS, Forest
from holdfast.export.heads import MAIN_HEAD, Calibration, Head
from holdfast.export.learner import (
    Committee,
    Learner,
    features_in,
    forest_of,
    network_of,
)
from holdfast.export.network import Inputs, Layer, Network
from holdfast.export.reference import FloatRows
from holdfast.export.spec import StepSpec

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
            for number in range(
                sum(name.startswith("weights") for name in arrays.files)
            )
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
    if not network.layers or {len(network.inputs.gain), len(network.inputs.offset)} != {
        width
    }:
        raise ValueError("a network's inputs and layers are not complete")
    for layer in network.layers:
        if (
            layer.weights.shape != (width, len(layer.bias))
            or layer.scale.shape != layer.bias.shape
        ):
            raise ValueError("a network's layers do not fit each other")
        width = len(layer.bias)


FORMAT = 1
INDEX = "artifact.json"
ROWS = "rows.npz"
MOST_LABEL_WEIGHT = 1e6
ALLOWED_TYPES = ("sklearn.tree._tree.Tree",)
"""The only type besides skops' own defaults that a forest needs."""


@dataclass(frozen=True)
class Artifact:
    """The input of export, written by training.

    rows: [N, F] float32 feature rows to verify on. decision: integer parameters of decision.py.
    training: the origin of the model for its card (data, seed, versions, caveat).
    """

    spec: StepSpec
    preparation: Preparation
    decision: dict[str, int]
    heads: list[Head]
    rows: FloatRows
    training: Json


def require_no_artifact(folder: Path) -> None:
    """Raise OutputError for a folder that holds a complete artifact, which would be replaced."""
    if (folder / INDEX).exists():
        raise OutputError(
            "holds an artifact already",
            where=folder,
            cause="an earlier training",
            next_step="name a new folder with --out, or add --force to replace it",
        )


def write_artifact(folder: str | Path, artifact: Artifact) -> Path:
    """Write the folder; the index is removed first and written last.

    So a folder without an index is unfinished.
    """
    folder = Path(folder)
    remove(folder / INDEX)
    heads: dict[str, Any] = {}
    for head in artifact.heads:
        heads[head.name] = {
            "classes": list(head.classes),
            **_write_learner(folder, head),
            "calibration": head.calibration.to_json(),
        }
        if head.label_weights is not None:
            heads[head.name]["label_weights"] = list(head.label_weights)
    buffer = io.BytesIO()
    np.savez(buffer, rows=artifact.rows)
    write_whole(folder / ROWS, buffer.getvalue())
    index = {
        "format": FORMAT,
        "spec": artifact.spec.to_json(),
        "preparation": artifact.preparation.to_json(),
        "decision": artifact.decision,
        "heads": heads,
        "skops_types": list(ALLOWED_TYPES),
        "training": artifact.training,
    }
    return write_whole(folder / INDEX, json.dumps(index, indent=2) + "\n")


def _write_learner(folder: Path, head: Head) -> dict[str, str]:
    """Write a head's files; returns their names by what they hold."""
    import skops.io  # half a second, which reading figures need not wait for

    names = {}
    forest, network = forest_of(head.learner), network_of(head.learner)
    if forest is not None:
        names["forest"] = f"{head.name}.skops"
        write_whole(folder / names["forest"], skops.io.dumps(forest))
    if network is not None:
        names["network"] = f"{head.name}.npz"
        write_network(folder / names["network"], network)
    return names


def read_artifact(folder: str | Path) -> Artifact:
    """Read the folder; ArtifactError if it is missing, not ours, of another format, or unsafe."""
    folder = Path(folder)
    index = _read_index(folder)
    try:
        heads = [
            _read_head(folder, name, entry) for name, entry in index["heads"].items()
        ]
        require_modest_archive(folder / ROWS)
        with np.load(folder / ROWS, allow_pickle=False) as arrays:
            rows = arrays["rows"]
        artifact = Artifact(
            spec=StepSpec.from_json(index["spec"]),
            preparation=preparation_from_json(index["preparation"]),
            decision=DecisionRules(**index["decision"]).to_json(),
            heads=heads,
            rows=rows,
            training=index["training"],
        )
        _require_that_parts_fit(artifact)
        return artifact
    except TooLarge as error:
        raise ArtifactError(
            error.what, where=error.where, next_step="train again into an empty folder"
        ) from None
    except (KeyError, *NOT_AN_ARCHIVE) as error:
        raise ArtifactError(
            f"the artifact is damaged ({error})",
            where=folder,
            next_step="train again into an empty folder",
        ) from None


def _require_that_parts_fit(artifact: Artifact) -> None:
    """Raise ValueError where forests, rows and spec do not fit each other."""
    width = feature_count(artifact.spec)
    if artifact.rows.shape[1:] != (width,):
        raise ValueError(f"rows of shape {artifact.rows.shape} for {width} features")
    if MAIN_HEAD not in [head.name for head in artifact.heads]:
        raise ValueError(f"no head {MAIN_HEAD}")
    for head in artifact.heads:
        k = len(head.classes)
        shapes = head.calibration.weights.shape, head.calibration.bias.shape
        if (
            features_in(head.learner) != width
            or shapes != ((k, k), (k,))
            or not _votes_for(head.learner, k)
        ):
            raise ValueError(f"head {head.name} does not fit the spec or its classes")
        if head.label_weights is not None:
            _require_label_weights(head)


def _votes_for(learner: Learner, n_classes: int) -> bool:
    """Whether a learner votes for these classes and no others."""
    forest, network = forest_of(learner), network_of(learner)
    return (
        forest is None or bool(np.isin(forest.classes_, range(n_classes)).all())
    ) and (network is None or network.n_classes == n_classes)


def _require_label_weights(head: Head) -> None:
    weights = np.asarray(head.label_weights, dtype=np.float64)
    if (
        head.name != MAIN_HEAD
        or weights.shape != (len(SITUATIONS),)
        or not ((weights > 0.0) & (weights <= MOST_LABEL_WEIGHT)).all()
    ):
        raise ValueError(
            f"head {head.name} has label weights that are no weights of situations"
        )


def _read_index(folder: Path) -> Mapping[str, Any]:
    try:
        index = json_of(text_of(folder / INDEX))
    except (OSError, ValueError, TooLarge):
        raise ArtifactError(
            f"no readable {INDEX}",
            where=folder,
            cause="no training wrote to this folder, or it did not finish",
            next_step=f"holdfast train --data FOLDER --out {folder}",
        ) from None
    if not isinstance(index, dict) or index.get("format") != FORMAT:
        raise ArtifactError(
            "another format of artifact",
            where=folder / INDEX,
            next_step="train again with this version",
        )
    return index


def _read_head(folder: Path, name: str, entry: Mapping[str, Any]) -> Head:
    calibration = Calibration(
        np.array(entry["calibration"]["weights"]),
        np.array(entry["calibration"]["bias"]),
    )
    forest = _load_forest(folder / entry["forest"]) if "forest" in entry else None
    network = read_network(folder / entry["network"]) if "network" in entry else None
    weights = entry.get("label_weights")
    return Head(
        name,
        tuple(entry["classes"]),
        _joined(forest, network),
        calibration,
        None if weights is None else tuple(float(weight) for weight in weights),
    )


def _joined(forest: Forest | None, network: Network | None) -> Learner:
    """The learner of a head's files. Raises KeyError without any."""
    if forest is not None and network is not None:
        return Committee(forest, network)
    one = forest if forest is not None else network
    if one is None:
        raise KeyError("forest")
    return one


def _load_forest(path: Path) -> Forest:
    import skops.io

    try:
        require_modest_archive(path)
        types = skops.io.get_untrusted_types(file=path)
        foreign = sorted(set(types) - set(ALLOWED_TYPES))
        if foreign:
            raise ArtifactError(
                f"it has types that do not belong in a forest: {', '.join(foreign)}",
                where=path,
                cause="a file from elsewhere",
                next_step="train again; never load such a file",
            )
        forest = skops.io.load(path, trusted=list(ALLOWED_TYPES))
    except (ArtifactError, TooLarge):
        raise
    except Exception as error:  # zipfile, json and skops errors have no common root
        raise ArtifactError(
            f"not a readable skops file ({type(error).__name__})",
            where=path,
            next_step="train again",
        ) from None
    if not isinstance(forest, FOREST_KINDS):
        raise ArtifactError(
            f"a {type(forest).__name__} where a forest belongs",
            where=path,
            next_step="train again",
        )
    return forest
