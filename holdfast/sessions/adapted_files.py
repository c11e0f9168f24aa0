"""A model file for one person, from a base file and recordings; and the base again."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import onnx

from holdfast.core.locked import require_open
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import CARD_SUFFIX, read_card, read_sealed
from holdfast.export.changed import adapted, is_adapted, undone, verify_adapted
from holdfast.export.exporting import metadata_of, readable_card
from holdfast.export.verify import AdaptedVerification
from holdfast.sessions.adapting import (
    Fitted,
    adapt,
    of_person,
    simulated_slips,
)
from holdfast.training.datasets import find, load
from holdfast.training.progress import Stages
from holdfast.training.recording import DataSet


@contextmanager
def base_model(path: Path) -> Iterator[tuple[Model, bytes]]:
    """The opened base model and its bytes. Raises what opening a model raises."""
    data = read_sealed(path)
    if not is_adapted(data):
        yield Model(path), data
        return

    # Corrections do not stack: a second adaptation starts from the base again.
    base = undone(data, path)
    with tempfile.TemporaryDirectory() as folder:
        # The runtime opens files by their path, so the base needs one for a moment.
        file = Path(folder) / path.name
        file.write_bytes(base)
        yield Model(file), base


def adapt_file(
    model_path: Path,
    data: str,
    person: str,
    slips: str | None,
    out: Path,
    begin: Stages,
    *,
    worse_too: bool = False,
) -> tuple[Fitted, AdaptedVerification]:
    """Fit, build, verify and write. slips: recordings with slips, None for simulated ones.

    worse_too: write a file that is worse than its base too; else it raises WorseThanBase.
    """
    with base_model(model_path) as (model, base):
        begin("reading the person's recordings")
        require_open(find(data), "a correction", styles=False)
        recordings = load(data, channels=model.card.n_channels, windows="none")
        chosen = of_person(recordings, person)

        def others() -> DataSet:
            return _slips(slips, model, begin)

        fitted = adapt(model, chosen, others, begin, begin.part)

    if not worse_too:
        fitted.require_no_worse()

    begin("building, verifying and sealing the file")
    correction = fitted.adaptation.correction
    rows = fitted.rows()
    made = adapted(base, fitted.adaptation)
    # Before it is written: a file that fails is never on the disk.
    verified = verify_adapted(base, made, correction, rows)
    _write(out, made)

    return fitted, verified


def write_base(adapted_path: Path, out: Path) -> None:
    """The base of an adapted file, byte for byte."""
    _write(out, undone(read_sealed(adapted_path), adapted_path))


def _slips(slips: str | None, model: Model, begin: Stages) -> DataSet:
    if slips:
        begin(f"reading {slips}")
        require_open(find(slips), "a correction", styles=False)
        channels = model.card.n_channels
        return load(slips, channels=channels, windows="none", part=begin.part)
    begin("simulating trials with slips")
    return simulated_slips(model.card, part=begin.part)


def _write(path: Path, data: bytes) -> None:
    """The file, and its card next to it."""
    # Read from the file, so that the card shows what it says.
    card = read_card(metadata_of(onnx.load_from_string(data)), path)
    write_whole(path, data)
    write_whole(path.with_suffix(CARD_SUFFIX), readable_card(card.raw, path.name, data))
