"""Scenes in longer steps, for tests that ask nothing of a slip to the millisecond."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from holdfast.simulation import scene_file
from holdfast.simulation.scene_file import STEP_S, SceneFile


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
