"""How many channels of a set are used, where more than one number is possible."""

from __future__ import annotations

from collections.abc import Iterable

from holdfast.edge_runtime.errors import ChannelError


class ChannelsNotOffered(ChannelError):
    """A set cannot be read with that number of channels. offered: those that it has, in words."""

    def __init__(self, set_name: str, channels: int, offered: Iterable[int]) -> None:
        self.offered = " or ".join(map(str, sorted(offered)))
        super().__init__(
            f"{set_name} has no {channels}-channel case", next_step=f"ask for {self.offered}"
        )
