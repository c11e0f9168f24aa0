"""Lines of a TOML file: where a key stands, for errors; and plain tables written as text.

tomllib gives values without their lines. Our files have the plain form: a key a line, tables
by their heads; a key in another form has the line of its table.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

_HEAD = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?")
_KEY = re.compile(r"""\s*(?:"([^"]*)"|'([^']*)'|([A-Za-z0-9_.-]+))\s*=""")


def line_of(text: str, key: str) -> int | None:
    """The line of a key such as `unit`, `time.unit`, `sensors[2].x` or `sensors[2]`, from 1.

    For a key that is not there, the line of its table; None where that is not there either.
    """
    tables = _lines_of_keys(text)
    while key:
        if key in tables:
            return tables[key]
        key, _, _ = key.rpartition(".")
    return None


def _lines_of_keys(text: str) -> dict[str, int]:
    """Key -> line, for the plain form that maps have: a key a line, tables by their heads."""
    found: dict[str, int] = {}
    seen: dict[str, int] = {}
    table = ""
    for number, line in enumerate(text.split("\n"), start=1):
        head = _HEAD.fullmatch(line)
        if head:
            table = head[2]
            if head[1] == "[[":
                k = seen[table] = seen.get(table, -1) + 1
                found.setdefault(table, number)
                table = f"{table}[{k}]"
            found.setdefault(table, number)
            continue
        key = _KEY.match(line)
        if key:
            name = next(group for group in key.groups() if group is not None)
            found.setdefault(f"{table}.{name}" if table else name, number)
    return found


def line_naming(text: str, column: str) -> int | None:
    """The first line whose value is this column."""
    for number, line in enumerate(text.split("\n"), start=1):
        value = line.partition("=")[2].strip()
        if value.split("#")[0].strip().strip("\"'").removeprefix("-") == column:
            return number
    return None


def toml_text(text: str) -> str:
    """A text as TOML writes it."""
    # JSON's escapes are TOML's, but for DEL, which JSON leaves as it is
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def table_lines(name: str, table: Mapping[str, Any]) -> list[str]:
    """A table; tables within it come after its own keys."""
    lines = [f"[{name}]"]
    within = []
    for key, value in table.items():
        if isinstance(value, dict):
            within += ["", *table_lines(f"{name}.{_toml_key(key)}", value)]
        else:
            lines.append(f"{_toml_key(key)} = {_toml_value(value)}")
    return lines + within


def _toml_key(key: str) -> str:
    return key if re.fullmatch("[A-Za-z0-9_-]+", key) else toml_text(key)


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return toml_text(value)
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_toml_value, value))}]"
    return repr(value)
