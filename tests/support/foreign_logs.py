"""Trials rewritten as logs of other programs: separators, units, names and clocks of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import openpyxl

RATE_HZ = 100.0


@dataclass(frozen=True)
class Made:
    """A grasp that slips: t_s [T], values [T, 3 S] in N, and when it is held and slips, s."""

    t_s: np.ndarray
    values: np.ndarray
    held_s: tuple[float, float] = (1.0, 4.0)
    slips_s: tuple[float, float] = (3.0, 3.5)

    def words(self, nothing: str, grasp: str, slip: str) -> list[str]:
        """[T] a word for each row."""
        is_held = (self.t_s >= self.held_s[0]) & (self.t_s < self.held_s[1])
        slips = (self.t_s >= self.slips_s[0]) & (self.t_s < self.slips_s[1])
        return np.where(slips, slip, np.where(is_held, grasp, nothing)).tolist()


def made(seed: int, sensors: int = 5, lasts_s: float = 5.0) -> Made:
    """Noise, a grip of 3 N and a tone while it slips; the values have four decimals."""
    t_s = np.arange(round(lasts_s * RATE_HZ)) / RATE_HZ
    values = np.random.default_rng(seed).normal(0.0, 0.02, (len(t_s), 3 * sensors))
    values[:, 2::3] += 3.0 * ((t_s >= 1.0) & (t_s < 4.0))[:, None]
    slips = (t_s >= 3.0) & (t_s < 3.5)
    values[:, 0::3] += slips[:, None] * np.sin(2 * np.pi * 15.0 * t_s)[:, None]
    return Made(t_s, values.round(4))


def axes(sensors: int, form: str = "s{k}_{axis}") -> list[str]:
    """Names of the channels, three a sensor."""
    numbers = range(1, sensors + 1)
    return [form.format(k=k, axis=axis) for k in numbers for axis in "xyz"]


def write_text(
    path: Path,
    names: Sequence[str],
    rows: np.ndarray,
    *,
    separator: str = ",",
    decimal: str = ".",
    head: str = "",
    texts: Sequence[str] | None = None,
    first: Sequence[str] | None = None,
    encoding: str = "utf-8",
    end: str = "\n",
) -> Path:
    """A text table. texts, first: cells [T] of a last and of a first column; names may be []."""
    lines = []
    for k, row in enumerate(rows.tolist()):
        cells = [f"{cell:.10g}".replace(".", decimal) for cell in row]
        before = [first[k]] if first is not None else []
        after = [texts[k]] if texts is not None else []
        lines.append(separator.join(before + cells + after))
    top = [separator.join(names)] if names else []
    text = end.join([*head.splitlines(), *top, *lines]) + end
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode(encoding))
    return path


def write_log(
    path: Path,
    one: Made,
    values: np.ndarray | None = None,
    names: Sequence[str] = (),
    texts: Sequence[str] | None = None,
) -> Path:
    """A table of a grasp: seconds, then its values, or others; names: of all columns."""
    values = one.values if values is None else values
    names = names or ["t", *axes(values.shape[1] // 3)]
    return write_text(path, names, np.column_stack([one.t_s, values]), texts=texts)


def write_sheet(path: Path, rows: Sequence[Sequence[object]], sheet: str = "A") -> Path:
    """A workbook of one sheet."""
    book = openpyxl.Workbook()
    book.active.title = sheet
    for row in rows:
        book.active.append(list(row))
    path.parent.mkdir(parents=True, exist_ok=True)
    book.save(path)
    return path
