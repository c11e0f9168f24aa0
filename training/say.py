"""How long work reports its stages, and the share of each that is done."""

from __future__ import annotations

from collections.abc import Callable

Say = Callable[[str], None]
Part = Callable[[float], None]
"""Takes which share of the stage under way is done, 0 to 1."""


def ignored(message: object) -> None:
    """A Say or a Part that shows nothing."""


def span(part: Part, start: float, stop: float) -> Part:
    """A Part for what lasts from one share of a stage to another."""
    return lambda share: part(start + (stop - start) * share)
