"""Hands with more contacts than the thesis': the same physics, more places to feel it, and
the bytes of all other hands as before."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from long_steps import texture_in_any_step  # noqa: F401  a fixture

from holdfast.core.hand_card import HandCard
from holdfast.core.trial_file import read_trial
from holdfast.data.datasets import load
from holdfast.simulation.physics.objects import hand_of_counts
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene, SimulatedTrial
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.simulation.scenes.stepper import TrialMotion, motions

TWENTY = hand_of_counts(4, 4)
DIGITS = np.repeat(np.arange(5), [2, 1, 1, 1, 1]), np.repeat(np.arange(5), 4)
ROWS = """
[record]
rate_hz = 60
[physics]
step_s = 0.006
[[trials]]
objects = ["soft-ball", "full-bottle"]
action = "pull"
close_at_s = 0.1
hold_s = 1.0
tail_s = 0.2
[[trials]]
objects = ["empty-bottle"]
action = "hold"
motor_mm = 2.0
close_at_s = 0.1
hold_s = 1.0
times = 1
tail_s = 0.2
[effects.brush]
"""
FOURS = "[hand]\nthumb = 4\nfinger = 4\n"
EVERY_LOOP_EFFECT = (
    "[effects.texture]\n[effects.lag]\n[effects.rotation]\n[effects.tremor]\n"
)
SENSOR = "".join(
    f"[effects.{name}]\n"
    for name in ("dipole", "cross_talk", "gain_tilt", "hall_noise")
)


def scene(tmp_path: Path, text: str) -> Scene:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return Scene(read_scene_file(str(path)), 0)


def trials_of(tmp_path: Path, text: str) -> list[SimulatedTrial]:
    made = scene(tmp_path, text)
    return made.run_together(made.trials())


def even(trial: PlannedTrial, hand: HandCard, digits: np.ndarray) -> PlannedTrial:
    """The trial with all fingers alike and at the apex, so that only the number of their contacts
    differs."""
    share = hand.part / np.array([2.0, 4.0])[np.where(digits > 0, 1, 0)]
    at_m = np.zeros((2, len(digits)))
    return replace(
        trial, hand=hand, finger_n_per_m=600.0 * hand.part, share=share, at_m=at_m
    )


def summed(motion: TrialMotion, digits: np.ndarray) -> np.ndarray:
    """[T, 5, 3] forces of each digit."""
    return np.stack(
        [motion.forces_n[:, digits == k].sum(axis=1) for k in range(5)], axis=1
    )


def test_a_finger_on_four_places_holds_as_the_same_finger_on_one(tmp_path):
    """Its places bear together what the finger on one bore, and the object moves alike, through
    slip and all."""
    made = scene(tmp_path, ROWS)
    loop = made.settings
    moved = [
        list(motions([even(trial, hand, digits) for trial in made.trials()], loop))
        for hand, digits in zip((hand_of_counts(), TWENTY), DIGITS, strict=True)
    ]
    for six, twenty in zip(*moved, strict=True):
        assert (six.forces_n.shape[1], twenty.forces_n.shape[1]) == (6, 20)
        np.testing.assert_allclose(
            summed(twenty, DIGITS[1]), summed(six, DIGITS[0]), atol=1e-6
        )
        np.testing.assert_allclose(twenty.position_m, six.position_m, atol=1e-8)
        assert np.abs(twenty.position_m).max() > 1e-3


@pytest.mark.usefixtures("texture_in_any_step")
def test_every_effect_knows_a_hand_of_twenty(tmp_path):
    for one in trials_of(tmp_path, ROWS + FOURS + EVERY_LOOP_EFFECT + SENSOR):
        assert one.signal.values.shape[1:] == (20, 3)
        assert np.isfinite(one.signal.values).all()


def test_a_set_of_twenty_sensors_is_written_and_read(tmp_path):
    write_set(scene(tmp_path, ROWS + FOURS), tmp_path / "set")
    assert read_trial(tmp_path / "set/soft-ball/pull/trial_1.csv").raw.shape[1] == 60
    assert load(tmp_path / "set", windows="natural").n_sensors == 20
