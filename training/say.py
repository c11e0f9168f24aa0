"""How long work says what it does: one line a stage, to whatever shows it."""

from __future__ import annotations

from collections.abc import Callable

Say = Callable[[str], None]
