"""Parquet tables by pyarrow, which only this module imports; and trials as such tables.

A trial is `<name>.parquet`, one row a sample: `Time` (s from the first sample), `X1` .. `Zn`,
`valid1` .. `validn`, `label` and, the same in all rows, `trial`, `person`, `object`, `action`. A
lost value and a missing label are null. Units stand in the metadata of the columns, and what else
is known of the trial in that of the table, under `holdfast`, as JSON. `read_log` reads any table.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import Json, channel_names
from holdfast.core.errors import NotANumber, needs_extra
from holdfast.core.schema import json_of
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.interop.payload import NO_LABEL, TrialPayload
from holdfast.interop.streams import Columns, ForeignLog, Stream, text_column

with needs_extra("parquet"):
    import pyarrow as pa
    import pyarrow.parquet as pq

KEY = "holdfast"
"""Of the table's metadata, where what is known of the trial stands as JSON."""


def write_trials(trials: Iterable[TrialPayload], folder: Path) -> None:
    """One file for each trial below a folder."""
    for trial in trials:
        write_table(folder / f"{trial.name}.parquet", table_of(trial))


def table_of(trial: TrialPayload) -> Any:
    """A trial as a pyarrow.Table."""
    fields: list[Any] = []
    arrays: list[Any] = []

    def add(name: str, array: Any, note: dict[str, str] | None = None) -> None:
        fields.append(pa.field(name, array.type, metadata=note))
        arrays.append(array)

    add(TIME_COLUMN, pa.array(trial.t_s), {"unit": "s"})
    for channel, name in enumerate(channel_names(trial.n_sensors)):
        values = trial.values[:, channel]
        # Null says "no value" in every reader; nan is a float like any other.
        array = pa.array(values, mask=~np.isfinite(values))
        add(name, array, {"unit": trial.unit})

    for sensor in range(trial.n_sensors):
        add(f"valid{sensor + 1}", pa.array(trial.valid[:, sensor]))

    names = np.array(trial.situations(), dtype=object)
    labels = pa.array(names, pa.string(), mask=trial.label == NO_LABEL)
    labels_by = {"by": str(trial.about["labels_by"])}
    # Texts that repeat in every row are stored once, by a dictionary.
    add("label", labels.dictionary_encode(), labels_by)
    for key in ("trial", "person", "object", "action"):
        text = pa.scalar(trial.about[key], pa.string())
        column = pa.repeat(text, len(trial.t_s))
        add(key, column.dictionary_encode())

    schema = pa.schema(fields, metadata={KEY: json.dumps(trial.about)})
    return pa.table(arrays, schema=schema)


def write_rows(path: Path, rows: list[Json]) -> None:
    """A table of objects with the same keys."""
    write_table(path, pa.Table.from_pylist(rows))


def write_columns(path: Path, columns: Mapping[str, Any]) -> None:
    """A table of columns; an array [T, k] becomes a column of lists of k."""
    arrays = {name: _column(values) for name, values in columns.items()}
    write_table(path, pa.table(arrays))


def _column(values: Any) -> Any:
    """A pyarrow array of an array [T], or of lists of k from an array [T, k]."""
    array = np.asarray(values)
    if array.ndim == 1:
        return pa.array(array)

    # A list of fixed length stores no offsets, and readers see its length in the type.
    cells = pa.array(array.reshape(-1))
    return pa.FixedSizeListArray.from_arrays(cells, array.shape[1])


def write_table(path: Path, table: Any) -> None:
    """Write a pyarrow.Table, compressed with zstd."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path, compression="zstd")


def read_log(path: Path, name: str) -> ForeignLog:
    """Any Parquet file as a log of one table. Raises NotANumber."""
    columns, about = read_columns(path)
    return ForeignLog(path, name, (Stream(columns),), about)


def read_columns(path: Path) -> tuple[Columns, Json]:
    """(columns, what `holdfast convert` says of the trial) of a Parquet file.

    A column of lists of one length, or of structs, becomes `name.0`, `name.1`, .. or `name.field`;
    a null is nan or "". Raises NotANumber for a file that is none.
    """
    try:
        # the path itself may look like a set in pieces (a=1/), which only a folder is
        table = pq.ParquetFile(path).read()
        about = json_of((table.schema.metadata or {}).get(KEY.encode(), b"{}"))
        while any(pa.types.is_struct(field.type) for field in table.schema):
            table = table.flatten()
        columns: Columns = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            columns |= _cells(name, column.combine_chunks())
    except Exception as error:  # pyarrow raises whatever its parsing meets
        raise NotANumber(
            f"cannot be read as Parquet ({type(error).__name__})",
            where=path,
            cause="another format, or an interrupted copy",
            next_step="open it with another reader to see what is left",
        ) from None

    return columns, about


def _cells(name: str, array: Any) -> Columns:
    """A column of numbers, of texts, or the columns of a list of one length; none of others."""
    if pa.types.is_dictionary(array.type):
        array = array.dictionary_decode()
    kind = array.type
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        return _of_lists(name, array)
    if pa.types.is_timestamp(kind):
        array = array.cast(pa.timestamp("ns")).cast(pa.int64())
    elif pa.types.is_boolean(kind):
        array = array.cast(pa.int8())
    elif pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return {name: text_column(array.to_pylist())}
    elif not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        return {}

    # pyarrow makes floats of whole numbers with a null
    column = array.to_numpy(zero_copy_only=False)
    is_whole = column.dtype.kind in "iu"
    return {name: column.astype(np.int64 if is_whole else np.float64)}


def _of_lists(name: str, array: Any) -> Columns:
    """`name.0`, `name.1`, .. of lists that all have the same length."""
    lengths = set(array.value_lengths().to_pylist())
    if len(lengths) != 1 or lengths == {None}:
        return {}
    (wide,) = lengths
    columns: Columns = {}
    for inner in _cells(name, array.flatten()).values():
        rows = inner.reshape(-1, wide)
        columns = {f"{name}.{k}": rows[:, k] for k in range(wide)}

    return columns
