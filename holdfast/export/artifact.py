"""The folder between training and export: forests as skops, the rest as JSON and plain arrays.

artifact.json lists everything, including the types inside the skops files; a type that is not in
ALLOWED_TYPES is never loaded. rows.npz holds the feature rows that an export is verified on. A
network is a file of plain arrays (.npz, no pickle).
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import SITUATIONS, Json
from holdfast.core.errors import ArtifactError, OutputError
from holdfast.core.schema import json_of, text_of
from holdfast.core.writing import remove, write_whole
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.preparation import Preparation, preparation_from_json
from holdfast.export.features import feature_count
from holdfast.export.heads import MAIN_HEAD, Calibration, FloatRows, Head
from holdfast.export.learner import (
    FOREST_KINDS,
    Committee,
    Forest,
    Learner,
    features_in,
    forest_of,
    network_of,
)
from holdfast.export.network import Float32Array, Inputs, Layer, Network
from holdfast.export.spec import StepSpec

FORMAT = 1
"""Of the folder; a folder of another format is refused, and its model must be trained again."""
INDEX = "artifact.json"
"""Written last: a folder without it is unfinished."""
ROWS = "rows.npz"
"""Feature rows [N, F] that an export is verified on."""
MOST_LABEL_WEIGHT = 1e6
"""Far above any useful weight."""
ALLOWED_TYPES = ("sklearn.tree._tree.Tree",)
"""The only type besides skops' defaults that a forest needs."""
EMPTY_FOLDER = "train again into an empty folder"


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

    # without its index the old artifact is unfinished, so no mixture of both can be read
    remove(folder / INDEX)
    heads: dict[str, Any] = {}

    for head in artifact.heads:
        entry: dict[str, Any] = {"classes": list(head.classes)}
        entry |= _write_learner(folder, head)
        entry["calibration"] = head.calibration.to_json()
        if head.label_weights is not None:
            entry["label_weights"] = list(head.label_weights)
        heads[head.name] = entry

    _write_arrays(folder / ROWS, {"rows": artifact.rows})
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
    """Write a head's files; returns their names, for the index."""
    import skops.io  # half a second, which reading figures need not wait for

    names = {}
    forest = forest_of(head.learner)
    network = network_of(head.learner)

    if forest is not None:
        names["forest"] = f"{head.name}.skops"
        content = skops.io.dumps(forest)
        write_whole(folder / names["forest"], content)
    if network is not None:
        names["network"] = f"{head.name}.npz"
        _write_network(folder / names["network"], network)

    return names


def _write_network(path: Path, network: Network) -> None:
    """Write a network as one archive of arrays, its layers numbered from 0."""
    inputs = network.inputs
    arrays: dict[str, Any] = {
        "votes_in_all": np.int64(network.votes_in_all),
        "knee": inputs.knee,
        "gain": inputs.gain,
        "offset": inputs.offset,
    }
    for number, layer in enumerate(network.layers):
        arrays[f"weights{number}"] = layer.weights
        arrays[f"bias{number}"] = layer.bias
        arrays[f"scale{number}"] = layer.scale

    _write_arrays(path, arrays)


def _write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an archive of arrays, whole or not at all."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    write_whole(path, buffer.getvalue())


def read_artifact(folder: str | Path) -> Artifact:
    """Read the folder; ArtifactError if it is missing, not ours, of another format, or unsafe."""
    folder = Path(folder)
    index = _read_index(folder)
    try:
        heads = []
        for name, entry in index["heads"].items():
            heads.append(_read_head(folder, name, entry))

        # building the rules checks them
        rules = DecisionRules(**index["decision"])
        rows = _read_arrays(folder / ROWS)["rows"]
        artifact = Artifact(
            spec=StepSpec.from_json(index["spec"]),
            preparation=preparation_from_json(index["preparation"]),
            decision=rules.to_json(),
            heads=heads,
            rows=rows,
            training=index["training"],
        )
        _require_that_parts_fit(artifact)
    except (
        KeyError,
        TypeError,
        OSError,
        ValueError,
        EOFError,
        zipfile.BadZipFile,
    ) as error:
        raise ArtifactError(
            f"the artifact is damaged ({error})", where=folder, next_step=EMPTY_FOLDER
        ) from None

    return artifact


def _read_arrays(path: Path) -> dict[str, Any]:
    """All arrays of an archive. Raises what numpy raises."""
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)


def _read_index(folder: Path) -> Mapping[str, Any]:
    """artifact.json. Raises ArtifactError where it is missing or of another format."""
    try:
        index = json_of(text_of(folder / INDEX))
    except (OSError, ValueError):
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
    """A head by its entry in the index. Raises KeyError for an entry that is not complete."""
    numbers = entry["calibration"]
    calibration = Calibration(np.array(numbers["weights"]), np.array(numbers["bias"]))

    label_weights = None
    if entry.get("label_weights") is not None:
        label_weights = tuple(map(float, entry["label_weights"]))

    return Head(
        name=name,
        classes=tuple(entry["classes"]),
        learner=_read_learner(folder, entry),
        calibration=calibration,
        label_weights=label_weights,
    )


def _read_learner(folder: Path, entry: Mapping[str, Any]) -> Learner:
    """The learner of a head's files. Raises KeyError without any."""
    if "network" not in entry:
        return _read_forest(folder / entry["forest"])
    network = _read_network(folder / entry["network"])
    if "forest" not in entry:
        return network
    return Committee(_read_forest(folder / entry["forest"]), network)


def _read_forest(path: Path) -> Forest:
    """A forest whose file holds nothing else. Raises ArtifactError."""
    import skops.io

    try:
        # a foreign type could run code when it is loaded, so the types are read first
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
    except ArtifactError:
        raise
    except Exception as error:  # zipfile, json and skops errors have no common root
        raise ArtifactError(
            f"not a readable skops file ({type(error).__name__})",
            where=path,
            next_step="train again",
        ) from None

    # The types that are allowed make up other estimators too, which have no trees to vote.
    if not isinstance(forest, FOREST_KINDS):
        raise ArtifactError(
            f"a {type(forest).__name__} where a forest belongs",
            where=path,
            next_step="train again",
        )
    return forest


def _read_network(path: Path) -> Network:
    """The network of an archive.

    Raises KeyError or ValueError, or what numpy raises.
    """
    arrays = _read_arrays(path)
    votes_in_all = int(arrays.pop("votes_in_all"))

    for array in arrays.values():
        _require_finite_float32(array)

    # Layers are numbered from 0 without a gap: the first number that is missing ends them.
    layers: list[Layer] = []
    while f"weights{len(layers)}" in arrays:
        number = len(layers)
        layer = Layer(
            weights=arrays[f"weights{number}"],
            bias=arrays[f"bias{number}"],
            scale=arrays[f"scale{number}"],
        )
        layers.append(layer)

    inputs = Inputs(arrays["knee"], arrays["gain"], arrays["offset"])
    network = Network(inputs, tuple(layers), votes_in_all)
    _require_chain(network)
    return network


def _require_finite_float32(array: Float32Array) -> None:
    """Raise ValueError; NaN would pass the checks of a network's sums."""
    if array.dtype != np.float32 or not np.isfinite(array).all():
        raise ValueError("a network's numbers are not finite float32")


def _require_chain(network: Network) -> None:
    """Raise ValueError where one layer does not follow the other."""
    inputs = network.inputs
    width = network.n_features
    complete = len(inputs.gain) == len(inputs.offset) == width
    if not network.layers or not complete:
        raise ValueError("a network's inputs and layers are not complete")

    for layer in network.layers:
        n_out = len(layer.bias)
        if layer.weights.shape != (width, n_out) or layer.scale.shape != (n_out,):
            raise ValueError("a network's layers do not fit each other")
        width = n_out


def _require_that_parts_fit(artifact: Artifact) -> None:
    """Raise ValueError where learners, rows and spec do not fit each other."""
    width = feature_count(artifact.spec)
    if artifact.rows.shape[1:] != (width,):
        raise ValueError(f"rows of shape {artifact.rows.shape} for {width} features")
    if MAIN_HEAD not in [head.name for head in artifact.heads]:
        raise ValueError(f"no head {MAIN_HEAD}")

    for head in artifact.heads:
        k = len(head.classes)
        calibration = head.calibration
        is_calibrated = calibration.weights.shape == (k, k)
        is_calibrated &= calibration.bias.shape == (k,)
        fits = features_in(head.learner) == width and _votes_for(head.learner, k)
        if not fits or not is_calibrated:
            raise ValueError(f"head {head.name} does not fit the spec or its classes")
        if head.label_weights is not None:
            _require_label_weights(head)


def _votes_for(learner: Learner, n_classes: int) -> bool:
    """Whether a learner votes for these classes and no others."""
    forest = forest_of(learner)
    network = network_of(learner)
    if forest is not None and not np.isin(forest.classes_, range(n_classes)).all():
        return False
    return network is None or network.n_classes == n_classes


def _require_label_weights(head: Head) -> None:
    """Raise ValueError unless the main head has one positive weight for each situation."""
    weights = np.asarray(head.label_weights, dtype=np.float64)
    of_situations = head.name == MAIN_HEAD and weights.shape == (len(SITUATIONS),)
    in_range = (weights > 0.0) & (weights <= MOST_LABEL_WEIGHT)
    if not of_situations or not in_range.all():
        raise ValueError(
            f"head {head.name} has label weights that are no weights of situations"
        )
