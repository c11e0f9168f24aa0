"""EXPERIMENT: `timed=16` in the URL of an FT232H, which times its own scans for holdfast run."""

from __future__ import annotations

from holdfast.core.errors import UsageError

KEY, BRIDGE = "timed", "ft232h"
AHEAD = (2, 4, 8, 16)


def scans_ahead(
    where: tuple[str, str],
    ahead: int | None,
    *,
    together: bool,
    runs: bool,
    moved: bool,
) -> int:
    """How many scans to queue ahead, 0 where the URL does not ask for it. Raises UsageError.

    where: the URL's scheme and name; ahead, together: its options; runs: the reader is the loop of
    holdfast run; moved: the scene depends on the grip commands.
    """
    if ahead is None:
        return 0
    if where[0] == "i2c" or where[1] != BRIDGE:
        what = f"{'://'.join(where)}: {KEY}= needs a bridge that times its own scans"
        raise UsageError(
            what,
            cause="only the FT232H has clocks that do not reach the bus",
            next_step=f"usb://{BRIDGE}?{KEY}={AHEAD[-1]}, or leave {KEY}= out",
        )
    if ahead not in AHEAD:
        raise UsageError(
            f"{KEY}={ahead}: so many scans cannot be queued",
            next_step=f"{KEY}= one of {', '.join(map(str, AHEAD))}",
        )
    if together:
        raise UsageError(
            f"{KEY}= and together=1 exclude each other",
            cause="the trigger needs a pause within the scan",
            next_step="leave one of them out",
        )
    if moved or not runs:
        reader = "--grip virtual" if moved else "this verb"
        raise UsageError(
            f"{KEY}= is an experiment for holdfast run, and {reader} does not know it",
            next_step=f"leave {KEY}= out",
        )
    return ahead
