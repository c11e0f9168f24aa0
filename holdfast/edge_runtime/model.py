"""A model file, opened: it is checked before it answers.

In this order: its seal (model_file.py), its card, then its golden sequences, whose answers must be
those that the card names. The seal shows that a file is as it was sealed, not who sealed it: use
model files from people you trust.

Golden sequences are answers stored in the file and recomputed every time it is opened. Their input
is made by an integer formula, so that it is the same to the last bit on every machine and never
comes from a recording: a pressed, shaken hand with lost, non-finite and out-of-range samples, from
a zero state. Labels and flags must be equal; float64 within 1e-9, float32 within 1e-6 relative.
"""

from __future__ import annotations

import base64
import ctypes
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    GRASP,
    RISKY_SLIP,
    SAFE_SLIP,
    BoolArray,
    FloatArray,
    IntArray,
    Json,
)
from holdfast.core.errors import GoldenMismatch, NotAModel
from holdfast.edge_runtime.graph import Outputs, StepGraph, open_session, run_recording
from holdfast.edge_runtime.model_file import (
    GOLDEN_KEY,
    ModelCard,
    check_runtime,
    read_card,
    read_sealed,
)

if TYPE_CHECKING:
    import onnxruntime as ort


class Model:
    """A model file that has passed all checks. Raises a ModelError.

    path: a file, or the name of a shipped model. engine: why it is not the C form, for people.
    """

    def __init__(self, path: str | Path) -> None:
        # before anything is read: a wrong runtime must not even open the file
        check_runtime()
        self.path = Path(path)
        self.engine = ""
        self.card, self.session = _checked(path)
        # only now: what was read and compared is let go where it was checked
        _give_back_memory()

    def stepper(self, outputs: Sequence[str], hands: int = 1) -> StepGraph:
        """The step of B hands, from a fresh state. outputs: those to compute."""
        return StepGraph(self.session, hands, outputs)


def _checked(path: str | Path) -> tuple[ModelCard, ort.InferenceSession]:
    """Card and session of a file that has passed all checks. Raises a ModelError."""
    data = read_sealed(path)
    try:
        session = open_session(data, arena=False)
        metadata = session.get_modelmeta().custom_metadata_map
        card = read_card(metadata, path)
        golden = golden_of(metadata, str(path))
        answers = golden_answers(
            session, card.n_channels, card.unit, card.settle_samples
        )
        _require_fit(answers, card)
    except NotAModel:
        raise
    # onnxruntime raises several unrelated types of its own, with pages of text; numpy raises where
    # channels differ
    except Exception as error:
        raise NotAModel(
            f"onnxruntime cannot run it ({error!s:.200})",
            where=path,
            cause="another program made the file, or altered and sealed it again",
            next_step="export the model again with holdfast export",
        ) from None

    check_golden(golden, answers, str(path))
    return card, session


def _give_back_memory() -> None:
    """Return freed memory to the system, where libc can: a quarter of the process.

    onnxruntime takes a forest apart node by node, and glibc keeps the freed pieces.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


# -- outputs, by the card

ANSWERS = (
    "votes",
    "situation",
    "p_situation",
    "detectors",
    "settled",
    "unknown",
    "usable_sensors",
)
WEIGHS = ("p_class", "weight")
"""Outputs that the monitor reads: always (ANSWERS), and where the model knows light and heavy."""


def answer_names(card: ModelCard) -> list[str]:
    """The outputs that answer for a model with this card."""
    weighs = WEIGHS if card.has_weight else ()
    return [*ANSWERS, *card.heads, *weighs]


LABEL = ("situation", "p_situation", "usable_sensors")
"""Outputs that `situations_of` needs."""


def situations_of(out: Outputs, n_sensors: int) -> IntArray:
    """[..] the situations that a hand goes by: the model's, but no safe slip without a sensor.

    out: LABEL. While one of n_sensors is lost, a safe slip of the model is a risky slip or a grasp,
    whichever is more probable, the riskier on a tie: a lost finger must not calm.
    """
    said = out["situation"]
    p_situation = out["p_situation"]
    risky = p_situation[..., RISKY_SLIP] >= p_situation[..., GRASP]
    calms = (said == SAFE_SLIP) & (out["usable_sensors"] < n_sensors)
    found: IntArray = np.where(calms, np.where(risky, RISKY_SLIP, GRASP), said)
    return found


def _require_fit(answers: Outputs, card: ModelCard) -> None:
    """Raise ValueError where the answers [T, ..] are not those that the card names."""
    for name in answer_names(card):
        if name not in answers:
            raise ValueError(f"it has no output {name}, which its card names")

    widths = {"votes": len(card.classes), "detectors": len(card.detectors)}
    for name, width in widths.items():
        if answers[name].shape[1:] != (width,):
            raise ValueError(f"its card names {width} {name}, it has others")


# -- golden sequences

TOLERANCE = {np.dtype(np.float64): 1e-9, np.dtype(np.float32): 1e-6}
AMPLITUDE = {"N": 1.0 / 64.0, "uT": 2.0, "count": 8.0}
SKIPPED = ("features", "state_out")
"""Not stored, because labels, votes and probabilities depend on each of them."""


def golden_length(settle_samples: int) -> int:
    """Samples in the golden input: long enough to settle twice."""
    return 3 * settle_samples + 24


def golden_input(
    n_channels: int, unit: str, settle_samples: int
) -> tuple[FloatArray, BoolArray]:
    """values [T, C] and valid [T, C/3] by formula."""
    length = golden_length(settle_samples)
    numbers = _integers(length * n_channels).reshape(length, n_channels)

    # the fingers close until the history is full, then hold
    samples = np.arange(length)
    ramp = np.minimum(samples, settle_samples)[:, None] * 4
    is_normal = np.arange(n_channels) % 3 == 2
    press = np.where(is_normal, ramp, ramp // 4)

    # quiet for 28 samples, shaken hard for 12
    size = np.where(samples % 40 < 28, 16, 256)
    shake = numbers % size[:, None]
    values = ((press + shake) * AMPLITUDE[unit]).astype(np.float64)
    valid: BoolArray = np.ones((length, n_channels // 3), dtype=np.bool_)

    # every kind of fault, after the model has settled
    valid[settle_samples + 6, 0] = False
    values[settle_samples + 9, 1] = np.nan
    values[settle_samples + 11, 2] = np.inf
    values[settle_samples + 13, 0] = 1e30
    valid[settle_samples + 15 : settle_samples + 40, -1] = False

    return values, valid


def _integers(count: int) -> npt.NDArray[np.int64]:
    """A linear congruential generator (Numerical Recipes' constants): exact on every machine."""
    numbers = np.empty(count, dtype=np.int64)
    state = 12345
    for index in range(count):
        state = (1664525 * state + 1013904223) % 2**32
        numbers[index] = state >> 16
    return numbers


def golden_answers(
    session: ort.InferenceSession, n_channels: int, unit: str, settle_samples: int
) -> Outputs:
    """Every stored output on the golden input."""
    names = [one.name for one in session.get_outputs() if one.name not in SKIPPED]
    values, valid = golden_input(n_channels, unit, settle_samples)
    return run_recording(session, values, valid, names)


def golden_to_json(answers: Outputs) -> Json:
    """Arrays as dtype, shape and base64 of their little-endian bytes."""
    stored: Json = {}
    for name, array in answers.items():
        data = base64.b64encode(np.ascontiguousarray(array).tobytes())
        stored[name] = {
            "dtype": array.dtype.name,
            "shape": list(array.shape),
            "data": data.decode("ascii"),
        }

    return stored


def golden_of(metadata: Mapping[str, str], where: str = "") -> Outputs:
    """The golden answers in a file's metadata. Raises NotAModel."""
    try:
        return golden_from_json(json.loads(metadata[GOLDEN_KEY]))
    except (AttributeError, KeyError, TypeError, ValueError):
        raise NotAModel(
            "its golden sequences are missing or garbled",
            where=where,
            next_step="export the model again",
        ) from None


def golden_from_json(stored: Json) -> Outputs:
    """The inverse of `golden_to_json`. Raises KeyError, TypeError or ValueError."""
    answers: Outputs = {}
    for name, entry in stored.items():
        data = base64.b64decode(entry["data"])
        numbers = np.frombuffer(data, entry["dtype"])
        answers[name] = numbers.reshape(entry["shape"])
    return answers


def check_golden(
    stored: Mapping[str, npt.NDArray[Any]], answers: Outputs, where: str = ""
) -> None:
    """Raise GoldenMismatch that names the first output that is missing or differs."""
    for name in {**answers, **stored}:
        missing = name not in stored or name not in answers
        if missing or not _agree(stored[name], answers[name]):
            raise GoldenMismatch(
                f"output {name!r} differs from the golden sequence stored in the file",
                where=where,
                cause="another onnxruntime, or a compiler that does not follow IEEE 754",
                next_step="holdfast doctor; of a C form: holdfast export MODEL --to c --force",
            )


def _agree(expected: npt.NDArray[Any], got: npt.NDArray[Any]) -> bool:
    """Whether two arrays are equal, floats within their tolerance. NaN equals nothing."""
    if expected.shape != got.shape:
        return False

    tolerance = TOLERANCE.get(expected.dtype, 0.0)
    if not tolerance:
        return bool(np.array_equal(expected, got))
    return bool(np.allclose(expected, got, rtol=tolerance, atol=tolerance))
