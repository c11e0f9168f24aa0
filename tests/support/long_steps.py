"""Scenes in longer steps, for tests that ask nothing of a slip to the millisecond."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from holdfast.simulation import scene_file


@contextmanager
def long_steps(step_s: float = 0.003) -> Iterator[None]:
    """Scenes whose file names no step take this one, in this process: a third of the time.

    Not for cards with the effect texture, which refuse it.
    """
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(scene_file, "STEP_S", step_s)
        yield
