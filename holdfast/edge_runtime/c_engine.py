"""A model's compiled C form as its engine, without onnxruntime: a sixth of its time as deployed.

`holdfast export MODEL --to c` makes a folder with the library and `model.json`: the model's card,
its golden sequences, its seal and the fields of its outputs. It is loaded only for the very file
that it was made of: the seal in it must be the file's. Then it replays the golden sequences, as
onnxruntime does at every load.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, Json
from holdfast.core.errors import LibraryRefused
from holdfast.core.schema import LIBRARY, c_folder, json_of
from holdfast.edge_runtime.graph import Outputs, step_recordings
from holdfast.edge_runtime.model import check_golden, golden_from_json, golden_input
from holdfast.edge_runtime.model_file import card_of, digest_of, read_sealed

ABOUT = "model.json"
"""Beside the library: what `holdfast export --to c` writes of the model."""


class CompiledModel:
    """A model file and its compiled library, both checked. Raises a ModelError.

    library: None for that in `c_folder`. engine: a line for people.
    """

    def __init__(self, path: str | Path, library: str | Path | None = None) -> None:
        digest = digest_of(read_sealed(path))
        where = Path(library) if library else c_folder(path) / LIBRARY
        self.engine = f"the step is compiled C, {where}; --engine onnxruntime declines"
        if not where.is_file():
            raise _refused("no compiled library", where, "not built yet, or elsewhere")

        try:
            about: Json = json_of(where.with_name(ABOUT).read_bytes())
            # before anything of the library runs
            _require_same(about["digest"], digest, where)
            golden = golden_from_json(about["golden"])
            fields = []
            for one in about["outputs"]:
                fields.append((one["name"], one["dtype"], tuple(one["shape"])))
            # the layout of `holdfast_out`, aligned as C does
            self._out_type = np.dtype(fields, align=True)
            self.card = card_of(about["card"], digest, path)
            self._library = _loaded(where)
        except (OSError, AttributeError, ValueError, KeyError, TypeError) as error:
            what = f"is no library of a model with its {ABOUT} ({error!r:.200})"
            cause = "built for another machine, or copied in part"
            raise _refused(what, where, cause) from None

        _require_same(self._library.holdfast_digest().decode(), digest, where)
        check_golden(golden, self._golden_answers(list(golden)), str(where))

    def stepper(self, outputs: Sequence[str], hands: int = 1) -> CStep:
        """The step of B hands, from a fresh state. outputs: those to show; all are computed."""
        shape = (hands, self.card.n_channels)
        return CStep(self._library, self._out_type, shape, outputs)

    def _golden_answers(self, names: list[str]) -> Outputs:
        """What the library answers on the golden input, for the outputs by name."""
        card = self.card
        values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
        rows = np.arange(len(values))
        (answers,) = step_recordings(
            lambda hands: self.stepper(names, hands), [values], [valid], [rows]
        )
        return answers


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
    """The library, with the functions of a C form. Raises OSError or AttributeError."""
    # absolute: a bare name would be searched in the system's folders
    library = ctypes.CDLL(str(path.absolute()))
    library.holdfast_state_bytes.restype = ctypes.c_size_t
    library.holdfast_digest.restype = ctypes.c_char_p
    library.holdfast_step_valid.argtypes = [ctypes.c_void_p] * 4
    return library


def _require_same(digest: str, of_file: str, where: Path) -> None:
    """Raise LibraryRefused for the form of another model."""
    if digest != of_file:
        what = f"the library is of model {digest:.12}, the file is {of_file:.12}"
        cause = "the model was exported again after the library was built"
        raise _refused(what, where, cause)


def _refused(what: str, where: Path, cause: str) -> LibraryRefused:
    step = "holdfast export MODEL --to c --force"
    return LibraryRefused(what, where=where, cause=cause, next_step=step)
