"""The kinds of sensor chip: what the driver of one offers to a hand, and the table that finds it.

A chip is a folder of this package with its driver (a class Driver) and its emulation (a class Chip,
an EmulatedChip of drivers/virtual/virtual_hand.py). All that differs from chip to chip is in there:
addresses, how it identifies itself, configuration, oversampling, which of its readings are new and
which are faults, scale, and what a scan of a bus may ask it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Protocol

from holdfast.core.errors import UsageError

if TYPE_CHECKING:
    from holdfast.core.contract import FloatArray
    from holdfast.drivers.bus import Bus, Transfer
    from holdfast.drivers.virtual.virtual_hand import EmulatedChip

# Loaded by name, so that a run loads the chip that it reads and no other, and no emulation.
CHIPS = {
    "tmag5273": (
        "holdfast.drivers.tmag5273.driver",
        "holdfast.drivers.tmag5273.emulation",
    ),
    "mlx90393": (
        "holdfast.drivers.mlx90393.driver",
        "holdfast.drivers.mlx90393.emulation",
    ),
}
"""Name in a URL -> the module of its driver, the module of its emulation."""
DEFAULT_CHIP = "tmag5273"
STALE_NS = 20_000_000
"""A chip that has not converted for longer is stale."""

Pause = Callable[[float], None]
Raw = tuple[int, int, int]
"""x, y, z as the chip counts them, zero without a field."""


class Readings(Protocol):
    """The readings of one finger's chip, in the order in which they came."""

    @property
    def converts(self) -> bool:
        """Whether the chip is known to convert, so that the next reading can count."""
        ...

    def begin(self, now_ns: int) -> None:
        """The chip was brought up; its earlier conversions do not count."""
        ...

    def missed(self) -> None:
        """No reply came to a read."""
        ...

    def judge(self, data: bytes, came_ns: int) -> tuple[Raw, str]:
        """A reading, and one word for why it does not count ("" where it does).

        Words of every chip: "garbage" is no reply of this chip, "reset" a chip that lost its
        configuration, "diagnosis" its own fault, "stale" and "settling" no new conversion (for
        longer than STALE_NS, or not known yet), "saturated" a field beyond its range.
        """
        ...


class ChipDriver(Protocol):
    """The driver of one kind of chip; one object serves all fingers of a hand.

    name: as messages have it. addresses: its own ones, 7 bits, in the order of the fingers behind
    one channel. found_anywhere: whether a scan may ask at other addresses too. averages:
    conversions of each axis that a reading is the mean of. conversion_s: how long they take.
    """

    name: str
    addresses: tuple[int, ...]
    found_anywhere: bool
    averages: int
    conversion_s: float

    def identify(self, bus: Bus, address: int, pause: Pause) -> int:
        """See that this chip is there; its version. Another chip stays as it was.

        Raises DeviceNotFound where nothing answers, WrongDevice, and what the bridge raises.
        """
        ...

    def configure(self, bus: Bus, address: int) -> None:
        """Let an identified chip convert. Raises WrongDevice where it does not obey."""
        ...

    def read(self, address: int) -> Transfer:
        """The transfer that reads it."""
        ...

    def readings(self) -> Readings:
        """What judges the readings of one finger."""
        ...

    def scale_ut(self, version: int) -> FloatArray:
        """[3] uT a count, in x, y, z."""
        ...

    def range_mt(self, version: int) -> FloatArray:
        """[3] the largest field in x, y, z."""
        ...

    def describe(self, address: int, version: int) -> str:
        """One chip in a few words, for `holdfast scan`."""
        ...

    def health(self, bus: Bus, address: int) -> str:
        """What an identified chip reports as wrong, "" for nothing."""
        ...


def driver_of(chip: str, averages: int | None = None) -> ChipDriver:
    """The driver of a kind of chip. averages: None for the chip's own choice. Raises UsageError."""
    driver: ChipDriver = import_module(_row(chip)[0]).Driver(averages)
    return driver


def emulation_of(chip: str) -> type[EmulatedChip]:
    """The class of the emulated chips of a kind. Raises UsageError."""
    emulation: type[EmulatedChip] = import_module(_row(chip)[1]).Chip
    return emulation


def _row(chip: str) -> tuple[str, str]:
    if chip not in CHIPS:
        choices = " or ".join(f"chip={name}" for name in CHIPS)
        raise UsageError(f"chip={chip[:40]}: no such chip", next_step=choices)
    return CHIPS[chip]


def require_averages(averages: int, choices: tuple[int, ...]) -> None:
    """Raise UsageError for a number of averages that a chip does not have."""
    if averages not in choices:
        raise UsageError(
            f"averages={averages} is none of this chip's",
            next_step=f"choose {', '.join(map(str, choices))}",
        )
