"""Golden sequences: answers stored in a model file, recomputed every time the file is loaded.

The input is made by an integer formula, so that it is the same to the last bit on every machine and
never comes from a recording: a pressed, shaken hand with lost, non-finite and out-of-range samples,
from a zero state. Labels and flags must be equal; float64 within 1e-9, float32 within 1e-6
relative.
"""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import GoldenMismatch, NotAModel
from holdfast.core.reading import Json, json_of
from holdfast.edge_runtime.graph import Outputs, run_recording

if TYPE_CHECKING:
    import onnxruntime as ort

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
    ramp = np.minimum(np.arange(length), settle_samples)[:, None] * 4
    press = np.where(np.arange(n_channels) % 3 == 2, ramp, ramp // 4)
    shake = numbers % np.where(np.arange(length) % 40 < 28, 16, 256)[:, None]
    values = ((press + shake) * AMPLITUDE[unit]).astype(np.float64)
    valid: BoolArray = np.ones((length, n_channels // 3), dtype=np.bool_)
    valid[settle_samples + 6, 0] = False
    values[settle_samples + 9, 1] = np.nan
    values[settle_samples + 11, 2] = np.inf
    values[settle_samples + 13, 0] = 1e30
    valid[settle_samples + 15 : settle_samples + 40, -1] = False
    return values, valid


def _integers(count: int) -> npt.NDArray[np.int64]:
    """A linear congruential generator (Numerical Recipes' constants): exact on every machine."""
    numbers, state = np.empty(count, dtype=np.int64), 12345
    for index in range(count):
        state = (1664525 * state + 1013904223) % 2**32
        numbers[index] = state >> 16
    return numbers


def golden_answers(
    session: ort.InferenceSession, n_channels: int, unit: str, settle_samples: int
) -> Outputs:
    """Every stored output on the golden input."""
    names = [
        output.name for output in session.get_outputs() if output.name not in SKIPPED
    ]
    values, valid = golden_input(n_channels, unit, settle_samples)
    return run_recording(session, values, valid, names)


def golden_to_json(answers: Outputs) -> Json:
    """Arrays as dtype, shape and base64 of their little-endian bytes."""
    return {
        name: {
            "dtype": array.dtype.name,
            "shape": list(array.shape),
            "data": base64.b64encode(np.ascontiguousarray(array).tobytes()).decode(
                "ascii"
            ),
        }
        for name, array in answers.items()
    }


def golden_from_json(text: str, where: str = "") -> Outputs:
    """The inverse of `golden_to_json`, from the metadata's text. Raises NotAModel."""
    try:
        return {
            name: np.frombuffer(
                base64.b64decode(entry["data"]), _dtype(entry["dtype"])
            ).reshape(entry["shape"])
            for name, entry in json_of(text).items()
        }
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError):
        raise NotAModel(
            "its golden sequences are missing or garbled",
            where=where,
            next_step="export the model again",
        ) from None


def _dtype(name: object) -> np.dtype[Any]:
    """One of the types that a graph uses; numpy accepts many more names."""
    if name not in DTYPES:
        raise ValueError(name)
    return np.dtype(str(name))


def check_golden(stored: Outputs, answers: Outputs, where: str = "") -> None:
    """Raise GoldenMismatch that names the first output that is missing or differs."""
    for name in {**answers, **stored}:
        if (
            name not in stored
            or name not in answers
            or not _agree(stored[name], answers[name])
        ):
            raise GoldenMismatch(
                f"output {name!r} differs from the golden sequence stored in the file",
                where=where,
                cause="this onnxruntime computes differently",
                next_step="install another onnxruntime; holdfast doctor shows the installed one",
            )


def _agree(expected: npt.NDArray[Any], got: npt.NDArray[Any]) -> bool:
    if expected.shape != got.shape:
        return False
    tolerance = TOLERANCE.get(expected.dtype, 0.0)
    if not tolerance:
        return bool(np.array_equal(expected, got))
    return bool(np.allclose(expected, got, rtol=tolerance, atol=tolerance))
