"""The bytes of a simulated set and of an exported graph stay the same, and a trial's do not depend
on its batch.

The digests hold for one lock: numpy's random streams, onnx's way of writing, the trees that
scikit-learn grows. They are compared on x86_64, where they were made; the mathematical library of
another machine may round otherwise. After a change of pins or of the physics that is meant, put in
what the failing test prints, and say so in the message.
"""

from __future__ import annotations

import hashlib
import platform
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy._core._multiarray_umath import __cpu_features__ as features  # type: ignore[import-not-found]
from small_model import artifact, graph_of, spec

from holdfast.simulation.scenes import stepper
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.simulation.scenes.script_times import grid_of

on_the_machine_they_are_of = pytest.mark.skipif(
    platform.machine() != "x86_64" or not features["AVX512_SKX"],
    reason="the digests are of x86_64 with AVX-512",
)

SETS = {
    "adapt": "8e93b85f5b4014a8",
    "apple": "24dc71dedb48c8b3",
    "broad": "1a6d74deef84a345",
    "daily": "34b67c8635c6a4aa",
    "p1": "0a780797193cd3aa",
    "p2": "7ab824cc041ca2c1",
    "perturbed-hold": "a7cd20b1c561201b",
    "pull-soft-ball": "c63aaf025b554856",
    "thesis": "67da88c21549a332",
    "twenty-sensors": "695456dc451e19ee",
}
"""Card -> digest of two trials, from before there were hand cards."""
GRAPH = "c7a18ef05e8c1d4c"
GROUPS = (
    "window",
    "now",
    "differences",
    "scaled_differences",
    "scaled_sums",
    "activity",
)
"""Of the graph; a group that is added later does not change it."""
COARSE_S = 1 / 150
"""A step a sample: nothing here asks for right physics, only for the same."""


def scene_of(card: str, seed: int) -> Scene:
    return Scene(replace(read_scene_file(card), step_s=COARSE_S), seed)


def digest_of(folder: Path) -> str:
    """Over the names and the bytes of all files."""
    found = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        found.update(
            path.relative_to(folder).as_posix().encode()
            + b"\0"
            + path.read_bytes()
            + b"\0"
        )
    return found.hexdigest()[:16]


@on_the_machine_they_are_of
@pytest.mark.parametrize("card", SETS)
def test_a_simulated_set_keeps_its_bytes(card: str, tmp_path: Path) -> None:
    write_set(scene_of(card, 7), tmp_path / "set", 2)
    assert digest_of(tmp_path / "set") == SETS[card]


@on_the_machine_they_are_of
def test_an_exported_graph_keeps_its_bytes() -> None:
    graph = graph_of(
        artifact(spec(GROUPS, n_sensors=6, rate_hz=150.0))
    ).SerializeToString()
    assert hashlib.sha256(graph).hexdigest()[:16] == GRAPH


@pytest.mark.parametrize("card", ["thesis", "broad"])
def test_a_batch_that_short_trials_leave_gives_what_one_that_all_stay_in_gives(
    card: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = scene_of(card, 3)
    trials = sorted(
        scene.trials(8),
        key=lambda trial: len(grid_of(trial, 150.0, scene.file.step_s).at_s),
    )
    some_leave = scene.run_together(trials)
    steps = [len(one.motion.at_s) for one in some_leave]
    assert max(steps) - min(steps) > stepper.CHUNK
    monkeypatch.setattr(stepper, "WORTH_LEAVING", 1)
    for one, other in zip(some_leave, scene.run_together(trials), strict=True):
        for name in (
            "forces_n",
            "position_m",
            "agents_n",
            "gripped",
            "slips",
            "slides",
            "slip_m",
        ):
            assert np.array_equal(
                getattr(one.motion, name), getattr(other.motion, name)
            ), (
                one.trial,
                name,
            )
