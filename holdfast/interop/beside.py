"""Which files are one trial: a log, or a file for each finger, and what lies beside it.

Beside a log lie a table of events and an object of facts. They are read with it, so that a log has
all that is said of its trial.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from os.path import dirname

import numpy as np

from holdfast.core.errors import DataNotFound, TimeError
from holdfast.interop.columns import find_time
from holdfast.interop.formats.logs import SCALARS, LogPlace, read_log
from holdfast.interop.formats.streams import Columns, ForeignLog, Stream, first_stream

Files = dict[str, list[LogPlace]]
"""Name of a log -> its file, or a file for each finger; then what lies beside it."""
WORD = r"[/_ .-]+"
"""Between the words of a path."""


def files_of(
    logs: Sequence[LogPlace],
    beside: Sequence[LogPlace],
    fingers: Sequence[str],
    of_folders: Sequence[LogPlace] = (),
) -> Files:
    """The files of each log, of a file for each finger in the order of `fingers`.

    of_folders: tables of all logs below the folder in which they are, which name their trials.
    Raises DataNotFound where a finger has no file, or a file no finger.
    """
    files: Files = {}
    for place in () if fingers else logs:
        files.setdefault(place.name, [place])
    joined = [
        place for word in fingers for place in logs if _whole(word).search(place.name)
    ]
    for place in joined:
        words = [word for word in fingers if _whole(word).search(place.name)]
        name = _whole(words[0]).sub("_", place.name).strip("_") or "log"
        files.setdefault(name, []).append(place)
    left = [place.name for place in logs if fingers and place not in joined]
    left += [
        name for name, group in files.items() if len(group) != max(1, len(fingers))
    ]
    if left:
        raise DataNotFound(
            f"{left[0]} has not one file for each of {', '.join(fingers)}",
            next_step="--fingers with the words of its files; or move it out of the folder",
        )
    logs_found = [*files]
    for is_fact in (False, True):
        tables = {one.name: one for one in beside if (one.kind == SCALARS) == is_fact}
        for name, table in paired(logs_found, [*tables]).items():
            files[name].append(tables[table])
    for place in of_folders:
        for name in logs_found:
            is_below = name.startswith(f"{dirname(place.name)}/")
            if is_below and place not in files[name]:
                files[name].append(place)
    return files


def _whole(word: str) -> re.Pattern[str]:
    """A whole word of a path, and the signs around it."""
    is_number = word[-1:].isdigit()
    behind = r"(?!\d)" if is_number else r"(?![^\W\d_])"
    return re.compile(rf"({WORD}|^|(?<=\d)){re.escape(word)}{behind}({WORD})?")


def read_joined(
    places: Sequence[LogPlace], fingers: Sequence[str], name: str
) -> ForeignLog:
    """A log of its files: with several fingers its columns are `finger.column`.

    A table beside it is a stream that is named as its files are, with * for the name of a log; a
    fact is a column, too. Raises TimeError for a finger without a time, or of another time.
    """
    n_files = max(1, len(fingers))
    log = replace(read_log(places[0]), name=name)
    if fingers:
        named = zip(fingers, places[:n_files], strict=True)
        streams = tuple(_of_finger(*one) for one in named)
        # but for a few rows, whose stamps may be torn
        stamps = [np.asarray(one.t_ns, np.float64) for one in streams]
        spans = [np.quantile(one, (0.1, 0.9)) for one in stamps]
        begins, ends = np.transpose(spans)
        if max(begins) >= min(ends):
            raise TimeError(
                f"{', '.join(fingers)} of {name} were not recorded at the same time",
                where=places[0].path,
                next_step="stamps of one clock; or a folder for each, and import it on its own",
            )
        log = replace(log, streams=streams)
    longest, facts, tables = first_stream(log), Columns(), list[Stream]()
    for place in places[n_files:]:
        word = other_word(name, place.name)
        word = place.path.stem if word is None else word
        pattern = f"*{word}*{place.path.suffix}"
        for stream in read_log(place).streams:
            if place.kind == SCALARS and not stream.name:
                for key, fact in stream.columns.items():
                    facts[key] = np.repeat(fact, longest.rows)
            name_of_all = pattern.replace("**", "*")
            tables.append(replace(stream, t_ns=None, name=name_of_all))
    readings = replace(longest, columns=facts | longest.columns)
    # the order of the files is that of the sensors
    parts = [readings if one is longest else one for one in log.streams]
    return replace(log, streams=(*parts, *tables))


def _of_finger(word: str, place: LogPlace) -> Stream:
    """The readings in the file of a finger, by their stamps."""
    columns = dict(first_stream(read_log(place)).columns)
    time = find_time(columns)
    if time is None or not time.value.column:
        raise TimeError("no column of time to join files by", where=place.path)
    t_ns = np.round(columns.pop(time.value.column) * time.value.unit_ns)
    named = {f"{word}.{key}": column for key, column in columns.items()}
    return Stream(named, t_ns.astype(np.int64), word)


def paired(logs: Sequence[str], tables: Sequence[str]) -> dict[str, str]:
    """The name of a log -> that of the table beside it; what is not clear is left out.

    Names of a pair differ in one word of the table, the same in all pairs: trial_1_motion and
    trial_1_events, data/x and labels/x, t1 and t1; or a table is alone with a log in a folder.
    """
    pairs: dict[str, dict[str, str]] = {}
    for table in tables:
        near: dict[str, list[str]] = {}
        for log in logs:
            word = other_word(log, table)
            if word is not None:
                near.setdefault(word, []).append(log)
        for word, of_word in near.items():
            if len(of_word) == 1:
                pairs.setdefault(word, {})[of_word[0]] = table
    return max(pairs.values(), key=len, default={})


def other_word(log: str, table: str) -> str | None:
    """The word of a table's name that its log has not; None where they differ in more."""
    ours, theirs = re.split(WORD, log), re.split(WORD, table)
    for _ in range(2):
        while ours and theirs and ours[-1] == theirs[-1]:
            ours, theirs = ours[:-1], theirs[:-1]
        ours, theirs = ours[::-1], theirs[::-1]
    word = "".join(theirs)
    # a number would be that of another trial
    return None if len(theirs) > 1 or re.search(r"\d", word) else word
