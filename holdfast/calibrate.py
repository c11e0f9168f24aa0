"""`holdfast calibrate PATH --out FILE`: known loads -> field to force, judged on probings it never
saw.

PATH is a CSV file with the columns Time, X1..Zn (uT) and Fx, Fy, Fz (N), in which every fingertip
is pressed at least twice; or a folder in the layout of eflesh_calibration (normal_force/ and
shear_force/, a folder a probing).

Every split leaves one probing out. In a CSV file a probing runs from unloaded to unloaded.

The unit of the load in eflesh_calibration is written nowhere ("weight"), so `load_unit` looks for
it in the data and refuses where not exactly one unit fits. Its evidence, printed with every run:

- A reading of exactly -1 is no load: nearly every second row has it, no other reading is below
  zero. It is left out.
- The deeper half of a press gives the pad's stiffness, and its end the largest load. In newtons the
  pad would carry 3.5 kN at 380 N/mm under a probe that an arm holds; in gram-force 34 N at 3.7 N/mm
  (shear: 18 N at 1.1 N/mm).
- The authors publish 0.27 N and 0.12 N. A network is not 250 times better than the best line
  through the same readings, so newtons are out; nor is it worse than a line, so millinewtons are
  out. Gram-force is what is left.
- Centinewtons are 2 % off gram-force, and the data cannot tell these two apart; a column called
  "weight" can.

The field needs no guess: it moves in steps of 2.4 (x, y) and 3.872 (z), or 0.6 and 0.968, which are
16 and 4 times the MLX90393's 0.150 and 0.242 uT.
"""

from __future__ import annotations

import argparse
import csv
import json
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from drivers.calibration import Calibration, fit, rmse_normal, rmse_shear, write_calibration
from edge_runtime.command import path_argument, seed, show
from edge_runtime.contact import NORMAL_FLOOR
from edge_runtime.contract import NORMAL_AXIS, BoolArray, FloatArray, channel_names
from edge_runtime.errors import (
    ChannelError,
    ColumnError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    TooFewGroups,
    UnitError,
)
from edge_runtime.reading import require_lines
from edge_runtime.visible import listed
from edge_runtime.writing import require_writable, write_whole

PUBLISHED_N = {"normal": 0.27, "shear": 0.12}
"""RMSE of eFlesh's network, whose test rows are the last fifth of the probing it was trained on."""
UNITS_N = {"newton": 1.0, "gram-force": 9.80665e-3, "millinewton": 1e-3}
LARGEST_PLAUSIBLE_N = 200.0
"""More than an arm that probes a palm-sized printed pad can push."""
NO_LOAD = -1.0
KINDS = {"normal_force": NORMAL_AXIS, "shear_force": 0}
"""Folder, and the axis its load is on. Which way the pad was sheared is not told; it is called x
here."""
MOST = 1e12
"""Neither a field nor a force, nor a time."""
FORCES = ("Fx", "Fy", "Fz")
UNLOADED_N, LOADED_N = 0.3, 1.0
MIN_UNLOADED = 5
"""Rows below UNLOADED_N that end a probing once LOADED_N was passed."""
N_TREES = 200


@dataclass(frozen=True)
class Probing:
    """field_ut [M, S, 3], tared; load [M, 3] in the study's unit, a column of nan for an axis
    without a reading."""

    name: str
    field_ut: FloatArray
    load: FloatArray


@dataclass(frozen=True)
class Study:
    """Probings of one piece of hardware. load_n: newtons in one unit of the load. rest_ut: [S, 3]
    or None, reversed_: [S] magnets found upside down, or None where polarity says nothing."""

    name: str
    probings: tuple[Probing, ...]
    load_unit: str
    load_n: float
    rest_ut: FloatArray | None
    reversed_: BoolArray | None
    evidence: tuple[str, ...]

    @property
    def field_ut(self) -> FloatArray:
        """[M, S, 3] of all probings."""
        return np.concatenate([one.field_ut for one in self.probings])

    @property
    def force_n(self) -> FloatArray:
        """[M, 3] of all probings."""
        return self.load_n * np.concatenate([one.load for one in self.probings])

    @property
    def blocks(self) -> FloatArray:
        """[M] which probing a row is of."""
        return np.repeat(
            np.arange(len(self.probings), dtype=np.float64),
            [len(one.load) for one in self.probings],
        )


@dataclass(frozen=True)
class Judged:
    """A model's errors: [G, 3] RMSE on each probing by the others; nan where an axis was not
    loaded."""

    name: str
    held_out_n: FloatArray

    def figures(self) -> dict[str, dict[str, Any]]:
        """Per axis family: the root mean square over probings, and each probing's."""
        found = {}
        for axis, of in (("normal", rmse_normal), ("shear", rmse_shear)):
            each = [of(row) for row in self.held_out_n]
            if np.isfinite(each).all():
                found[axis] = {
                    "rmse_n": float(np.sqrt(np.mean(np.square(each)))),
                    "each_probing_n": each,
                }
        return found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "path",
        type=path_argument,
        metavar="PATH",
        help="a CSV file Time,X1..Zn,Fx,Fy,Fz, or eflesh's folder",
    )
    parser.add_argument(
        "--out", type=path_argument, required=True, metavar="FILE", help="the calibration, as JSON"
    )
    parser.add_argument(
        "--json", type=path_argument, metavar="FILE", help="also the figures, as JSON"
    )
    parser.add_argument(
        "--date",
        default=date.today().isoformat(),
        metavar="DAY",
        help="of the loads (default today)",
    )
    parser.add_argument(
        "--seed", type=seed, default=0, metavar="S", help="of the trees compared with (default 0)"
    )


def run(args: argparse.Namespace) -> int:
    """Fit, judge on probings left out, print, write."""
    for target in filter(None, (args.out, args.json)):
        require_writable(target.parent)
    told = []
    for study, target in zip(*_studies_and_targets(args.path, args.out), strict=True):
        calibration, judged = judge(study, args.path.name, args.date, args.seed)
        write_calibration(target, calibration)
        told.append(_as_json(study, judged, args.seed))
        show("\n".join([*_told(study, judged, calibration), f"  written: {target}", ""]))
    if args.json:
        write_whole(args.json, json.dumps({"studies": told}, indent=1, allow_nan=False) + "\n")
    return 0


def _studies_and_targets(path: Path, out: Path) -> tuple[list[Study], list[Path]]:
    studies = read_studies(path)
    return studies, [
        out if k == 0 else out.with_stem(f"{out.stem}.{s.name}") for k, s in enumerate(studies)
    ]


def read_studies(path: Path) -> list[Study]:
    """What PATH holds: one study of a CSV file, or the normal and the shear one of a folder. Raises
    a DataError."""
    if not path.is_dir():
        return [_csv_study(path)]
    kinds = [kind for kind in KINDS if (path / kind).is_dir()]
    if not kinds:
        raise DataNotFound(
            f"no {' or '.join(KINDS)} in this folder",
            where=path,
            next_step="give eflesh_calibration, or a CSV file",
        )
    return [_probed_study(path / kind, KINDS[kind]) for kind in kinds]


def judge(study: Study, source: str, day: str, seed: int) -> tuple[Calibration, list[Judged]]:
    """The calibration of all probings; and the line and the trees, judged on each probing by the
    others."""
    fitted = fit(
        study.field_ut,
        study.force_n,
        study.blocks,
        reversed_=study.reversed_,
        source=f"{source}/{study.name}",
        date=day,
        load_unit=study.load_unit,
    )
    plain = fitted.calibration
    calibration = Calibration(plain.matrix, study.rest_ut, plain.reversed, plain.meta)
    return calibration, [
        Judged("one matrix", fitted.held_out_n),
        Judged("extra trees", _trees(study, seed)),
    ]


def _trees(study: Study, seed: int) -> FloatArray:
    """[G, 3] RMSE of extra trees on each probing by the others."""
    from sklearn.ensemble import ExtraTreesRegressor

    field, force, blocks = (
        study.field_ut.reshape(len(study.blocks), -1),
        study.force_n,
        study.blocks,
    )
    axes = np.flatnonzero(np.isfinite(force).all(axis=0))
    rmse = np.full((len(study.probings), 3), np.nan)
    for block in range(len(study.probings)):
        out = blocks == block
        model = ExtraTreesRegressor(N_TREES, min_samples_leaf=3, random_state=seed)
        model.fit(field[~out], force[~out][:, axes].squeeze())
        error = model.predict(field[out]).reshape(-1, len(axes)) - force[out][:, axes]
        rmse[block, axes] = np.sqrt(np.mean(error**2, axis=0))
    return rmse


def _told(study: Study, judged: Sequence[Judged], calibration: Calibration) -> Iterator[str]:
    n_sensors = len(calibration.matrix)
    yield f"{study.name}: {len(study.probings)} probings, {calibration.meta.n} rows, {n_sensors} sensors"
    yield from (f"  {line}" for line in study.evidence)
    for model in judged:
        for axis, figure in model.figures().items():
            each = ", ".join(f"{value:.2f}" for value in figure["each_probing_n"])
            yield (
                f"  {model.name}, {axis}: RMSE {figure['rmse_n']:.2f} N on a probing left out ({each}); "
                f"eFlesh publishes {PUBLISHED_N[axis]} N, tested on later rows of the same probing"
            )


def _as_json(study: Study, judged: Sequence[Judged], seed: int) -> dict[str, Any]:
    return {
        "study": study.name,
        "probings": [one.name for one in study.probings],
        "rows": len(study.blocks),
        "sensors": study.field_ut.shape[1],
        "load_unit": study.load_unit,
        "evidence": list(study.evidence),
        "seed": seed,
        "published_n": PUBLISHED_N,
        "models": {model.name: model.figures() for model in judged},
    }


# A folder of probings, as eflesh_calibration


def _probed_study(folder: Path, axis: int) -> Study:
    places = sorted(path_argument for path_argument in folder.iterdir() if path_argument.is_dir())
    if len(places) < 2:
        raise TooFewGroups(
            f"{len(places)} probings", where=folder, next_step="one is held out: give at least two"
        )
    read = [_read_probing(path_argument, axis) for path_argument in places]
    probings = tuple(probing for probing, _, _ in read)
    if len({one.field_ut.shape[1] for one in probings}) > 1:
        raise ChannelError(
            "probings of different numbers of sensors", where=folder, next_step="split the folder"
        )
    depth_mm = np.concatenate([depth for _, depth, _ in read])
    loads = np.concatenate([one.load[:, axis] for one in probings])
    missing = f"-1 stands for no reading in {sum(m for _, _, m in read)} rows, left out; no other reading is below zero"
    unit, evidence = load_unit(probings, axis, loads, depth_mm)
    return Study(folder.name, probings, unit, UNITS_N[unit], None, None, (missing, *evidence))


def _read_probing(folder: Path, axis: int) -> tuple[Probing, FloatArray, int]:
    """(probing, depth [M] mm of the probe, rows without a reading). The field is tared before every
    press."""
    field, states = _table(folder / "sensor_post_baselines.csv"), _table(folder / "states.csv")
    if (field.shape[1] - 1) % 3 or states.shape[1] != 5 or len(field) != len(states):
        raise ColumnError(
            f"{field.shape[1]} columns of fields, {states.shape[1]} of states, {len(field)} and {len(states)} rows",
            where=folder,
            next_step="time and three columns a sensor; time, x, y, z, load; row for row",
        )
    load = states[:, 4]
    read = load != NO_LOAD
    if (load[read] < 0.0).any():
        raise UnitError(
            "loads below zero beside the -1 for no reading",
            where=folder,
            next_step="look at states.csv",
        )
    three = np.full((int(read.sum()), 3), np.nan)
    three[:, axis] = load[read]
    depth_mm = states[:, 3].max() - states[read, 3]
    return (
        Probing(folder.name, field[read, 1:].reshape(len(three), -1, 3), three),
        depth_mm,
        int((~read).sum()),
    )


def load_unit(
    probings: Sequence[Probing], axis: int, loads: FloatArray, depth_mm: FloatArray
) -> tuple[str, tuple[str, ...]]:
    """(unit of the load column, the evidence): the readings and the published error leave one unit,
    else UnitError."""
    published = PUBLISHED_N["normal" if axis == NORMAL_AXIS else "shear"]
    blocks = np.repeat(np.arange(len(probings)), [len(one.load) for one in probings])
    line = fit(
        np.concatenate([one.field_ut for one in probings]),
        np.concatenate([one.load for one in probings]),
        blocks,
    )
    units_rmse = float(np.sqrt(np.mean(line.held_out_n[:, axis] ** 2)))
    stiffness = _stiffness_per_mm(loads, depth_mm)
    lines = [
        f"load column: steps of {_resolution(loads):g}, up to {loads.max():.0f} at {depth_mm.max():.0f} mm"
    ]
    left = []
    for unit, newton in UNITS_N.items():
        ratio = published / (units_rmse * newton)
        fits = loads.max() * newton < LARGEST_PLAUSIBLE_N and 0.05 <= ratio <= 1.0
        left += [unit] if fits else []
        lines.append(
            f"as {unit}: largest {loads.max() * newton:.4g} N, stiffness {stiffness * newton:.3g} N/mm, the published "
            f"{published} N would be {ratio:.2g} of a line's error: {'possible' if fits else 'out'}"
        )
    if len(left) != 1:
        raise UnitError(
            f"the load column fits {' and '.join(left) or 'no unit we know'}",
            cause="; ".join(lines),
            next_step="ask who recorded it",
        )
    doubt = (
        "; centinewton (2 % more) cannot be told apart by the data"
        if left == ["gram-force"]
        else ""
    )
    return left[0], (*lines, f"taken as {left[0]}{doubt}")


def _resolution(loads: FloatArray) -> float:
    """Smallest step between two readings."""
    return float(np.round(np.diff(np.unique(loads)).min(), 6))


def _stiffness_per_mm(loads: FloatArray, depth_mm: FloatArray) -> float:
    """Slope of the load over the deepest half of the way, least squares."""
    deep = depth_mm > 0.5 * depth_mm.max()
    return float(np.polyfit(depth_mm[deep], loads[deep], 1)[0])


def _table(path: Path) -> FloatArray:
    """A CSV file of numbers without a header."""
    try:
        require_lines(path)
        table = np.loadtxt(path, delimiter=",", ndmin=2)
    except OSError:
        raise DataNotFound(
            "no such file, or unreadable", where=path, next_step="copy the folder again"
        ) from None
    except ValueError as error:
        raise NotANumber(str(error), where=path, next_step="write plain decimal numbers") from None
    if not table.size or not np.isfinite(table).all():
        raise NotANumber("empty, or not finite", where=path, next_step="copy it again")
    return table


# One CSV file with loads beside the fields


def _csv_study(path: Path) -> Study:
    values, force = _read_csv(path)
    lost = ~(np.isfinite(values).all(axis=1) & np.isfinite(force).all(axis=1))
    field, force = values[~lost].reshape(int((~lost).sum()), -1, 3), force[~lost]
    starts = probing_starts(np.linalg.norm(force, axis=1))
    if len(starts) < 2:
        raise TooFewGroups(
            f"{len(starts)} probings",
            where=path,
            cause=f"the load never passes {LOADED_N:g} N and comes back below {UNLOADED_N:g} N for {MIN_UNLOADED} rows",
            next_step="press every fingertip at least twice, with a pause",
        )
    bounds = zip(starts, [*starts[1:], len(force)], strict=True)
    pieces = [_tared(field[a:b], force[a:b]) for a, b in bounds]
    probings = tuple(
        Probing(f"probing {k + 1}", moved, force) for k, (moved, force, _) in enumerate(pieces)
    )
    rest_ut = np.median([rest for _, _, rest in pieces], axis=0)
    reversed_ = rest_ut[:, NORMAL_AXIS] < -NORMAL_FLOOR["uT"]
    names = ", ".join(str(k + 1) for k in np.flatnonzero(reversed_)) or "none"
    evidence = (
        f"{int(lost.sum())} rows with a lost value left out; sensors with a reversed magnet: {names}",
    )
    return Study(path.stem, probings, "N", 1.0, rest_ut, reversed_, evidence)


def _tared(field: FloatArray, force: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(field less its rest, force, rest [S, 3]): the median of the unloaded rows the probing begins
    with."""
    loaded = np.flatnonzero(np.linalg.norm(force, axis=1) >= UNLOADED_N)
    rest = np.median(field[: loaded[0]], axis=0)
    return field - rest, force, rest


def probing_starts(load_n: FloatArray) -> list[int]:
    """First rows of probings: of each pause (MIN_UNLOADED rows below UNLOADED_N) that is followed
    by a press.

    >>> probing_starts(np.array([0.0] * 6 + [2.0] * 3 + [0.0] * 6 + [2.0] + [0.0] * 7))
    [0, 9]
    """
    pauses = [(a, b) for a, b in _runs(load_n < UNLOADED_N) if b - a >= MIN_UNLOADED]
    ends = [a for a, _ in pauses[1:]] + [len(load_n)]
    return [
        a
        for (a, b), end in zip(pauses, ends[: len(pauses)], strict=True)
        if (load_n[b:end] > LOADED_N).any()
    ]


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """(first, past the last) of every run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _read_csv(path: Path) -> tuple[FloatArray, FloatArray]:
    """(values [T, C] uT, force [T, 3] N)."""
    header = _header(path)
    n_sensors = sum(name not in ("Time", *FORCES) for name in header) // 3
    wanted = ("Time", *channel_names(n_sensors), *FORCES)
    if n_sensors == 0 or sorted(header) != sorted(wanted):
        odd = sorted(set(header) ^ set(wanted)) or ["some twice"]
        raise ColumnError(
            f"columns missing, doubled or unknown: {listed(odd)}",
            where=path,
            next_step="Time,X1,Y1,Z1,..,Fx,Fy,Fz",
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no rows: said below
            table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2, encoding="utf-8-sig")
    except ValueError as error:
        raise NotANumber(
            str(error), where=path, next_step="write nan for a value that was lost"
        ) from None
    if not table.size:
        raise EmptyRecording("no rows", where=path, next_step="record it again")
    if table.shape[1] != len(header):
        raise ColumnError(
            f"{table.shape[1]} columns under a header of {len(header)}",
            where=path,
            next_step="write a name for each",
        )
    if (np.abs(table[np.isfinite(table)]) > MOST).any():
        raise NotANumber(
            f"a number beyond {MOST:g}", where=path, next_step="write fields in uT and forces in N"
        )
    columns = {name: table[:, index] for index, name in enumerate(header)}
    values = np.column_stack([columns[name] for name in channel_names(n_sensors)])
    return values, np.column_stack([columns[name] for name in FORCES])


def _header(path: Path) -> list[str]:
    try:
        require_lines(path)
        with path.open(newline="", encoding="utf-8-sig") as lines:
            return [name.strip() for name in next(csv.reader(lines), [])]
    except OSError as error:
        raise DataNotFound(
            f"cannot be read ({error.strerror})", where=path, next_step="check the path"
        ) from None
    except (UnicodeDecodeError, csv.Error):
        raise NotANumber(
            "no CSV text file", where=path, next_step="Time,X1,Y1,Z1,..,Fx,Fy,Fz"
        ) from None
