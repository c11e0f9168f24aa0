"""An adapted model file: the base file, other decision parameters, a correction, and the way back.

The metadata keep what `undone` needs: the base's own metadata, compressed. The base comes back byte
for byte, which is checked before an adapted file is returned.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import zlib
from dataclasses import dataclass
from pathlib import Path

import onnx

from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.errors import NotAdapted, VerificationFailed
from holdfast.edge_runtime.model_file import CARD_KEY, SEAL_KEY
from holdfast.edge_runtime.reading import Json, json_of
from holdfast.export.correction import Correction, add_correction, remove_correction
from holdfast.export.network import LOGIT_STEPS
from holdfast.export.seal import seal, sealed_with
from holdfast.export.spec import StepSpec

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
    card["adaptation"] = {"base_sha256": hashlib.sha256(base).hexdigest(), **adaptation.about}
    return card


def _packed(metadata: dict[str, str]) -> str:
    """As text; the same metadata always give the same text."""
    content = json.dumps(list(metadata.items()), separators=(",", ":")).encode()
    return base64.b64encode(zlib.compress(content, 9)).decode("ascii")


def is_adapted(data: bytes) -> bool:
    """Whether a sealed file is an adapted one."""
    return any(entry.key == BASE_KEY for entry in onnx.load_from_string(data).metadata_props)


def undone(data: bytes, where: str | Path = "") -> bytes:
    """The base of an adapted file, byte for byte. Raises NotAdapted."""
    model = onnx.load_from_string(data)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    if BASE_KEY not in metadata:
        raise NotAdapted("this file is not adapted", where=where, next_step="use it as it is")
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
    content = unpacking.decompress(base64.b64decode(text, validate=True), MOST_BASE_BYTES)
    if not unpacking.eof:
        raise ValueError("too long")
    return {str(key): str(value) for key, value in json_of(content)}
