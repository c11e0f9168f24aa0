"""An adapted model file: the base file, other decision parameters, a correction, and the way back.

The metadata keep what `undone` needs: the base's metadata, compressed. The base comes back byte for
byte, which is checked before an adapted file is returned.

Verification: base and adapted file answer the same rows, from the tensor `features` on. The
reference takes the base's votes, which its export has verified, and corrects them in numpy. Every
label and vote must equal the reference, every other output the base's.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx

from holdfast.core.contract import Json
from holdfast.core.errors import NotAdapted, VerificationFailed
from holdfast.core.schema import json_of
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.graph import Outputs, open_session, run_recording
from holdfast.edge_runtime.model import golden_input
from holdfast.edge_runtime.model_file import CARD_KEY, SEAL_KEY, ModelCard
from holdfast.export.correction import (
    Correction,
    add_correction,
    corrected_votes,
    remove_correction,
)
from holdfast.export.exporting import seal, sealed_with
from holdfast.export.heads import FloatRows, riskier_argmax, situation_votes, weighted
from holdfast.export.network import LOGIT_STEPS, Inputs, IntArray
from holdfast.export.spec import StepSpec
from holdfast.export.structure import edge_rows, step_rows
from holdfast.export.verify import (
    CHUNK,
    REPORT_VERSIONS,
    cut_learners,
    require_single_rows_equal,
    run_rows,
)

BASE_KEY = "holdfast.base"
"""The entry of the metadata that holds those of the base."""
MOST_BASE_BYTES = 16 << 20
"""Of the base's metadata, unpacked: its card and its golden sequences."""
SINGLE_ROWS = 1_000
"""Rows that are computed alone and in a batch: one call a row is slow."""
OF_THE_VOTES = {"votes", "situation", "p_situation", "p_class", "weight"}
"""Outputs that a correction changes."""


@dataclass(frozen=True)
class Adaptation:
    """What makes a file one for a person. about: what it is based on, for the card.

    correction: None where only the decision is another. decision: replaces that of the base.
    """

    correction: Correction | None
    decision: DecisionRules
    about: Json


def adapted(base: bytes, adaptation: Adaptation) -> bytes:
    """The sealed file of an adaptation. base: a sealed file that is not adapted.

    Raises VerificationFailed where the base could not be restored byte for byte.
    """
    model = onnx.load_from_string(base)
    metadata = metadata_of(model)
    card = _card(json_of(metadata[CARD_KEY]), base, adaptation)
    if adaptation.correction is not None:
        add_correction(model, adaptation.correction)

    onnx.checker.check_model(model, full_check=True)
    # the seal is computed again when the base is restored
    del metadata[SEAL_KEY]
    kept = {BASE_KEY: _packed(metadata)}
    data = seal(model, card, StepSpec.from_json(card["spec"]), kept)

    # a person must be able to go back, so a file that cannot is not returned
    if undone(data) != base:
        raise VerificationFailed(
            "the base file cannot be restored byte for byte",
            cause="it was written by another version of the onnx library",
            next_step="export the base again with this version, then adapt it",
        )
    return data


def metadata_of(model: onnx.ModelProto) -> dict[str, str]:
    """In the order of the file, on which its bytes depend."""
    return {entry.key: entry.value for entry in model.metadata_props}


def _card(card: Json, base: bytes, adaptation: Adaptation) -> Json:
    """The base's card, changed to that of the adapted file."""
    card["decision"] = adaptation.decision.to_json()
    if adaptation.correction is not None:
        card["heads"]["situation"]["correction"] = {
            "inputs": adaptation.correction.network.n_features,
            "steps_per_nat": LOGIT_STEPS,
        }

    digest = hashlib.sha256(base).hexdigest()
    card["adaptation"] = {"base_sha256": digest, **adaptation.about}
    return card


def _packed(metadata: dict[str, str]) -> str:
    """As text; the same metadata always give the same text."""
    pairs = list(metadata.items())
    content = json.dumps(pairs, separators=(",", ":")).encode()
    # metadata of ONNX are strings, so the compressed bytes are written as letters
    compressed = zlib.compress(content, 9)
    return base64.b64encode(compressed).decode("ascii")


def is_adapted(data: bytes) -> bool:
    """Whether a sealed file is an adapted one."""
    return BASE_KEY in metadata_of(onnx.load_from_string(data))


def undone(data: bytes, where: str | Path = "") -> bytes:
    """The base of an adapted file, byte for byte. Raises NotAdapted."""
    model = onnx.load_from_string(data)
    metadata = metadata_of(model)
    if BASE_KEY not in metadata:
        raise NotAdapted(
            "this file is not adapted", where=where, next_step="use it as it is"
        )

    # what was packed into the file comes from outside: it may be anything
    try:
        card = json_of(metadata[CARD_KEY])
        if "correction" in card["heads"]["situation"]:
            remove_correction(model)
        base = sealed_with(model, _unpacked(metadata[BASE_KEY]))
        digest = hashlib.sha256(base).hexdigest()
        # The card names the digest of the base, so a base that differs in one byte is refused.
        whole = digest == card["adaptation"]["base_sha256"]
    except (KeyError, TypeError, ValueError, zlib.error, binascii.Error):
        whole = False

    if not whole:
        raise NotAdapted(
            "the base file in it cannot be restored",
            where=where,
            cause="the file was altered, or another version of the onnx library wrote it",
            next_step="use your copy of the base file",
        )

    return base


def _unpacked(text: str) -> dict[str, str]:
    """Raises ValueError for what `_packed` does not write, or for too much of it."""
    compressed = base64.b64decode(text, validate=True)
    unpacking = zlib.decompressobj()
    # a limit, because a small file can hold gigabytes of zeros
    content = unpacking.decompress(compressed, MOST_BASE_BYTES)
    if not unpacking.eof:
        raise ValueError("too long")
    return {str(key): str(value) for key, value in json_of(content)}


@dataclass(frozen=True)
class AdaptedVerification:
    """What was compared, as counts.

    rows: given and hard ones. single_rows: computed alone and in a batch. samples: of streams.
    changed: labels of given rows that differ from the base's.
    """

    rows: int
    single_rows: int
    samples: int
    changed: int


def verify_adapted(
    base: bytes,
    data: bytes,
    card: ModelCard,
    correction: Correction | None,
    rows: FloatRows,
) -> AdaptedVerification:
    """Compare an adapted file with the reference. Raises VerificationFailed.

    rows: [N, F] features.
    """
    hard = np.concatenate([rows, _hard_rows(correction, rows)])
    old = run_rows(_learners(base), hard, CHUNK)
    session = _learners(data)
    new = run_rows(session, hard, CHUNK)
    _require_reference(old, new, hard, correction, "")

    label = _label(card, new["votes"].astype(np.int64))
    _require(np.array_equal(new["situation"], label), "labels")
    n_single = require_single_rows_equal(session, hard, new, SINGLE_ROWS, seed=0)
    samples = _require_same_streams(base, data, card, correction)

    # only given rows: hard ones are no samples that a person could make
    changed = new["situation"][: len(rows)] != old["situation"][: len(rows)]
    return AdaptedVerification(len(hard), n_single, samples, int(changed.sum()))


def _learners(data: bytes) -> Any:
    """A session of a file's graph from the features on."""
    model = onnx.load_from_string(data)
    return open_session(cut_learners(model))


def _hard_rows(correction: Correction | None, rows: FloatRows) -> FloatRows:
    """Rows at the edges of float32, and on the steps of a correction's inputs."""
    n = rows.shape[1]
    edges = edge_rows(n)
    if correction is None:
        return edges

    # of the correction's inputs, the first n are the features
    # Magnitudes and votes follow from the features, so only features can be moved to a step.
    inputs = correction.network.inputs
    features = Inputs(inputs.knee[:n], inputs.gain[:n], inputs.offset[:n])
    return np.concatenate([edges, step_rows(features, rows, 0)])


def _require_reference(
    old: Outputs,
    new: Outputs,
    rows: npt.NDArray[np.float32],
    correction: Correction | None,
    where: str,
) -> None:
    """Votes are the base's, corrected; what does not follow from votes is the base's."""
    expected: IntArray = old["votes"].astype(np.int64)
    changed: set[str] = set()
    if correction is not None:
        expected = corrected_votes(correction, rows, expected)
        changed = OF_THE_VOTES

    _require(np.array_equal(new["votes"], expected), f"votes{where}")
    for name in set(old) - changed:
        same = old[name].tobytes() == new[name].tobytes()
        _require(same, f"{name}{where}")


def _label(card: ModelCard, votes: IntArray) -> IntArray:
    """The situation that these votes stand for, by the label weights of the card."""
    weights = card.raw["heads"]["situation"].get("label_weights")
    given = None if weights is None else tuple(weights)
    return riskier_argmax(weighted(situation_votes(votes), given))


def _require_same_streams(
    base: bytes, data: bytes, card: ModelCard, correction: Correction | None
) -> int:
    """The golden input through both whole steps; returns its length in samples."""
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
    streams = []

    for file in (base, data):
        session = open_session(file)
        names = [output.name for output in session.get_outputs()]
        names.remove("state_out")
        streams.append(run_recording(session, values, valid, names))

    old, new = streams
    _require_reference(old, new, old["features"], correction, " of a stream")
    return len(values)


def _require(same: bool, what: str) -> None:
    """Raise VerificationFailed unless something is the same."""
    if not same:
        raise VerificationFailed(
            f"the adapted file: {what} differ from the reference",
            cause="a runtime that computes differently",
            next_step=REPORT_VERSIONS,
        )
