"""Scenes in steps of 3 ms, for tests that need trials of a card but not its exact physics."""

from __future__ import annotations

from dataclasses import replace

import pytest

from holdfast.simulation import card

STEP_S = 0.003
"""As cards of the tests have it; the default is a quarter of it, and a trial takes as much less."""


@pytest.fixture
def coarse_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cards that state no step are simulated in coarse ones."""
    fine = card.PHYSICS["step_s"]
    monkeypatch.setitem(card.PHYSICS, "step_s", replace(fine, default=STEP_S))
