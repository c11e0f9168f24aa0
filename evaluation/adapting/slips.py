"""Recordings with slips, which a person does not have to record: simulated, if none are given."""

from __future__ import annotations

import tempfile
from pathlib import Path

from holdfast.edge_runtime.errors import UsageError
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.simulation.card import read_card
from holdfast.simulation.closed_loop.recording import scene_of
from holdfast.simulation.folder import write_set
from holdfast.training.datasets import load
from holdfast.training.recording import DataSet
from holdfast.training.say import Part, ignored

CARD, TRIALS, SEED = "thesis", 300, 1
"""Models are trained on seed 0."""


def simulated_slips(card: ModelCard, trials: int = TRIALS, part: Part = ignored) -> DataSet:
    """Trials of the thesis' protocol at the model's rate. Raises UsageError for another hand."""
    if card.unit != "N" or card.n_channels != 18:
        raise UsageError(
            "--slips is needed: scenes have six sensors in N, this model has "
            f"{card.n_channels // 3} in {card.unit}",
            next_step="--slips FOLDER, with recordings of pulls and falls by any person",
        )
    scene = scene_of(read_card(CARD, rate_hz=card.rate_hz), SEED)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / CARD
        write_set(scene, out, trials, lambda n: part(min(1.0, n / trials)))
        return load(out, windows="none")
