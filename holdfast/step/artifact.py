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
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from holdfast.core.contract import Json
from holdfast.core.errors import ArtifactError, CardError
from holdfast.core.schema import read
from holdfast.core.writing import remove, write_whole
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.preparation import Preparation
from holdfast.step.features import feature_count
from holdfast.step.heads import FloatRows, Head, VoteCalibration
from holdfast.step.learner import FOREST_KINDS, Forest, Learner
from holdfast.step.network import InputScale, Layer, Network
from holdfast.step.spec import StepSpec

FORMAT = 1
"""Of the folder; a folder of another format is refused, and its model must be trained again."""
INDEX = "artifact.json"
"""Written last: a folder without it is unfinished."""
ROWS = "rows.npz"
"""Feature rows [N, F] that an export is verified on."""
ALLOWED_TYPES = ("sklearn.tree._tree.Tree",)
"""The only type besides skops' defaults that a forest needs."""


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


LabelWeight = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
"""Of a situation; the largest is far above any useful one."""
LabelWeights = Annotated[
    tuple[LabelWeight, ...], msgspec.Meta(min_length=4, max_length=4)
]


class _Head(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True
):
    """A head in the index. forest, network: names of files; a committee has both.

    calibration: its weights and its bias.
    """

    classes: tuple[str, ...]
    calibration: dict[str, list[Any]]
    forest: str = ""
    network: str = ""
    label_weights: LabelWeights | None = None


class _Index(msgspec.Struct, frozen=True):
    """artifact.json. skops_types: types inside the forests' files, for people to read."""

    format: Literal[1]
    spec: StepSpec
    preparation: Preparation
    decision: DecisionRules
    heads: dict[str, _Head]
    training: Json
    skops_types: list[str]


def write_artifact(folder: str | Path, artifact: Artifact) -> Path:
    """Write the folder; the index is removed first and written last.

    So a folder without an index is unfinished.
    """
    folder = Path(folder)

    # without its index the old artifact is unfinished, so no mixture of both can be read
    remove(folder / INDEX)
    heads = {head.name: _write_head(folder, head) for head in artifact.heads}
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


def _write_head(folder: Path, head: Head) -> Json:
    """Write a head's files; returns its entry in the index."""
    import skops.io  # half a second, which reading figures need not wait for

    forest, network = head.learner.forest, head.learner.network
    entry = _Head(
        classes=head.classes,
        calibration=head.calibration.to_json(),
        forest="" if forest is None else f"{head.name}.skops",
        network="" if network is None else f"{head.name}.npz",
        label_weights=head.label_weights,
    )
    if forest is not None:
        write_whole(folder / entry.forest, skops.io.dumps(forest))
    if network is not None:
        _write_network(folder / entry.network, network)
    written: Json = msgspec.to_builtins(entry)
    return written


def _write_network(path: Path, network: Network) -> None:
    """Write a network as one archive of arrays, its layers numbered from 0."""
    arrays: dict[str, Any] = {**vars(network.inputs)}
    arrays["votes_in_all"] = np.int64(network.votes_in_all)
    for number, layer in enumerate(network.layers):
        for name, values in vars(layer).items():
            arrays[f"{name}{number}"] = values
    _write_arrays(path, arrays)


def _write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an archive of arrays, whole or not at all."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    write_whole(path, buffer.getvalue())


def read_artifact(folder: str | Path) -> Artifact:
    """Read the folder; ArtifactError if it is missing, not ours, of another format, or unsafe."""
    folder = Path(folder)
    try:
        index = read(folder / INDEX, _Index)
        heads = []
        for name, entry in index.heads.items():
            heads.append(_read_head(folder, name, entry))

        artifact = Artifact(
            spec=index.spec,
            preparation=index.preparation,
            decision=index.decision.to_json(),
            heads=heads,
            rows=_read_arrays(folder / ROWS)["rows"],
            training=index.training,
        )
        _require_one_width(artifact)
    except FileNotFoundError as error:
        raise ArtifactError(
            f"no {Path(error.filename).name}",
            where=folder,
            cause="no training wrote to this folder, or it did not finish",
            next_step=f"holdfast train --data FOLDER --out {folder}",
        ) from None
    except (
        CardError,
        KeyError,
        TypeError,
        OSError,
        ValueError,
        EOFError,
        zipfile.BadZipFile,
    ) as error:
        raise ArtifactError(
            f"the artifact is damaged ({error})",
            where=folder,
            next_step="train again into an empty folder",
        ) from None

    return artifact


def _read_arrays(path: Path) -> dict[str, Any]:
    """All arrays of an archive. Raises what numpy raises."""
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)


def _read_head(folder: Path, name: str, entry: _Head) -> Head:
    """A head by its entry in the index. Raises ArtifactError, or what numpy raises."""
    forest = _read_forest(folder / entry.forest) if entry.forest else None
    network = _read_network(folder / entry.network) if entry.network else None
    numbers = entry.calibration
    return Head(
        name=name,
        classes=entry.classes,
        learner=Learner(forest, network),
        calibration=VoteCalibration(
            np.array(numbers["weights"]), np.array(numbers["bias"])
        ),
        label_weights=entry.label_weights,
    )


def _read_forest(path: Path) -> Forest:
    """A forest whose file holds nothing else. Raises FileNotFoundError and ValueError."""
    import skops.io

    try:
        # skops loads no type that is not named: a foreign one could run code
        forest = skops.io.load(path, trusted=list(ALLOWED_TYPES))
    except FileNotFoundError:
        raise
    except Exception as error:  # zipfile, json and skops errors have no common root
        raise ValueError(f"{path.name} is no forest: {error}") from None

    # The types that are allowed make up other estimators too, which have no trees to vote.
    if not isinstance(forest, FOREST_KINDS):
        raise ValueError(f"a {type(forest).__name__} where a forest belongs")
    return forest


def _read_network(path: Path) -> Network:
    """The network of an archive. Raises KeyError or ValueError, or what numpy raises."""
    arrays = _read_arrays(path)
    # layers are numbered from 0 without a gap: the first number that is missing ends them
    layers: list[Layer] = []
    while f"weights{len(layers)}" in arrays:
        names = [f"{what}{len(layers)}" for what in ("weights", "bias", "scale")]
        layers.append(Layer(*(arrays[name] for name in names)))

    inputs = InputScale(arrays["knee"], arrays["gain"], arrays["offset"])
    return Network(inputs, tuple(layers), int(arrays["votes_in_all"]))


def _require_one_width(artifact: Artifact) -> None:
    """Raise ValueError where learners, rows and spec have other numbers of features."""
    widths = {artifact.rows.shape[1], feature_count(artifact.spec)}
    for head in artifact.heads:
        widths.add(head.learner.n_features)
    if len(widths) > 1:
        raise ValueError(f"its parts have {sorted(widths)} features")
