"""A sensor in the loop reports, sample by sample, what the recording of the trial has, to the
bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from loop_bench import card_text, row, scene_of

from holdfast.core.contract import FloatArray
from holdfast.core.hand_card import read_hand_card
from holdfast.simulation.effects.effect import all_effects
from holdfast.simulation.loop.sensing import LoopSensors
from holdfast.simulation.scenes.scene import Scene

SENSOR_EFFECTS = {n: e for n, e in all_effects().items() if e.stage == "sensor"}
COUNTS = np.array([75, 61, 40])
"""Samples of the trials, which end one after another."""
ON_FIELDS = [n for n in SENSOR_EFFECTS if "dipole" in SENSOR_EFFECTS[n].needs] + [
    "dipole"
]
ON_PADS = ["pad_magnet", "magnetometer"]
"""In scenes in uT only, and without a dipole."""
ON_ANY = [n for n in SENSOR_EFFECTS if n not in ON_FIELDS + ON_PADS]


def scene_with(names: list[str], folder: Path, seed: int = 0, unit: str = "N") -> Scene:
    effects = ""
    for name in names:
        example = SENSOR_EFFECTS[name].example
        values = [f"{key} = {value}" for key, value in example.items()]
        effects += "\n".join([f"[effects.{name}]", *values, ""])
    text = card_text(row("pull", "count = 3"), effects=effects)
    return scene_of(folder, text.replace("150\n", f'150\nunit = "{unit}"\n', 1), seed)


def touched(seed: int) -> FloatArray:
    """[T, 3, 6, 3] forces of three trials: they wander, and some channels rest."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(COUNTS.max(), 3, 6, 3)) * rng.choice(
        [0.0, 0.05, 0.5], (1, 3, 6, 3)
    )
    forces: FloatArray = steps.cumsum(axis=0)
    forces[..., 2] = np.abs(forces[..., 2])
    return forces


def in_the_loop(scene: Scene, forces_n: FloatArray) -> list[list[tuple[bytes, bytes]]]:
    """By trial, by call: the bytes of values and validity."""
    sensors = LoopSensors(scene, scene.trials(), COUNTS)
    reported: list[list[tuple[bytes, bytes]]] = [[], [], []]
    for k in range(len(forces_n)):
        rows = np.minimum(k, COUNTS - 1)
        now = sensors.read(rows, forces_n[rows, np.arange(3)])
        for place in range(3):
            one = now.values[place].tobytes(), now.valid[place].tobytes()
            reported[place].append(one)
    return reported


def as_recorded(
    scene: Scene, forces_n: FloatArray, place: int
) -> list[tuple[bytes, bytes]]:
    """What the whole trial's signal has, a row a sample."""
    n = COUNTS[place]
    signal, _ = scene.sense(
        scene.trials()[place], np.arange(n) / 150.0, forces_n[:n, place]
    )
    return [
        (v.tobytes(), good.tobytes())
        for v, good in zip(signal.values, signal.valid, strict=True)
    ]


def require_same(scene: Scene, seed: int) -> None:
    """The loop reports what the recording has; one sample late where the clock jitters."""
    forces_n = touched(seed)
    late = int("timing_jitter" in scene.sensor_effects)
    for place, calls in enumerate(in_the_loop(scene, forces_n)):
        recorded = as_recorded(scene, forces_n, place)
        assert calls[late : COUNTS[place]] == (recorded[:-1] if late else recorded)


@pytest.mark.parametrize("name", SENSOR_EFFECTS)
def test_an_effect_row_by_row_is_the_effect_of_the_whole_trial(
    name: str, tmp_path: Path
) -> None:
    before = ["dipole"] if name in ON_FIELDS and name != "dipole" else []
    unit = "N"
    if name in ON_PADS:
        before, unit = [ON_PADS[0]] if name != ON_PADS[0] else [], "uT"
    scene = scene_with([*before, name], tmp_path, unit=unit)
    require_same(scene, 1)


def test_an_axis_that_the_hand_does_not_measure_is_zero_in_the_loop_too(
    tmp_path: Path,
) -> None:
    whole = scene_with(["white_noise"], tmp_path)
    sensors = read_hand_card("six-fingertips").contacts
    yz = tuple(msgspec.structs.replace(one, measures="yz") for one in sensors)
    hand = replace(whole.file.hand, contacts=yz)
    scene = Scene(replace(whole.file, hand=hand), 0)
    require_same(scene, 1)
    now = LoopSensors(scene, scene.trials(), COUNTS).read(COUNTS - 1, touched(1)[0])
    assert not now.values[..., 0].any()
    assert now.values[..., 1:].all()


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    fields=st.lists(st.sampled_from(ON_FIELDS), unique=True),
    others=st.lists(st.sampled_from(ON_ANY), unique=True),
    unit=st.sampled_from(["N", "uT"]),
    seed=st.integers(0, 1000),
)
def test_any_effects_together_row_by_row_are_those_of_the_whole_trial(
    fields: list[str], others: list[str], unit: str, seed: int, tmp_path: Path
) -> None:
    fitting = [n for n in others if SENSOR_EFFECTS[n].only_unit in (None, unit)]
    names = [*({"dipole", *fields} if fields or unit == "uT" else ()), *fitting]
    require_same(scene_with(sorted(names), tmp_path, seed, unit), seed)
