"""Text of C: exact numbers, tables of the smallest type, and the templates filled in."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.export.c.graph import BOOL, DOUBLE, FLOAT, INT32, INT64

OUT_TYPES: dict[int, str] = {
    DOUBLE: "f8",
    FLOAT: "f4",
    INT32: "i4",
    INT64: "i4",
    BOOL: "?",
}
"""Element type -> the same as numpy names it, for model.json."""
BYTES = {"double": 8, "int8_t": 1, "uint8_t": 1, "int16_t": 2, "uint16_t": 2}
"""Sizes of C types; all others have 4."""
LINE = 96
"""Longest line of a table."""
Words = Mapping[str, object]
"""What stands in a template between @ -> what replaces it."""


def number(value: Any, c_type: str) -> str:
    """One number as a literal of a C type.

    >>> number(0.1, "double"), number(np.float32(0.5), "float"), number(-3, "int32_t")
    ('0x1.999999999999ap-4', '0x1p-1f', '-3')
    """
    if c_type not in ("double", "float"):
        return str(int(value))
    real = float(value)
    end = "f" if c_type == "float" else ""
    if np.isinf(real):
        sign = "-" if real < 0 else ""
        return f"({sign}({c_type})INFINITY)"

    # whole numbers as such: the C stays readable, and its tables small
    if real == int(real) and abs(real) < 1e6:
        return f"{real:.1f}{end}"

    # hexadecimal digits are exact; zeros at the end are left out
    digits, exponent = real.hex().split("p")
    short_digits = digits.rstrip("0").rstrip(".")
    return f"{short_digits}p{exponent}{end}"


def smallest_type(values: npt.NDArray[Any]) -> str:
    """The smallest C type that holds whole numbers.

    >>> smallest_type(np.array([0, 255])), smallest_type(np.array([-1, 200]))
    ('uint8_t', 'int16_t')
    """
    # 0 as the first value makes an empty table the smallest type
    ends = int(values.min(initial=0)), int(values.max(initial=0))
    return f"{np.result_type(*map(np.min_scalar_type, ends))}_t"


def table(name: str, values: npt.NDArray[Any], c_type: str) -> str:
    """`static const` numbers in a row."""
    numbers = ", ".join(number(value, c_type) for value in values.ravel().tolist())
    body = textwrap.fill(numbers, LINE, initial_indent="    ", subsequent_indent="    ")
    return f"static const {c_type} {name}[{values.size}] = {{\n{body}\n}};\n"


class Tables:
    """The tables of a source file, in the order in which they were asked for; equal ones once.

    n_bytes: of their data.
    """

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._names: dict[tuple[str, bytes], str] = {}
        self.n_bytes = 0

    def add(self, name: str, values: npt.NDArray[Any], c_type: str) -> str:
        """The name of a table with these numbers."""
        # float64 holds the numbers of every C type exactly, so equal bytes are equal tables
        key = (c_type, np.ascontiguousarray(values, dtype=np.float64).tobytes())
        if key not in self._names:
            self._names[key] = name
            size = BYTES.get(c_type, 4)
            self.add_text(name, table(name, values, c_type), size * values.size)
        return self._names[key]

    def add_text(self, name: str, text: str, n_bytes: int) -> None:
        """A table that its owner wrote."""
        self._texts[name] = text
        self.n_bytes += n_bytes

    def text(self) -> str:
        return "\n".join(self._texts.values())


def template(name: str, words: Words) -> str:
    """A file of templates/ with every @WORD@ replaced. Raises KeyError for one without a value."""
    file = files("holdfast.export.c").joinpath("templates", name)
    text = file.read_text(encoding="utf-8")
    return re.sub(r"@([A-Z_]+)@", lambda match: str(words[match[1]]), text)
