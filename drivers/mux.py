"""A TCA9548A on the bus: recognised without a write, and told which channels to join.

It has one register and no register numbers: the byte after its address is the mask of its channels.
A chip with registers takes the same byte for the number of one. So a mux recognises itself by a
register read: it answers the very byte that was sent as a number, again and again, and no chip with
registers holds its own numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.bus import Bus, Transfer

ALIKE_BYTES = 8
"""So many bytes of a plain read are the same from a chip with one register."""
ECHOES = (0x02, 0x01, 0x00)
"""Sent as register numbers, the last parts all channels. 0x70 to 0x77 is also where LED drivers and
pressure sensors are, to which these are numbers or nothing; and none of them begins a reset."""


def answering(bus: Bus, addresses: Sequence[int]) -> list[int]:
    """Which of these addresses acknowledge a read; a sleeping sensor does from the second time
    on."""
    asked = [Transfer(address, b"", 1) for address in addresses]
    replies = [bus.scan(asked), bus.scan(asked)]
    return [
        address
        for address, *both in zip(addresses, *replies, strict=True)
        if any(one.acked for one in both)
    ]


def plain_read(bus: Bus, address: int) -> bytes:
    """What a chip answers where no register is named; nothing where none acknowledges."""
    return bus.scan([Transfer(address, b"", ALIKE_BYTES)])[0].data


def is_mux(bus: Bus, address: int) -> bool:
    """Whether a mux answers there, found by reads alone; all its channels are parted then. Raises
    what a bridge raises.

    A foreign chip that answers a plain read with different bytes is sent nothing at all.
    """
    return len(set(plain_read(bus, address))) == 1 and all(
        _echoes(bus, address, number) for number in ECHOES
    )


def _echoes(bus: Bus, address: int, number: int) -> bool:
    """Whether a register read of this number makes it what a plain read answers. A mux takes its
    mask with the STOP."""
    after = bus.scan([Transfer(address, bytes([number]), 1), Transfer(address, b"", 2)])[1]
    return after.data == bytes([number, number])


def joined(mux: int, mask: int) -> Transfer:
    """The transfer that joins these channels of a mux and parts all others."""
    return Transfer(mux, bytes([mask]))
