"""Parquet tables by pyarrow, which only this module imports; and trials as such tables.

A trial is `<name>.parquet`, one row a sample: `Time` (s from the first sample), `X1` .. `Zn`,
`valid1` .. `validn`, `label` and, the same in all rows, `trial`, `person`, `object`, `action`. A
lost value and a missing label are null. Units stand in the metadata of the columns, and what else
is known of the trial in that of the table, under `holdfast`, as JSON.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import channel_names
from holdfast.core.errors import needs_extra
from holdfast.core.reading import Json
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.interop.payload import NO_LABEL, TrialPayload

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


def write_frame(path: Path, frame: Any) -> None:
    """A pandas data frame with its index."""
    write_table(path, pa.Table.from_pandas(frame))


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
