"""The one file that goes onto the hand: its seal, and the card in its metadata.

The SHA-256 in the metadata is that of the file with its own 64 digits zeroed. So it is checked on
the bytes alone, before any parser reads them.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta

from holdfast.core.contract import (
    CLASSES,
    RATES_HZ,
    SITUATIONS,
    FloatArray,
    Json,
    Unit,
    not_learned_of,
)
from holdfast.core.errors import (
    BrokenSeal,
    DataNotFound,
    NotAModel,
    RuntimeRefused,
    command,
)
from holdfast.core.schema import model_path, shipped
from holdfast.edge_runtime.decision import LIMITS, DecisionRules
from holdfast.edge_runtime.preparation import Preparation

if TYPE_CHECKING:
    from holdfast.core.hand_card import HandCard

SEAL_KEY = "holdfast.sha256"
CARD_KEY = "holdfast.card"
GOLDEN_KEY = "holdfast.golden"
FORMAT = 2
"""Format 2: the step takes its sample and state in rows of channels."""
EMPTY = "empty"
"""The output of the contact rule, [B, 1] bool: the state is known, and the hand touches nothing."""
CARD_SUFFIX = ".json"
"""The suffix of the card's file, which stands next to a model file for people to read."""
DIGITS = 64
_MARKER = SEAL_KEY.encode() + b"\x12" + bytes([DIGITS])
"""The seal's key and the length of its value, as protobuf writes them (field 2, 64 bytes)."""

WRONG_RUNTIMES = {
    "1.21.0": "crashes on a Raspberry Pi 4",
    "1.26.0": "mislabels binary forests",
}
Count = Annotated[int, Meta(ge=0, le=10_000)]
"""Of sensors, or of samples to settle: more than any model has, and few enough to load in time."""
Reading = Annotated[float, Meta(ge=sys.float_info.min, le=sys.float_info.max)]
"""In the model's unit."""


class CardSpec(msgspec.Struct, frozen=True):
    """What is read of the step's specification."""

    rate_hz: Annotated[float, Meta(ge=RATES_HZ[0], le=RATES_HZ[1])]
    unit: Unit
    n_sensors: Annotated[int, Meta(ge=1, le=10_000)]
    min_valid_sensors: Count


class ModelCard(msgspec.Struct, frozen=True):
    """The card of a model file, as far as it is read; `raw` is all of it.

    range_limit, normal_floor: in the model's unit; a value that no sensor reads, and the largest
    normal reading of a finger that touches nothing. model_id: the first 12 digits of the file's
    seal. classes: of the main head. heads: the names of the others.
    """

    format: int
    spec: CardSpec
    settle_samples: Count
    gap_samples: Count
    all_heads: dict[str, Json] = msgspec.field(name="heads")
    detectors: tuple[str, ...]
    preparation: Preparation
    decision: DecisionRules
    range_limit: Reading
    normal_floor: Reading
    raw: Json
    model_id: str
    classes: tuple[str, ...] = ()
    heads: tuple[str, ...] = msgspec.field(name="more_heads", default=())

    def __post_init__(self) -> None:
        if self.format != FORMAT:
            raise ValueError(
                f"it has format {self.format}, this version reads {FORMAT}"
            )
        classes = tuple(self.all_heads.get("situation", {}).get("classes", ()))
        if classes not in (CLASSES, SITUATIONS):
            raise ValueError(f"{classes!r:.40}, not the classes of this version")
        if unknown := self.raw["decision"].keys() - LIMITS.keys():
            raise ValueError(
                f"it decides by {sorted(unknown)}, which this version lacks"
            )
        # kept, because each sample asks for them
        fill_in = msgspec.structs.force_setattr
        fill_in(self, "classes", classes)
        fill_in(
            self, "heads", tuple(name for name in self.all_heads if name != "situation")
        )

    @property
    def rate_hz(self) -> float:
        return self.spec.rate_hz

    @property
    def unit(self) -> Unit:
        return self.spec.unit

    @property
    def n_channels(self) -> int:
        """Channels C = 3 x sensors."""
        return 3 * self.spec.n_sensors

    @property
    def min_valid_sensors(self) -> int:
        """Fewer usable sensors than this make the state unknown."""
        return self.spec.min_valid_sensors

    @property
    def not_learned(self) -> dict[str, str]:
        """What the model cannot tell, because its training data lack it -> the reason."""
        return not_learned_of(self.raw)

    @property
    def has_weight(self) -> bool:
        """Whether the model was trained with light and heavy objects."""
        return self.classes == CLASSES

    @property
    def thumb(self) -> tuple[bool, ...] | None:
        """Which sensors press from the thumb's side; None where no hand says so."""
        from holdfast.core.hand_card import hand_or_usual

        hand = hand_or_usual(self.hand, self.spec.n_sensors)
        return None if hand is None else hand.of_thumb

    @property
    def hand(self) -> HandCard | None:
        """The hand card of its training sets, None where they had none. Raises NotAModel."""
        value = self.raw["spec"].get("hand")
        if value is None:
            return None

        # Most models were trained without one, and do not load its reader.
        from holdfast.core.hand_card import hand_from_json

        try:
            return hand_from_json(value)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise NotAModel(
                f"its hand card is wrong: {error!r:.80}",
                next_step="export the model again",
            ) from None

    def filler(self) -> Filler:
        """Writes 0.0 into values [.., C] on each axis that the model's hand does not measure.

        Gives back the same array where all is measured. Raises NotAModel.
        """
        hand = self.hand
        if hand is None or not hand.unmeasured_names:
            return _as_they_are
        from holdfast.core.hand_card import fill_unmeasured

        return partial(fill_unmeasured, hand=hand)


Filler = Callable[[FloatArray], FloatArray]


def _as_they_are(values: FloatArray) -> FloatArray:
    return values


def votes_in_all(head: Mapping[str, Any]) -> int:
    """The sum of a sample's votes, from the card of a head."""
    if "votes" in head:
        return int(head["votes"])
    return int(head["trees"]) << int(head["vote_bits"])


def read_sealed(path: str | Path) -> bytes:
    """The bytes of a model file whose seal holds; NotAModel or BrokenSeal otherwise.

    path: a file, or the name of a shipped model.
    """
    path = model_path(path)
    data = _file_bytes(path)
    start = _seal_at(data)
    if start < 0:
        raise _foreign(data, path)

    # a plain comparison: the digest is no secret
    if _digest(data, start) != data[start : start + DIGITS]:
        raise BrokenSeal(
            "the file is not as it was sealed",
            where=path,
            cause="it was altered, or a copy was cut short",
            next_step="export it or copy it again",
        )

    return data


def _file_bytes(path: Path) -> bytes:
    """The bytes of a file that may be a model. Raises NotAModel, DataNotFound."""
    if path.suffix == CARD_SUFFIX:
        raise NotAModel(
            "this is a model's card, not the model",
            where=path,
            next_step=f"name the model: {path.with_suffix('.onnx')}",
        )

    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise DataNotFound(
            "no such model file",
            where=path,
            next_step=f"export one (holdfast export DIR), or name one of {', '.join(shipped())}",
        ) from None
    except OSError as error:
        next_step = "check the path"
        if (path / "artifact.json").is_file():
            made = path / "holdfast.onnx"
            next_step = f"{command('export', path)} makes its file: give {made}"
        raise NotAModel(
            f"cannot be read ({error.strerror})", where=path, next_step=next_step
        ) from None


def _seal_at(data: bytes) -> int:
    """Where the digits of the seal begin; negative where there are none."""
    # the last one: a card may quote the marker, and protobuf writes metadata last
    at = data.rfind(_MARKER)
    return at + len(_MARKER) if at >= 0 else at


def _digest(data: bytes, start: int) -> bytes:
    """SHA-256 of the file with the digits at `start` zeroed, without a copy of the file."""
    # parts, not a zeroed copy: a file may have half a gigabyte
    whole = memoryview(data)
    made = hashlib.sha256()
    made.update(whole[:start])
    made.update(b"0" * DIGITS)
    made.update(whole[start + DIGITS :])
    return made.hexdigest().encode()


def digest_of(data: bytes) -> str:
    """The seal in the bytes of a model file that `read_sealed` gave."""
    start = _seal_at(data)
    return data[start : start + DIGITS].decode("ascii", "replace")


def _foreign(data: bytes, path: Path) -> NotAModel | BrokenSeal:
    """The error for a file without a seal: what it is instead, as far as its first bytes tell."""
    # the producer, which stands at the beginning of every file of ours
    if b"holdfast" in data[:64]:
        return BrokenSeal(
            "the file ends before its seal",
            where=path,
            cause="a copy was cut short",
            next_step="export it or copy it again",
        )

    kind = "not a sealed Holdfast model"
    if data[:1] == b"\x80":
        kind = "a Python pickle, which Holdfast never reads"
    elif data[:2] == b"PK":
        kind = "a zip archive (skops or numpy), not an ONNX file"
    elif not data:
        kind = "an empty file"

    return NotAModel(
        kind,
        where=path,
        cause="another tool's file, or a training artifact",
        next_step="make one from an artifact folder: holdfast export DIR",
    )


def check_runtime(version: str | None = None) -> None:
    """Raise RuntimeRefused for a version of onnxruntime that is known to answer wrongly.

    version: None for the installed one.
    """
    if version is None:
        import onnxruntime as ort  # here, because a compiled library answers without it

        version = ort.__version__
    if version in WRONG_RUNTIMES:
        raise RuntimeRefused(
            f"onnxruntime {version} {WRONG_RUNTIMES[version]}",
            next_step="install another version of onnxruntime",
        )


def read_card(metadata: Mapping[str, str], path: str | Path = "") -> ModelCard:
    """The card in an opened file's metadata; NotAModel where something is missing or impossible."""
    try:
        raw, digest = json.loads(metadata[CARD_KEY]), metadata[SEAL_KEY]
    except (KeyError, ValueError) as error:
        raise NotAModel(
            f"its metadata are incomplete or wrong: {error}",
            where=path,
            next_step="export the model again",
        ) from None
    return card_of(raw, digest, path)


def card_of(raw: Json, digest: str, path: str | Path = "") -> ModelCard:
    """The card as it stands in a file's metadata, or in model.json of a C form. Raises NotAModel.

    digest: the file's seal.
    """
    try:
        about = {**raw, "raw": raw, "model_id": digest[:12]}
        return msgspec.convert(about, ModelCard)
    except (msgspec.ValidationError, TypeError) as error:
        raise NotAModel(
            f"its metadata are incomplete or wrong: {error}",
            where=path,
            next_step="export the model again with this version",
        ) from None
