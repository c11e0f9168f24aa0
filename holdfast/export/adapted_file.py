"""An adapted model file: the base file, other decision parameters, a correction, and the way back.

The metadata keep what `undone` needs: the base's own metadata, compressed. The base comes back byte
for byte, which is checked before an adapted file is returned.

Verification of an adapted file: every label and vote equals the reference, all else the base.

Base and adapted file answer the same rows, from the tensor `features` on. The reference takes the
base's own votes, which its export has verified, and corrects them in numpy.
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

from holdfast.core.errors import NotAdapted, VerificationFailed
from holdfast.core.reading import Json, json_of
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
from holdfast.export.network import LOGIT_STEPS, Inputs
from holdfast.export.reference import (
    FloatRows,
    riskier_argmax,
    situation_votes,
    weighted,
)
from holdfast.export.seal import seal, sealed_with
from holdfast.export.spec import StepSpec
from holdfast.export.structure import edge_rows, step_rows
from holdfast.export.verify import cut_learners

BASE_KEY = "holdfast.base"
MOST_BASE_BYTES = 16 << 20
"""Of the base's metadata, unpacked: its card and its golden sequences."""


@dataclass(frozen=True)
class Adaptation:
    """What makes a file one for a person. about: what it is based on, for the card."""

    correction: Correction | None
    decision: DecisionRules
    about: Json


def adapted(base: bytes, adaptation: Adaptation) -> bytes:
    """The sealed file of an adaptation. base: a sealed file that is not adapted.

    Raises VerificationFailed where the base could not be restored byte for byte.
    """
    model = onnx.load_from_string(base)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    card = _card(json.loads(metadata[CARD_KEY]), base, adaptation)
    if adaptation.correction is not None:
        add_correction(model, adaptation.correction)
    onnx.checker.check_model(model, full_check=True)
    del metadata[SEAL_KEY]
    kept = {BASE_KEY: _packed(metadata)}
    data = seal(model, card, StepSpec.from_json(card["spec"]), kept)
    if undone(data) != base:
        raise VerificationFailed(
            "the base file cannot be restored byte for byte",
            cause="it was written by another version of the onnx library",
            next_step="export the base again with this version, then adapt it",
        )
    return data


def _card(card: Json, base: bytes, adaptation: Adaptation) -> Json:
    card["decision"] = adaptation.decision.to_json()
    if adaptation.correction is not None:
        network = adaptation.correction.network
        card["heads"]["situation"]["correction"] = {
            "inputs": network.n_features,
            "steps_per_nat": LOGIT_STEPS,
        }
    card["adaptation"] = {
        "base_sha256": hashlib.sha256(base).hexdigest(),
        **adaptation.about,
    }
    return card


def _packed(metadata: dict[str, str]) -> str:
    """As text; the same metadata always give the same text."""
    content = json.dumps(list(metadata.items()), separators=(",", ":")).encode()
    return base64.b64encode(zlib.compress(content, 9)).decode("ascii")


def is_adapted(data: bytes) -> bool:
    """Whether a sealed file is an adapted one."""
    return any(
        entry.key == BASE_KEY for entry in onnx.load_from_string(data).metadata_props
    )


def undone(data: bytes, where: str | Path = "") -> bytes:
    """The base of an adapted file, byte for byte. Raises NotAdapted."""
    model = onnx.load_from_string(data)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    if BASE_KEY not in metadata:
        raise NotAdapted(
            "this file is not adapted", where=where, next_step="use it as it is"
        )
    try:
        card = json_of(metadata[CARD_KEY])
        if "correction" in card["heads"]["situation"]:
            remove_correction(model)
        base = sealed_with(model, _unpacked(metadata[BASE_KEY]))
        whole = hashlib.sha256(base).hexdigest() == card["adaptation"]["base_sha256"]
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
    unpacking = zlib.decompressobj()
    content = unpacking.decompress(
        base64.b64decode(text, validate=True), MOST_BASE_BYTES
    )
    if not unpacking.eof:
        raise ValueError("too long")
    return {str(key): str(value) for key, value in json_of(content)}


CHUNK, SINGLE_ROWS = 4096, 1_000
OF_THE_VOTES = ("votes", "situation", "p_situation", "p_class", "weight")


@dataclass(frozen=True)
class AdaptedVerification:
    """What was compared, as counts. rows: given and hard ones. changed: labels that differ from
    the base's. samples: of streams."""

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
    """Compare an adapted file with the reference. rows: [N, F] features. Raises
    VerificationFailed."""
    before, after = (
        open_session(cut_learners(onnx.load_from_string(one))) for one in (base, data)
    )
    hard = np.concatenate([rows, _hard_rows(correction, rows)])
    old, new = _answers(before, hard, CHUNK), _answers(after, hard, CHUNK)
    expected = _expected(correction, hard, old["votes"])
    label = _label(card, expected)
    _require(np.array_equal(new["votes"], expected), "votes")
    _require(np.array_equal(new["situation"], label), "labels")
    for name in set(old) - ({*OF_THE_VOTES} if correction else set()):
        _require(old[name].tobytes() == new[name].tobytes(), name)
    chosen = np.random.default_rng(0).choice(
        len(hard), min(SINGLE_ROWS, len(hard)), replace=False
    )
    for name, value in _answers(after, hard[chosen], 1).items():
        _require(
            value.tobytes() == new[name][chosen].tobytes(), f"{name} of single rows"
        )
    samples = _require_same_streams(base, data, card, correction)
    changed = int((new["situation"] != old["situation"])[: len(rows)].sum())
    return AdaptedVerification(len(hard), len(chosen), samples, changed)


def _hard_rows(correction: Correction | None, rows: FloatRows) -> FloatRows:
    edges = edge_rows(rows.shape[1])
    if correction is None:
        return edges
    of_all, n = correction.network.inputs, rows.shape[1]
    inputs = Inputs(of_all.knee[:n], of_all.gain[:n], of_all.offset[:n])
    return np.concatenate([edges, step_rows(inputs, rows, 0)])


def _answers(session: Any, rows: FloatRows, chunk: int) -> Outputs:
    names = [output.name for output in session.get_outputs()]
    parts = [
        session.run(names, {"features": rows[k : k + chunk]})
        for k in range(0, len(rows), chunk)
    ]
    return {
        name: np.concatenate([part[k] for part in parts])
        for k, name in enumerate(names)
    }


def _expected(
    correction: Correction | None, rows: FloatRows, votes: npt.NDArray[Any]
) -> npt.NDArray[np.int64]:
    whole = votes.astype(np.int64)
    return whole if correction is None else corrected_votes(correction, rows, whole)


def _label(card: ModelCard, votes: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    weights = card.raw["heads"]["situation"].get("label_weights")
    given = None if weights is None else tuple(weights)
    return riskier_argmax(weighted(situation_votes(votes), given))


def _require_same_streams(
    base: bytes, data: bytes, card: ModelCard, correction: Correction | None
) -> int:
    """The golden input through both whole steps; returns its length in samples."""
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
    streams = []
    for one in (base, data):
        session = open_session(one)
        names = [out.name for out in session.get_outputs() if out.name != "state_out"]
        streams.append(run_recording(session, values, valid, names))
    old, new = streams
    expected = _expected(correction, old["features"], old["votes"])
    _require(np.array_equal(new["votes"], expected), "votes of a stream")
    for name in set(old) - {*OF_THE_VOTES}:
        _require(old[name].tobytes() == new[name].tobytes(), f"{name} of a stream")
    return len(values)


def _require(same: bool, what: str) -> None:
    if not same:
        raise VerificationFailed(
            f"the adapted file: {what} differ from the reference",
            cause="a runtime that computes differently",
            next_step="report the versions that holdfast doctor prints",
        )
