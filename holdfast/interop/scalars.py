"""What a JSON object beside a log says of its trial, as a table of one row."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from holdfast.core.column_map import flat_fields
from holdfast.core.errors import NotANumber
from holdfast.core.schema import json_of, text_of
from holdfast.interop.streams import Columns, ForeignLog, Stream, text_column

MOST_FACTS = 60
"""An object with more is no description of a trial."""


def read_log(path: Path, name: str) -> ForeignLog:
    """The numbers and texts of an object; null is nan. Raises NotANumber for other JSON."""
    value = json_of(text_of(path))
    facts = flat_fields(value) if isinstance(value, dict) else {}
    if not 0 < len(facts) <= MOST_FACTS:
        raise NotANumber("holds no facts of a trial", where=path)
    columns: Columns = {}
    for key, fact in facts.items():
        is_text = isinstance(fact, str | bool)
        number = np.nan if fact is None else fact
        columns[key] = text_column([fact]) if is_text else np.array([number], float)
    return ForeignLog(path, name, (Stream(columns),))
