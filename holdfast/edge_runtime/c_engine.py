"""A model's compiled C form as its engine: `holdfast run --engine c`, without onnxruntime.

`holdfast export MODEL --to c --build` makes a folder with the library and `model.json`: the model's
card, its golden sequences, its seal and the layout of the outputs. It is loaded only for the very
file that it was made of: the seal in it must be the file's. Then it replays the golden sequences,
as onnxruntime does at every load.
"""

from __future__ import annotations

import ctypes
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray, Json
from holdfast.core.errors import GoldenMismatch, LibraryRefused
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import check_golden, golden_from_json, golden_input
from holdfast.edge_runtime.model_file import card_of, digest_of, read_sealed

LIBRARY = "libholdfast.so"
ABOUT = "model.json"
"""Beside the library: what `holdfast export --to c` writes of the model."""


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
        digest = digest_of(read_sealed(path))
        where = Path(library) if library else default_folder(path) / LIBRARY
        self._library = _loaded(where)
        about = _about(where.with_name(ABOUT))
        self.card, self._out_type = card_of(about["card"], digest, path), _layout(about)
        golden = golden_from_json(about["golden"])

        # The seal is compared before the library computes anything, so that another model never
        # answers.
        self._require_same_model(digest, about["digest"], where)
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

    def _require_same_model(self, digest: str, described: str, where: Path) -> None:
        """Raise LibraryRefused where library and model.json are not of the file.

        digest: of the file. described: of the file that model.json is of.
        """
        compiled = self._library.holdfast_digest().decode("ascii", "replace")
        out_bytes = self._library.holdfast_out_bytes()
        same = compiled == described == digest
        if not same or out_bytes != self._out_type.itemsize:
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
            next_step="holdfast export MODEL --to c --build, or library = in holdfast.toml",
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


def _about(path: Path) -> Json:
    """model.json beside a library. Raises LibraryRefused."""
    try:
        about: Json = json.loads(path.read_text("utf-8"))
        return about
    except (OSError, ValueError) as error:
        raise LibraryRefused(
            f"cannot be read ({type(error).__name__})",
            where=path,
            cause="the library was built by an older version, or copied without this file",
            next_step="build it again: holdfast export MODEL --to c --build --force",
        ) from None


def _layout(about: Json) -> np.dtype[Any]:
    """The layout of `holdfast_out`, as model.json has it."""
    outputs = about["outputs"]
    return np.dtype(
        {
            "names": [one["name"] for one in outputs],
            "formats": [(one["dtype"], tuple(one["shape"])) for one in outputs],
            "offsets": [one["offset"] for one in outputs],
            "itemsize": about["out_bytes"],
        }
    )
