"""Facts that streams of the lab streaming layer, and XDF files of them, give about themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from holdfast.core.contract import UNITS, Unit, channel_names
from holdfast.core.errors import (
    ChannelError,
    UnitError,
    listed,
)

UNIT_WORDS: dict[str, Unit] = {
    "n": "N",
    "newton": "N",
    "newtons": "N",
    "ut": "uT",
    "µt": "uT",
    "microtesla": "uT",
    "count": "count",
    "counts": "count",
}
"""What streams write for a unit, in lower case."""


@dataclass(frozen=True)
class StreamFacts:
    """Of a stream. rate_hz: 0 where it is irregular. labels, units [C]: "" where it has none."""

    name: str
    is_text: bool
    rate_hz: float
    labels: tuple[str, ...]
    units: tuple[str, ...]


def order_of(labels: Sequence[str], where: str) -> list[int]:
    """Where X1, Y1, Z1, .. are: by their labels if these are the layout's, else as they come.

    Raises ChannelError.
    """
    count = len(labels)
    if not count or count % 3:
        raise ChannelError(
            f"{count} channels, not a multiple of three",
            where=where,
            next_step="send x, y, z of each sensor, or name another stream",
        )
    names = channel_names(count // 3)
    # labels in another order are sorted; labels of another kind say nothing about order
    by_name = set(labels) == {*names}
    return [labels.index(name) for name in names] if by_name else [*range(count)]


def unit_of(units: Sequence[str], where: str, next_step: str) -> Unit:
    """The one unit of all channels. next_step: how to give it. Raises UnitError."""
    said = {one.strip().lower() for one in units}
    known = {UNIT_WORDS.get(word) for word in said}
    # all channels must have one unit, and it must be one of ours
    (unit,) = known if len(known) == 1 else (None,)
    if unit is None:
        raise UnitError(
            f"the stream does not say its unit ({listed(sorted(said - {''})) or 'nothing'})",
            where=where,
            cause=f"its channels have no unit of {', '.join(UNITS)}",
            next_step=next_step,
        )
    return unit
