"""A TCA9548A mux on the bus: recognised by reads alone, and switched by one byte.

It has one register and no register numbers: the byte after its address is the mask of its enabled
channels. A chip with registers takes the same byte as a register number. A mux therefore shows
itself in a register read: it returns the very byte that was sent as the number, again and again. No
chip with registers holds its own register numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.drivers.bus import Bus, Transfer

ALIKE_BYTES = 8
"""A chip with one register answers a plain read of this many bytes with equal bytes."""
ECHOES = (0x02, 0x01, 0x00)
"""Sent as register numbers; the last one disables all channels.

LED drivers and pressure sensors also use 0x70 to 0x77. To them these numbers are registers or
nothing, and none of them starts a reset.
"""


def answering(bus: Bus, addresses: Sequence[int]) -> list[int]:
    """Which addresses acknowledge a read; a sleeping sensor does so from the second read on."""
    transfers = [Transfer(address, b"", 1) for address in addresses]
    replies = [bus.scan(transfers), bus.scan(transfers)]
    return [
        address
        for address, *both in zip(addresses, *replies, strict=True)
        if any(one.acked for one in both)
    ]


def plain_read(bus: Bus, address: int) -> bytes:
    """What a chip answers to a read without a register number; empty if no chip acknowledges."""
    return bus.scan([Transfer(address, b"", ALIKE_BYTES)])[0].data


def is_mux(bus: Bus, address: int) -> bool:
    """Whether a mux answers there, found by reads alone. Its channels are all disabled afterwards.

    A chip that answers a plain read with different bytes is sent nothing at all. Raises what a
    bridge raises.
    """
    return len(set(plain_read(bus, address))) == 1 and all(
        _echoes(bus, address, number) for number in ECHOES
    )


def _echoes(bus: Bus, address: int, number: int) -> bool:
    """Whether a plain read returns the register number that was sent before it."""
    after = bus.scan([Transfer(address, bytes([number]), 1), Transfer(address, b"", 2)])[1]
    return after.data == bytes([number, number])


def enable_channels(mux: int, mask: int) -> Transfer:
    """The transfer that enables these channels of a mux and disables the rest."""
    return Transfer(mux, bytes([mask]))
