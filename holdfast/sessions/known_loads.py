"""Loads beside fields, for `holdfast calibrate`: a CSV file Time, X1..Zn (uT), Fx, Fy, Fz."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    UNIT_OF,
    BoolArray,
    FloatArray,
    IntArray,
    channel_names,
)
from holdfast.core.errors import ColumnError, DataNotFound, NotANumber, TooFewGroups

FORCES = ("Fx", "Fy", "Fz")
"""Columns with the load."""
UNLOADED_N = 0.3
LOADED_N = 1.0
"""A press begins beyond LOADED_N and is over below UNLOADED_N: noise between them ends none."""
LEAST_NOISE_UT, BEYOND_NOISE = 1.0, 3.0
"""A resting field is below zero where it is so by so many times its noise."""
MIN_UNLOADED = 5
"""Rows below UNLOADED_N that end a probing once LOADED_N was passed."""


@dataclass(frozen=True)
class LoadSet:
    """Rows of several probings, two at least, of one piece of hardware.

    blocks [M]: a row's probing, from 0. field_ut [M, S, 3]: less its rest. force_n [M, 3].
    load_unit: in which the loads were read. rest_ut [S, 3]. reversed_: [S] magnets that are upside
    down. n_lost: rows left out, which had a lost value.
    """

    name: str
    blocks: IntArray
    field_ut: FloatArray
    force_n: FloatArray
    load_unit: str
    rest_ut: FloatArray
    reversed_: BoolArray
    n_lost: int


def read_loads(path: Path, load_unit: str) -> LoadSet:
    """The loads of a CSV file. load_unit: N, mN or gf. Raises a DataError."""
    field, force = _read_csv(path, load_unit)
    # A lost value would spoil the fit of all axes, so its whole row is left out.
    whole = np.isfinite(field).all(axis=(1, 2)) & np.isfinite(force).all(axis=1)
    field = field[whole]
    force = force[whole]
    load_n = np.linalg.norm(force, axis=1)
    starts = probing_starts(load_n)
    # One probing is left out in turn, so there must be two.
    if len(starts) < 2:
        raise TooFewGroups(
            f"{len(starts)} probings",
            where=path,
            cause=f"the load must exceed {LOADED_N:g} N, "
            f"then stay below {UNLOADED_N:g} N for {MIN_UNLOADED} rows",
            next_step="press every fingertip at least twice, with a pause",
        )

    blocks = np.searchsorted(starts, np.arange(len(force)), side="right") - 1
    rests, spreads = [], []
    for block in range(len(starts)):
        # Each probing has its own rest, so that a drift between them is no load.
        at_rest = field[(blocks == block) & (load_n < UNLOADED_N)]
        rests.append(np.median(at_rest, axis=0))
        spreads.append(np.std(at_rest, axis=0))

    # The rest of the hardware is that of most probings, whatever one drifted to.
    rest_ut = np.median(rests, axis=0)
    noise_ut = np.maximum(np.median(spreads, axis=0), LEAST_NOISE_UT)
    moved = field - np.array(rests)[blocks]
    # Rows before the first pause belong to no probing.
    inside = blocks >= 0
    return LoadSet(
        path.stem,
        blocks[inside],
        moved[inside],
        force[inside],
        load_unit,
        rest_ut,
        # A magnet that lies the right way up has a resting field above zero along the normal axis.
        reversed_=(rest_ut < -BEYOND_NOISE * noise_ut)[:, NORMAL_AXIS],
        n_lost=int((~whole).sum()),
    )


def probing_starts(load_n: FloatArray) -> list[int]:
    """First row of each probing: of a pause (MIN_UNLOADED rows below UNLOADED_N) before a press.

    >>> probing_starts(np.array([0.0] * 6 + [2.0] * 3 + [0.0] * 6 + [2.0] + [0.0] * 7))
    [0, 9]
    """
    starts: list[int] = []
    pause = 0
    begins = 0
    is_pressed = True
    for row, load in enumerate(load_n.tolist()):
        # A short dip below the limit within a press is no pause.
        pause = pause + 1 if load < UNLOADED_N else 0
        if pause == MIN_UNLOADED and is_pressed:
            begins = row + 1 - MIN_UNLOADED
            is_pressed = False
        if load > LOADED_N and not is_pressed:
            starts.append(begins)
            is_pressed = True
    return starts


def _read_csv(path: Path, load_unit: str) -> tuple[FloatArray, FloatArray]:
    """(field [T, S, 3] uT, force [T, 3] N)."""
    try:
        table = np.loadtxt(path, delimiter=",", ndmin=2, skiprows=1)
    except OSError:
        raise DataNotFound(
            "no such file, or unreadable", where=path, next_step="check the path"
        ) from None
    except ValueError as error:
        raise NotANumber(
            str(error),
            where=path,
            next_step="write plain decimal numbers, and nan for a value that was lost",
        ) from None

    names = path.read_text("utf-8-sig").partition("\n")[0].split(",")
    header = list(map(str.strip, names))
    # Time, three columns a sensor, three forces, in any order.
    expected = ("Time", *channel_names(max(1, (len(header) - 4) // 3)), *FORCES)
    if sorted(header) != sorted(expected) or table.shape[1] != len(header):
        missing = ", ".join(name for name in expected if name not in header)
        raise ColumnError(
            f"{table.shape[1]} columns named {', '.join(header)}; "
            f"missing: {missing or 'none'}",
            where=path,
            next_step="name the columns Time,X1,Y1,Z1,..,Fx,Fy,Fz and remove the others",
        )

    # Columns may stand in any order: they are taken by their names.
    fields = list(map(header.index, expected[1:-3]))
    forces = list(map(header.index, FORCES))
    by_sensor = table[:, fields].reshape(len(table), -1, 3)
    return by_sensor, UNIT_OF[load_unit][1] * table[:, forces]
