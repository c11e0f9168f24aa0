"""What several tests need: the public data sets, where they are; small models made by the whole
pipeline."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hard_cases import (  # noqa: F401  hooks: pytest finds them here by their names
    pytest_addoption,
    pytest_collection_finish,
    pytest_configure,
    pytest_runtest_makereport,
)
from hypothesis import settings
from made_once import made_once

from holdfast.core.errors import DataNotFound
from holdfast.data.datasets import find, load

if TYPE_CHECKING:
    from holdfast.data.recording import DataSet


pytest_plugins = [
    "bridge_bench",
    "command_line",
    "dask_cluster",
    "doctest_files",
    "drawn_frames",
    "frozen_heap",
    "live_bench",
    "longest_first",
    "recorder_bench",
]
"""For their fixtures and hooks, which several files share."""

# fixed seeds, no clock: what passed passes again
settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")
# compiled modules are kept, as `make test` does: else each process of a test compiles numpy
# and our own package anew, which takes three times as long
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# under nohup a hangup is ignored, and so it would be in every process that a test starts
signal.signal(signal.SIGHUP, signal.SIG_DFL)
# and so is Ctrl-C where the tests run in the background of a shell
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def real_set() -> Callable[[str], Path]:
    """Folder of a public set by name; without it the test skips, or fails if
    HOLDFAST_REQUIRE_DATA=1."""

    def folder(name: str) -> Path:
        try:
            return find(name)
        except DataNotFound as absent:
            line = str(absent)
        if os.environ.get("HOLDFAST_REQUIRE_DATA") == "1":
            pytest.fail(line, pytrace=False)
        pytest.skip(line)

    return folder


MODEL_NAME = "holdfast.onnx"


@dataclass(frozen=True)
class Built:
    """A made-up set in the thesis' layout, the artifact trained on it, and the sealed file exported
    from that."""

    data: DataSet
    fixture: Path
    artifact: Path
    model: Path


@pytest.fixture(scope="session")
def fixture_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The generated set, three trials a cell, at 50 Hz. Read only: many tests share it."""
    from holdfast.data.fixture import write_fixture

    return made_once(
        tmp_path_factory,
        "fixture",
        lambda folder: write_fixture(folder, trials_per_cell=3),
    )


@pytest.fixture(scope="session")
def eight_classes(
    fixture_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Built:
    """A small model of eight classes, so one that knows light and heavy. Read only."""
    data = load(fixture_folder, windows="thesis")
    out = made_once(
        tmp_path_factory, "eight_classes", lambda folder: _build(data, folder)
    )
    return Built(data, fixture_folder, out, out / MODEL_NAME)


@pytest.fixture(scope="session")
def four_situations(
    fixture_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Built:
    """A small model of four situations with a second head, so one that knows no weight. Read only.

    Its second task is made up: the prediction is "risky now".
    """
    loaded = load(fixture_folder, windows="thesis")
    rows = loaded.with_situations().tasks["situations"]
    risky = replace(
        rows, label=(rows.label == 3).astype(rows.label.dtype), classes=("no", "yes")
    )
    data = replace(loaded, tasks={"situations": rows, "predict_250ms": risky})
    out = made_once(
        tmp_path_factory, "four_situations", lambda folder: _build(data, folder)
    )
    return Built(data, fixture_folder, out, out / MODEL_NAME)


def _build(data: DataSet, out: Path) -> None:
    """Train and export by the real pipeline, with forests of a few trees."""
    from holdfast.export.exporting import export_artifact
    from holdfast.step.spec import BandsLeftOut
    from holdfast.training.fitting import train
    from holdfast.training.plan import ForestPlan, TrainingPlan

    few = ForestPlan(n_estimators=6)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", BandsLeftOut
        )  # 50 Hz carries three of the ten bands
        train(data, out, TrainingPlan(situation=few, prediction=few, folds=2))
    export_artifact(out, out / MODEL_NAME)
