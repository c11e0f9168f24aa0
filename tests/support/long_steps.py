"""Scenes in longer steps, for tests that ask nothing of a slip to the millisecond."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest

from holdfast.simulation.physics.contacts import EFFECTS
from holdfast.simulation.scenes import scene_file
from holdfast.simulation.scenes.scene_file import STEP_S, SceneFile


@contextmanager
def long_steps(step_s: float = 0.0067) -> Iterator[None]:
    """Scenes whose file names no step take this one, in this process: an eighth of the time.

    Not for cards with the effect texture, which refuse it.
    """

    def coarse(**fields: Any) -> SceneFile:
        if fields["step_s"] == STEP_S:
            fields["step_s"] = step_s
        return SceneFile(**fields)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(scene_file, "SceneFile", coarse)
        yield


@pytest.fixture
def texture_in_any_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texture takes part in steps that are too long for its physics."""
    any_step = replace(EFFECTS["texture"], longest_step_s=math.inf)
    monkeypatch.setitem(EFFECTS, "texture", any_step)
