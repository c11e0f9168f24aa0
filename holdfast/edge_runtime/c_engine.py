"""A model's compiled C form as its engine: `holdfast run --engine c`, without onnxruntime.

`holdfast export MODEL --to c --build` makes the library. It is loaded only for the very file that
it was made of: the seal in it must be the file's. Then it replays the file's golden sequences, as
onnxruntime does at every load.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import GoldenMismatch, LibraryRefused
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import check_golden, golden_input, read_model
from holdfast.edge_runtime.model_file import SEAL_KEY, read_sealed
from holdfast.edge_runtime.onnx_bytes import (
    BOOL,
    DOUBLE,
    FLOAT,
    INT32,
    INT64,
    OnnxModel,
)

LIBRARY = "libholdfast.so"
OUTSIDE = ("features", "state_out")
"""Outputs of the ONNX file that are no field of `holdfast_out`."""
C_FIELDS = {DOUBLE: "f8", FLOAT: "f4", INT32: "i4", INT64: "i4", BOOL: "?"}


def default_folder(model: str | Path) -> Path:
    """Where the C form of a model is, if no other place is named: MODEL-c next to it.

    >>> str(default_folder("models/holdfast-150hz.onnx"))
    'models/holdfast-150hz-c'
    """
    path = Path(model)
    return path.with_name(f"{path.stem}-c")


class CompiledModel:
    """A model file and its compiled library, both checked. Raises a ModelError.

    library: None for the one in `default_folder`.
    """

    def __init__(self, path: str | Path, library: str | Path | None = None) -> None:
        data = read_sealed(path)
        self.card, golden, onnx = read_model(data, path)

        where = Path(library) if library else default_folder(path) / LIBRARY
        self._library = _loaded(where)
        self._out_type = _out_type(onnx)

        # The seal is compared before the library computes anything, so that another model never
        # answers.
        self._require_same_model(onnx.metadata[SEAL_KEY], where)
        try:
            check_golden(golden, self._golden_answers(list(golden)))
        except GoldenMismatch as error:
            raise LibraryRefused(
                error.what,
                where=where,
                cause="a compiler that does not follow IEEE 754, or altered sources",
                next_step="build it again: holdfast export MODEL --to c --build --force",
            ) from None

    def stepper(self, outputs: Sequence[str], hands: int = 1) -> CStep:
        """The step of B hands, from a fresh state. outputs: those to show; all are computed."""
        shape = (hands, self.card.n_channels)
        return CStep(self._library, self._out_type, shape, outputs)

    def _require_same_model(self, digest: str, where: Path) -> None:
        """Raise LibraryRefused where the library is of another file, or of another version."""
        compiled = self._library.holdfast_digest().decode("ascii", "replace")
        out_bytes = self._library.holdfast_out_bytes()
        if compiled != digest or out_bytes != self._out_type.itemsize:
            raise LibraryRefused(
                f"the library is of model {compiled:.12}, the file is {digest:.12}",
                where=where,
                cause="the model was exported again after the library was built",
                next_step="build it again: holdfast export MODEL --to c --build --force",
            )

    def _golden_answers(self, names: list[str]) -> Outputs:
        """What the library answers on the golden input, for the outputs by name."""
        card = self.card
        graph = self.stepper(names)
        rows: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in names}
        golden = golden_input(card.n_channels, card.unit, card.settle_samples)
        for values, valid in zip(*golden, strict=True):
            graph.sample[0] = values
            graph.valid[0] = valid
            for name, answer in graph.step().items():
                rows[name].append(answer[0].copy())

        return {name: np.array(kept) for name, kept in rows.items()}


class CStep:
    """The step of B hands in a compiled library, one after another; buffers are reused.

    sample [B, C] and valid [B, S] are written into before a step. out: arrays [B, ..].
    shape: (B, C).
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        out_type: np.dtype[Any],
        shape: tuple[int, int],
        outputs: Sequence[str],
    ) -> None:
        hands, channels = shape
        self._library = library
        self._step = library.holdfast_step_valid
        self.sample: FloatArray = np.zeros(shape)
        self.valid: BoolArray = np.ones((hands, channels // 3), dtype=np.bool_)
        self._size = library.holdfast_state_bytes()

        # a struct's size is a multiple of its numbers' alignment, so each state is aligned
        self._states = np.zeros((hands, self._size), np.uint8)

        # one struct holdfast_out for each hand
        self._fields = np.zeros(hands, out_type)
        self.out: Outputs = {name: self._fields[name] for name in outputs}

        # made once, so that a step makes no objects of ctypes
        self._arguments = []
        for hand in range(hands):
            buffers = (self._states, self.sample, self.valid, self._fields)
            places = [ctypes.c_void_p(one[hand:].ctypes.data) for one in buffers]
            self._arguments.append(places)

        self.reset()

    def step(self) -> Outputs:
        """Advance by the sample in `sample` and `valid`; returns buffers that are reused."""
        for of_one_hand in self._arguments:
            self._step(*of_one_hand)
        return self.out

    def reset(self) -> None:
        """Start from a fresh state at the next sample."""
        for state, *_ in self._arguments:
            self._library.holdfast_init_sized(state, ctypes.c_size_t(self._size))


def _loaded(path: Path) -> ctypes.CDLL:
    """The library, with the functions of a C form. Raises LibraryRefused."""
    if not path.is_file():
        raise LibraryRefused(
            "no compiled library",
            where=path,
            cause="it was not built yet, or elsewhere",
            next_step="holdfast export MODEL --to c --build, or name it with --library",
        )

    try:
        # absolute: a bare name would be searched in the system's folders
        library = ctypes.CDLL(str(path.absolute()))
        library.holdfast_state_bytes.restype = ctypes.c_size_t
        library.holdfast_out_bytes.restype = ctypes.c_size_t
        library.holdfast_digest.restype = ctypes.c_char_p
        library.holdfast_step_valid.argtypes = [ctypes.c_void_p] * 4
    except (OSError, AttributeError) as error:
        raise LibraryRefused(
            f"is no library of a model ({error!s:.200})",
            where=path,
            cause="built for another machine, or another file",
            next_step="build it here: holdfast export MODEL --to c --build --force",
        ) from None

    return library


def _out_type(onnx: OnnxModel) -> np.dtype[Any]:
    """The layout of `holdfast_out`: the outputs of the file in their order, as C aligns them."""
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    for name, spec in onnx.outputs.items():
        if name not in OUTSIDE:
            # of one hand: without the batch, which is a word
            shape = tuple(size for size in spec.shape if isinstance(size, int))
            fields.append((name, C_FIELDS[spec.element], shape))
    return np.dtype(fields, align=True)
