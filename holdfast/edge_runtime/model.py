"""A model file, opened: it is checked before it answers.

In this order: its seal (model_file.py), its bytes and operators (onnx_bytes.py), its card, whether
inputs and outputs are those of the card, then its golden sequences. The first four come before
onnxruntime opens the file. The seal shows that a file is as it was sealed, not who sealed it: use
model files from people you trust. `holdfast selftest MODEL --deep` looks further.

Golden sequences are answers stored in the file and recomputed every time it is opened. Their input
is made by an integer formula, so that it is the same to the last bit on every machine and never
comes from a recording: a pressed, shaken hand with lost, non-finite and out-of-range samples, from
a zero state. Labels and flags must be equal; float64 within 1e-9, float32 within 1e-6 relative.
"""

from __future__ import annotations

import base64
import ctypes
import gc
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS, BoolArray, FloatArray
from holdfast.core.errors import GoldenMismatch, NotAModel
from holdfast.core.reading import Json, json_of
from holdfast.edge_runtime.graph import Outputs, StepGraph, open_session, run_recording
from holdfast.edge_runtime.model_file import (
    EMPTY,
    GOLDEN_KEY,
    ModelCard,
    check_runtime,
    read_card,
    read_sealed,
    require_own_seal,
)
from holdfast.edge_runtime.onnx_bytes import (
    BOOL,
    DOUBLE,
    FLOAT,
    INT32,
    INT64,
    OnnxModel,
    TensorSpec,
    read_onnx,
)

if TYPE_CHECKING:
    import onnxruntime as ort

LONGEST_REASON = 200
"""Characters of onnxruntime's message, which may be several pages long."""


class Model:
    """A model file that has passed all checks. Raises a ModelError.

    path: a file, or the name of a shipped model.
    """

    def __init__(self, path: str | Path) -> None:
        # before anything is read: a wrong runtime must not even open the file
        check_runtime()
        self.path = Path(path)
        self.card, self.session = _checked(path)
        # only now: what was read and compared is let go where it was checked
        _give_back_memory()

    def stepper(self, outputs: Sequence[str], hands: int = 1) -> StepGraph:
        """The step of B hands, from a fresh state. outputs: those to compute."""
        return StepGraph(self.session, hands, outputs)


def _checked(path: str | Path) -> tuple[ModelCard, ort.InferenceSession]:
    """Card and session of a file that has passed all checks. Raises a ModelError."""
    data = read_sealed(path)
    card, golden = read_model(data, path)[:2]
    try:
        session = open_session(data, arena=False)
        answers = golden_answers(
            session, card.n_channels, card.unit, card.settle_samples
        )
    # onnxruntime raises several unrelated types of its own
    except Exception as error:
        reason = f"{error!s:.{LONGEST_REASON}}"
        raise _refusal(f"onnxruntime cannot run it ({reason})", path) from None

    check_golden(golden, answers, str(path))
    return card, session


def read_model(data: bytes, path: str | Path) -> tuple[ModelCard, Outputs, OnnxModel]:
    """Card, golden sequences and graph of a model file's bytes. Raises NotAModel."""
    try:
        onnx = read_onnx(data)
        require_own_seal(data, onnx.metadata)
    except ValueError as error:
        raise _refusal(str(error), path) from None

    card = read_card(onnx.metadata, path)
    try:
        _require_fit(onnx, card)
    except ValueError as error:
        raise _refusal(str(error), path) from None

    golden = golden_from_json(onnx.metadata.get(GOLDEN_KEY, ""), str(path))
    return card, golden, onnx


def _refusal(what: str, path: str | Path) -> NotAModel:
    """The error for what our exporter never writes."""
    return NotAModel(
        what,
        where=path,
        cause="another program made the file, or altered and sealed it again",
        next_step="export the model again with holdfast export",
    )


def _give_back_memory() -> None:
    """Return freed memory to the system, where libc can: a quarter of the process.

    onnxruntime takes a forest apart node by node, and glibc keeps the freed pieces.
    """
    # the parser of the bytes has left its objects
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


# -- inputs and outputs, by the card

INPUTS = ("sample", "valid", "reset", "state")
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
_HEAD = re.compile(r"p_[a-z0-9_]{1,60}")
MOST_GOLDEN = 1_000_000
"""Numbers of the golden input, which are made one by one; the default model has 4,536."""


def _require_fit(model: OnnxModel, card: ModelCard) -> None:
    """Raise ValueError where inputs and outputs are not those that the card names."""
    taken = {*INPUTS, *ANSWERS, *WEIGHS, EMPTY, "features", "state_out"}
    for name in card.heads:
        # a further head is an output of its own, so its name must be new to the graph
        if name in taken or not _HEAD.fullmatch(name):
            raise ValueError(
                f"its card names a head {name!r}, which cannot be the name of a further probability"
            )

    if model.inputs != _inputs_of(model, card):
        raise ValueError("its inputs are not those that its card names")

    wanted = _outputs_of(model, card)
    if set(model.outputs) != set(wanted):
        found = ", ".join(sorted(model.outputs))[:400]
        named = ", ".join(sorted(wanted))[:400]
        raise ValueError(f"its outputs are {found}, its card names {named}")

    for name, expected in wanted.items():
        if model.outputs[name] != expected:
            raise ValueError(
                f"its output {name} has not the type and shape that its card says"
            )

    steps = golden_length(card.settle_samples)
    if steps * card.n_channels > MOST_GOLDEN:
        raise ValueError(
            f"its golden sequences have {steps} samples of {card.n_channels} channels"
        )


def _inputs_of(model: OnnxModel, card: ModelCard) -> dict[str, TensorSpec]:
    """The inputs of a graph with this card. The number of rows of the state is free."""
    state = model.inputs.get("state", TensorSpec(DOUBLE, ())).shape
    # -1 fits no file, so a wrong shape is refused below
    rows = -1
    if len(state) == 3 and isinstance(state[1], int):
        rows = state[1]
    return {
        "sample": TensorSpec(DOUBLE, ("B", 1, card.n_channels)),
        "valid": TensorSpec(BOOL, ("B", 1, card.n_channels // 3)),
        "reset": TensorSpec(BOOL, ("B", 1, 1)),
        "state": TensorSpec(DOUBLE, ("B", rows, card.n_channels)),
    }


def _outputs_of(model: OnnxModel, card: ModelCard) -> dict[str, TensorSpec]:
    """The outputs of a graph with this card. The number of features is free."""
    features = model.outputs.get("features", TensorSpec(FLOAT, ())).shape
    # -1 fits no file here too
    n_features = -1
    if len(features) == 2 and isinstance(features[1], int):
        n_features = features[1]

    n_classes = len(card.classes)
    wanted = {
        "settled": TensorSpec(BOOL, ("B",)),
        "unknown": TensorSpec(BOOL, ("B",)),
        "usable_sensors": TensorSpec(INT32, ("B",)),
        "detectors": TensorSpec(BOOL, ("B", len(card.detectors))),
        "features": TensorSpec(FLOAT, ("B", n_features)),
        "votes": TensorSpec(FLOAT, ("B", n_classes)),
        "p_situation": TensorSpec(FLOAT, ("B", len(SITUATIONS))),
        "situation": TensorSpec(INT64, ("B",)),
        "state_out": model.inputs["state"],
    }
    if card.has_weight:
        wanted["p_class"] = TensorSpec(FLOAT, ("B", n_classes))
        wanted["weight"] = TensorSpec(BOOL, ("B",))

    if card.decides_by_force:
        wanted[EMPTY] = TensorSpec(BOOL, ("B", 1))

    for name in card.heads:
        wanted[name] = TensorSpec(FLOAT, ("B",))
        wanted[f"votes_{name}"] = TensorSpec(FLOAT, ("B", 2))

    return wanted


# -- golden sequences

TOLERANCE = {np.dtype(np.float64): 1e-9, np.dtype(np.float32): 1e-6}
AMPLITUDE = {"N": 1.0 / 64.0, "uT": 2.0, "count": 8.0}
DTYPES = ("float64", "float32", "int64", "int32", "bool")
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


def golden_from_json(text: str, where: str = "") -> Outputs:
    """The inverse of `golden_to_json`, from the metadata's text. Raises NotAModel."""
    answers: Outputs = {}
    try:
        for name, entry in json_of(text).items():
            # numpy accepts many more names of types than a graph uses
            if entry["dtype"] not in DTYPES:
                raise ValueError(entry["dtype"])
            data = base64.b64decode(entry["data"])
            numbers = np.frombuffer(data, entry["dtype"])
            answers[name] = numbers.reshape(entry["shape"])
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError):
        raise NotAModel(
            "its golden sequences are missing or garbled",
            where=where,
            next_step="export the model again",
        ) from None

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
                cause="this onnxruntime computes differently",
                next_step="install another onnxruntime; holdfast doctor shows the installed one",
            )


def _agree(expected: npt.NDArray[Any], got: npt.NDArray[Any]) -> bool:
    """Whether two arrays are equal, floats within their tolerance. NaN equals nothing."""
    if expected.shape != got.shape:
        return False

    tolerance = TOLERANCE.get(expected.dtype, 0.0)
    if not tolerance:
        return bool(np.array_equal(expected, got))
    return bool(np.allclose(expected, got, rtol=tolerance, atol=tolerance))
