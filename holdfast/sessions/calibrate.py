"""A calibration by least squares from field to force, and its errors on loads that it never saw.

Loads beside fields come as a CSV file. A probing is a series of presses from unloaded to unloaded.
Every split leaves one probing out: rows of one press are too alike to judge a model that has seen
some of them. And the bias of a hand that touches nothing, measured now.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    UNIT_OF,
    BoolArray,
    FloatArray,
    IntArray,
    Json,
    channel_names,
)
from holdfast.core.errors import (
    ColumnError,
    DataError,
    DataNotFound,
    NotANumber,
    TooFewGroups,
    count_of,
)
from holdfast.core.source import Source, Turns
from holdfast.drivers.calibration import MIN_BIAS_ROWS, Bias, Calibration, bias_of, turn
from holdfast.live.hand_files import HARDEST_N

RATE_HZ = 100.0
"""Of a hand, which has no fixed rate."""


@dataclass(frozen=True)
class MeasuredBias:
    """A bias, what is wrong with it in words, and whether it is good.

    A reversed magnet is reported but good: the model's preparation inverts it.
    """

    bias: Bias
    warnings: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether there is no warning but that of a reversed magnet."""
        return len(self.warnings) == int(self.bias.reversed.any())


def measure_bias(
    source: Source, clock: Any, report: Callable[[str], None], seconds: float
) -> MeasuredBias:
    """Read the hand for some seconds and judge what it reads; warnings go to `report`.

    A slow source is read for as long as it needs for MIN_BIAS_ROWS rows.
    """
    # what is announced is what a person has to keep still for
    seconds = max(seconds, MIN_BIAS_ROWS / _bias_rate_hz(source))
    report(f"measuring the bias: leave the hand open, touch nothing for {seconds:g} s")
    bias, warnings = bias_of(read_rows(source, clock, seconds), source.unit)
    for warning in warnings:
        report(f"warning: {warning}")
    return MeasuredBias(bias, tuple(warnings))


def require_good(measured: MeasuredBias, consequence: str) -> None:
    """Raise DataError for a bias that is not good; consequence: what then is not done."""
    if not measured.good:
        raise DataError(
            f"the bias is not good, {consequence}",
            cause="; ".join(measured.warnings),
            next_step="correct that, or add --anyway",
        )


def read_rows(source: Source, clock: Any, seconds: float) -> FloatArray:
    """[T, C] of a source at its rate or at RATE_HZ, nan where a sensor is not valid.

    It is read for some seconds, and on until there are MIN_BIAS_ROWS rows or the source ends.
    """
    rate_hz = _bias_rate_hz(source)
    turns = Turns(source, clock, 1e9 / rate_hz)
    rows: list[FloatArray] = []
    # a busy machine skips turns, and fewer rows are read than the seconds have turns
    while turns.number < round(seconds * rate_hz) or len(rows) < MIN_BIAS_ROWS:
        turns.wait()
        measured = source.read()
        # a recording that is shorter than asked for is measured as far as it goes
        if measured is None:
            break
        # a finger is valid or not with all three of its axes
        valid = np.repeat(measured.valid, 3)
        rows.append(np.where(valid, measured.values, np.nan))
        turns.end()

    return np.array(rows).reshape(-1, source.n_channels)


def _bias_rate_hz(source: Source) -> float:
    # a stream sends at its own rate, and a hand is read as asked
    return source.rate_hz or RATE_HZ


# -- loads beside fields

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


# -- a calibration

MIN_GAIN_ROWS = 10
"""Rows of light touches with shear: fewer show no shear gain."""
LIGHT_N = 3.0
"""The shear gain is measured below this normal force: silicone stiffens, and slips are light."""
TOUCHED_N = 0.3
"""And above this one, below which a ratio is mostly noise."""
MOST_LAG_ROWS, BETTER_SHARE = 30, 0.7
"""Loads lag the field where a shift by at most so many rows leaves this share of the error."""
SHEAR_SHARE = 0.1
"""The load's shear over its normal force, at least."""


@dataclass(frozen=True)
class AxisError:
    """Root mean square error over the probings left out, and on each, N."""

    rmse_n: float
    each_probing_n: list[float]


@dataclass(frozen=True)
class Fit:
    """A calibration, and held_out_n [G, 3]: RMSE on each probing of a fit to the others."""

    calibration: Calibration
    held_out_n: FloatArray

    def errors(self) -> dict[str, AxisError]:
        """The errors on held-out loads, for normal and shear."""
        errors = {}
        # Shear has two axes, so its error is that of a vector.
        shear = np.delete(self.held_out_n, NORMAL_AXIS, axis=1)
        each = {
            "normal": self.held_out_n[:, NORMAL_AXIS],
            "shear": np.sqrt(np.mean(shear**2, axis=1)),
        }
        for axis, rmse_n in each.items():
            whole = float(np.sqrt(np.mean(rmse_n**2)))
            errors[axis] = AxisError(whole, rmse_n.tolist())
        return errors


def calibrate(loads: LoadSet, source: str, date: str) -> Fit:
    """The calibration of all probings: force = sum over sensors of matrix (field - rest).

    Raises DataError where the loads do not move the field in as many directions as they have.
    """
    force = loads.force_n
    # The fields are less their rest: no load means no force, whatever the rows say.
    moved = turn(loads.reversed_) * loads.field_ut
    matrix = _solve(moved, force)

    held_out = []
    for block in np.unique(loads.blocks):
        out = loads.blocks == block
        others = _solve(moved[~out], force[~out])
        held_out.append(_rmse(moved[out], force[out], others))

    # Several sensors under one load share one residual: no load is known for each of them.
    residual = np.tile(_rmse(moved, force, matrix), (len(matrix), 1))
    gain = measured_shear_gain(loads.force_n, np.einsum("sij,tsj->ti", matrix, moved))
    fitted = Calibration(
        matrix,
        loads.rest_ut,
        loads.reversed_,
        source=f"{source}/{loads.name}",
        date=date,
        load_unit=loads.load_unit,
        n=len(force),
        residual_n=residual,
        shear_gain=gain,
    )
    return Fit(fitted, np.array(held_out))


def doubts(loads: LoadSet) -> list[str]:
    """What would make the calibration wrong: sign, unit and time of the loads."""
    found = []
    load_n = np.linalg.norm(loads.force_n, axis=1)
    if np.median(loads.force_n[load_n > TOUCHED_N, NORMAL_AXIS]) < 0.0:
        found.append("the presses have a negative Fz; next: turn its sign, +z presses")
    if load_n.max() > HARDEST_N:
        found.append(
            f"loads of up to {load_n.max():.4g} N; likely cause: grams taken for newtons; "
            "next: --load-unit gf, or mN"
        )
    lag = _lag_rows(loads)
    if lag:
        late, other = ("loads", "field") if lag > 0 else ("field", "loads")
        found.append(
            f"the {late} come {abs(lag)} rows after the {other}; next: put both on one clock"
        )
    return found


def _lag_rows(loads: LoadSet) -> int:
    """By how many rows the loads follow the field, where that explains them much better; else 0."""
    moved = loads.field_ut.reshape(len(loads.field_ut), -1)
    most = min(MOST_LAG_ROWS, len(moved) // 4)
    rmse_n = {}
    for lag in range(-most, most + 1):
        rows = slice(most, len(moved) - most)
        force = np.roll(loads.force_n, -lag, axis=0)[rows]
        solution = np.linalg.lstsq(moved[rows], force, rcond=None)[0]
        rmse_n[lag] = float(np.sqrt(np.mean((moved[rows] @ solution - force) ** 2)))
    best = min(rmse_n, key=lambda lag: rmse_n[lag])
    return best if rmse_n[best] < BETTER_SHARE * rmse_n[0] else 0


def _solve(moved: FloatArray, force: FloatArray) -> FloatArray:
    """[S, 3, 3] by least squares."""
    flat = moved.reshape(len(moved), -1)
    # One matrix for all sensors at once: only their sum was measured.
    solution, _, rank, _ = np.linalg.lstsq(flat, force, rcond=None)
    if rank < 3:
        raise DataError(
            f"loads along 3 axes move the field in {rank} directions only",
            cause="a lost magnet, or a probe that was pressed in one direction only",
            next_step="check the fields, then press and shear to every side",
        )
    # lstsq gives [S * 3 fields, forces]; a sensor's matrix is [forces, 3 fields].
    return np.array(solution.T.reshape(3, -1, 3).transpose(1, 0, 2))


def _rmse(moved: FloatArray, force: FloatArray, matrix: FloatArray) -> FloatArray:
    """[3] root mean square error of the sum of the shares."""
    error = np.einsum("sij,tsj->ti", matrix, moved) - force
    root: FloatArray = np.sqrt(np.mean(error**2, axis=0))
    return root


def measured_shear_gain(true_n: FloatArray, read_n: FloatArray) -> float | None:
    """Ratio of shear and normal force as read, over that of the load: the median of light touches.

    true_n, read_n: [M, 3]. None where fewer than MIN_GAIN_ROWS rows have both. The map is one for
    all loads, and silicone stiffens, so a light touch reads another ratio than it has.
    """
    true_ratio = _shear_over_normal(true_n)
    normal_n = true_n[:, NORMAL_AXIS]
    light = (normal_n > TOUCHED_N) & (normal_n < LIGHT_N) & (true_ratio > SHEAR_SHARE)
    light &= read_n[:, NORMAL_AXIS] > 0.0
    if light.sum() < MIN_GAIN_ROWS:
        return None
    gains = _shear_over_normal(read_n[light]) / true_ratio[light]
    return float(np.median(gains))


def _shear_over_normal(force_n: FloatArray) -> FloatArray:
    """[M] of forces [M, 3]."""
    shear_n = np.delete(force_n, NORMAL_AXIS, axis=1)
    normal_n = np.maximum(force_n[:, NORMAL_AXIS], 1e-9)
    ratio: FloatArray = np.sqrt((shear_n**2).sum(axis=1)) / normal_n
    return ratio


def in_words(found: Json) -> list[str]:
    """The JSON object of `as_json` as lines for people."""
    turned = ", ".join(map(str, found["reversed"])) or "none"
    lines = [
        f"{found['loads']}: {found['probings']} probings, {found['rows']} rows, "
        f"{found['sensors']} sensors, loads in {found['load_unit']}",
        f"  {count_of(found['rows_lost'], 'row')} with a lost value left out; "
        f"sensors with a reversed magnet: {turned}",
    ]
    for axis, error in found["errors"].items():
        each = ", ".join(f"{value:.2f}" for value in error["each_probing_n"])
        rmse_n = error["rmse_n"]
        lines.append(f"  {axis}: RMSE {rmse_n:.2f} N on probings left out ({each})")

    gain = found["shear_gain"]
    if gain is None:
        lines.append(
            "  shear gain: not measured, because no load has shear at a light touch; the friction "
            "estimate will take 1 (shear_gain in the file can be one that is known)"
        )
    else:
        lines.append(
            f"  shear gain: {gain:.3g} (shear over normal force, as read over true)"
        )
    return lines + [f"  warning: {line}" for line in found["warnings"]]


def as_json(loads: LoadSet, fit: Fit) -> Json:
    """The data, the errors on probings left out and the shear gain."""
    return {
        "loads": loads.name,
        "probings": len(fit.held_out_n),
        "rows": len(loads.blocks),
        "rows_lost": loads.n_lost,
        "sensors": loads.field_ut.shape[1],
        "reversed": [int(k) + 1 for k in np.flatnonzero(loads.reversed_)],
        "load_unit": loads.load_unit,
        "errors": {axis: asdict(error) for axis, error in fit.errors().items()},
        "shear_gain": fit.calibration.shear_gain,
        "warnings": doubts(loads),
    }
