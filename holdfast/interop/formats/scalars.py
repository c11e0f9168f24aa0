"""What JSON beside a log says of its trial: facts as one row, lists of events as tables."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.column_map import flat_fields
from holdfast.core.errors import EmptyRecording
from holdfast.core.schema import message_of, text_of
from holdfast.interop.formats.streams import Columns, ForeignLog, Stream, text_column
from holdfast.interop.formats.tables import fields_of

MOST_FACTS = 60
"""An object with more is no description of a trial."""
OF_A_LIST = re.compile(r"^$|(^|\.)\d+(\.|$)")
"""In the name of a leaf that stands in a list; a number alone has no name."""


def read_log(path: Path, name: str) -> ForeignLog:
    """The facts of an object, without a name, then a table for each list of objects, by its name.

    Facts are numbers and texts; null is nan. A list of numbers is a table of one column. Raises
    EmptyRecording for other JSON.
    """
    value = message_of(text_of(path))
    columns: Columns = {}
    for key, fact in flat_fields(value).items():
        if not OF_A_LIST.search(key):
            is_text = isinstance(fact, str | bool)
            columns[key] = text_column([fact]) if is_text else np.array([fact], float)
    tables = [*_tables(value, "list")]
    if len(columns) > MOST_FACTS or not (columns or tables):
        raise EmptyRecording("holds no facts of a trial")
    return ForeignLog(path, name, (Stream(columns), *tables))


def _tables(value: Any, name: str) -> Iterator[Stream]:
    """Each list in a value as a table without stamps of its own; of values, one column of them."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _tables(inner, key)
    elif isinstance(value, list):
        rows = [one if isinstance(one, dict) else {name: one} for one in value]
        yield Stream(fields_of(rows), name=name)
