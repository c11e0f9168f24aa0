"""Parquet tables by pyarrow, which only this module imports; and trials as such tables.

A trial is `<name>.parquet`, one row a sample: `Time` (s from the first sample), `X1` .. `Zn`,
`valid1` .. `validn`, `label` and, the same in all rows, `trial`, `person`, `object`, `action`. A
lost value and a missing label are null. Units stand in the metadata of the columns, and what else
is known of the trial in that of the table, under `holdfast`, as JSON. `read_log` reads any table.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import SITUATIONS, channel_names, valid_names
from holdfast.core.errors import needs_extra
from holdfast.core.schema import json_of
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.interop.formats.payload import TrialPayload
from holdfast.interop.formats.streams import Columns, ForeignLog, Stream, text_column

with needs_extra("parquet"):
    import pyarrow as pa
    import pyarrow.parquet as pq


def write_trials(trials: Iterable[TrialPayload], folder: Path) -> None:
    """One file for each trial below a folder, compressed with zstd."""
    for trial in trials:
        path = folder / f"{trial.recording.trial_id}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table_of(trial), path, compression="zstd")


def table_of(trial: TrialPayload) -> Any:
    """A trial as a pyarrow.Table."""
    recording = trial.recording
    channels = channel_names(recording.n_sensors)
    names = [TIME_COLUMN, *channels, *valid_names(recording.n_sensors)]
    cells = [trial.t_s, *trial.values.T, *recording.valid.T]
    # Null says "no value" in every reader; nan is a float like any other.
    columns = {
        name: pa.array(one, from_pandas=True)
        for name, one in zip(names, cells, strict=True)
    }
    # the last one is that of -1
    texts = np.array([*SITUATIONS, None])
    columns["label"] = pa.array(texts[trial.label], pa.string())
    for key in ("trial", "person", "object", "action"):
        text = [trial.about[key]] * len(trial.t_s)
        columns[key] = pa.array(text, pa.string())

    units = {name: {"unit": str(recording.unit)} for name in channels}
    units[TIME_COLUMN] = {"unit": "s"}
    table = pa.table(columns)
    fields = [field.with_metadata(units.get(field.name)) for field in table.schema]
    about = {"holdfast": json.dumps(trial.about)}
    return table.cast(pa.schema(fields, metadata=about))


def read_log(path: Path, name: str) -> ForeignLog:
    """Any Parquet file, or all files of a folder, as a log of one table.

    A column of lists of one length, or of structs, becomes `name.0`, `name.1`, .. or `name.field`;
    a null is nan or "". Raises what pyarrow and json raise.
    """
    # without partitioning, a=1 in a path is a name like any other
    table = pq.read_table(path, partitioning=None)
    about = json_of((table.schema.metadata or {}).get(b"holdfast", b"{}"))
    while any(pa.types.is_struct(field.type) for field in table.schema):
        table = table.flatten()
    columns: Columns = {}
    for key, column in zip(table.column_names, table.columns, strict=True):
        columns |= _cells(key, column)
    return ForeignLog(path, name, (Stream(columns),), about)


def _cells(name: str, column: Any) -> Columns:
    """A column of numbers, of texts, or the columns of a list of one length; none of others."""
    types = pa.types
    if types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    elif types.is_timestamp(column.type):
        column = column.cast(pa.timestamp("ns")).cast(pa.int64())
    kind = column.type
    if kind in (pa.string(), pa.large_string()):
        return {name: text_column(column.to_pylist())}
    if types.is_integer(kind) or types.is_floating(kind):
        # whole numbers stay whole; those with a null are floats already
        cells = column.to_numpy()
        return {name: cells.astype(np.result_type(cells, np.int64))}
    try:
        rows = np.array(column.to_pylist(), dtype=np.float64)
    except (TypeError, ValueError):  # other cells, or lists of several lengths
        return {}
    if rows.ndim == 1:
        # true, false, decimals
        return {name: rows}
    rows = rows.reshape(len(rows), -1)
    return {f"{name}.{k}": cells for k, cells in enumerate(rows.T)}
