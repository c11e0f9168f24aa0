"""Files before they are read: where a shipped model is, and whether a file can be read whole.

A file may be of the wrong kind, or too long. Of JSON and TOML two programs must read the same, so
no key comes twice, and every number has 64 bits; in JSON it is finite. A TOML file's content is
checked by a CardReader: its errors name file, key, value and what is allowed there.
"""

from __future__ import annotations

import json
import math
import stat
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from holdfast.core.errors import CardError, DataNotFound, TooLarge

Json = dict[str, Any]
"""A JSON object as it stands in a file, looked up by its keys."""
_PACKAGE = Path(__file__).resolve().parent.parent
_IN_WHEEL, _IN_CHECKOUT = _PACKAGE / "models", _PACKAGE.parent / "models"
MODELS = _IN_CHECKOUT if _IN_CHECKOUT.is_dir() else _IN_WHEEL
"""The models that are installed with Holdfast."""
DEFAULT_MODEL = "holdfast-150hz"
"""The shipped model that a run takes where none is named."""
MOST_LEVELS = 32
"""Our files nest less deeply; a thousand brackets in a row exhaust Python's stack."""
LEAST_INTEGER, MOST_INTEGER = -(1 << 63), (1 << 63) - 1
"""Larger numbers are no int64, and the largest no float either."""


def shipped() -> list[str]:
    """Names of the shipped models, sorted: "holdfast-150hz" is the default."""
    return sorted(path.stem for path in MODELS.glob("*.onnx"))


def model_path(word: str | Path) -> Path:
    """The file that a word names: a path, or the name of a shipped model.

    >>> model_path("mine/holdfast.onnx").as_posix()
    'mine/holdfast.onnx'
    >>> model_path("holdfast-150hz").name
    'holdfast-150hz.onnx'
    """
    path = Path(word)
    # a name of a shipped model; a file of that name in the working folder comes first
    inside = MODELS / f"{path.name}.onnx"
    is_bare_name = path == Path(path.name) and not path.exists()
    return inside if is_bare_name and inside.is_file() else path


def require_file(path: Path) -> None:
    """Raise DataNotFound for a device or a pipe, which may never end, and for an invalid path.

    For a missing file and for a folder, the code that opens it raises the error.
    """
    try:
        mode = path.stat().st_mode
    # the code that opens the file has a better message for these
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return
    except (OSError, ValueError) as error:
        what = error.strerror if isinstance(error, OSError) else str(error)
        raise DataNotFound(
            f"not a valid path ({what})",
            where=repr(str(path))[:80],
            next_step="check the path",
        ) from None
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise DataNotFound(
            "a device or a pipe, not a file",
            where=path,
            next_step="write the data to a file first, and name that file",
        )


MOST_DOCUMENT_BYTES = 16 << 20
"""Of a JSON or TOML file, or of its text; ours have a few thousand."""
MOST_LINE_BYTES = 128 << 10
"""Of one line of a table; a hand of 64 sensors needs 5,000.

Python's csv has the same limit a cell.
"""
MOST_TABLE_BYTES = 4 << 30
"""A table of six sensors reaches it after a day and a half."""
CHUNK_BYTES = 64 << 10


def text_of(path: Path) -> str:
    """The text of a small file, UTF-8.

    Raises TooLarge, DataNotFound for a device or a pipe, and what opening and decoding it raise.
    """
    require_file(path)
    # the size first: a file of a gigabyte is not read
    size = path.stat().st_size
    if size > MOST_DOCUMENT_BYTES:
        raise TooLarge(
            f"more than {MOST_DOCUMENT_BYTES >> 20} MiB of text",
            where=path,
            cause="another file",
            next_step="check the path",
        )
    with path.open("rb") as file:
        return file.read(size).decode("utf-8")


def require_lines(path: Path) -> None:
    """Raise TooLarge for a table or a line that is too long.

    Raises DataNotFound for a device or a pipe, and what opening the file raises.
    """
    require_file(path)
    with path.open("rb") as file:
        if path.stat().st_size > MOST_TABLE_BYTES:
            raise TooLarge(
                f"more than {MOST_TABLE_BYTES >> 30} GiB",
                where=path,
                next_step="split the recording",
            )
        # begun: bytes of a line that began in an earlier chunk
        number, begun = 1, 0
        while chunk := file.read(CHUNK_BYTES):
            # either line end: Python reads both
            ends = [at for at in (chunk.find(b"\n"), chunk.find(b"\r")) if at >= 0]
            if begun + min(ends, default=len(chunk)) > MOST_LINE_BYTES:
                raise TooLarge(
                    f"line {number} is longer than {MOST_LINE_BYTES} bytes",
                    where=path,
                    cause="it is another file, or its line ends were lost",
                    next_step="copy it again",
                )
            begun = (
                len(chunk) - 1 - max(chunk.rfind(b"\n"), chunk.rfind(b"\r"))
                if ends
                else begun + len(chunk)
            )
            number += chunk.count(b"\n")


def named_file(folder: Path, name: object) -> Path:
    """The file that a file in a folder names, which must be a regular one inside that folder.

    Raises ValueError for any other, such as a device, a path upwards or a link to elsewhere.
    """
    path = folder / name if isinstance(name, str) and "\0" not in name else folder
    if not path.is_file() or not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{name!r:.80} is not a file in this folder")
    return path


def json_of(text: str | bytes) -> Any:
    """The value of a JSON text from outside, read strictly.

    Raises ValueError for a text that is too long, nests too deep, has a key twice in an object, or
    holds a number that is not finite or needs more than 64 bits.
    """
    if len(text) > MOST_DOCUMENT_BYTES:
        raise ValueError("too long")
    try:
        value = json.loads(text, object_pairs_hook=_object)
    except RecursionError:
        raise ValueError("nested too deep") from None
    _require_plain(value)
    return value


def _object(pairs: list[tuple[str, Any]]) -> Json:
    """An object; of a key that comes twice, two programs may take different values."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key comes twice")
    return found


def _require_plain(value: Any, *, finite: bool = True) -> None:
    """Raise ValueError for what nests too deep, and for numbers that are not finite, or too large.

    Dates, which TOML has, and texts are plain.
    """
    # level by level, so that this check does not recurse itself
    level: list[tuple[str, Any]] = [("", value)]
    for _ in range(MOST_LEVELS + 1):
        inside: list[tuple[str, Any]] = []
        for name, one in level:
            if isinstance(one, dict):
                dot = "." if name else ""
                inside += [(f"{name}{dot}{key}", each) for key, each in one.items()]
            elif isinstance(one, list):
                inside += [(f"{name}[{k}]", each) for k, each in enumerate(one)]
            elif finite and isinstance(one, float) and not math.isfinite(one):
                raise ValueError(f"{name} = {one} is not a finite number")
            elif isinstance(one, int) and not LEAST_INTEGER <= one <= MOST_INTEGER:
                raise ValueError(f"{name} needs more than 64 bits")
        if not inside:
            return
        level = inside
    raise ValueError("nested too deep")


def read_toml(path: Path) -> tuple[str, Json]:
    """(text, tables) of a card. Raises CardError, and FileNotFoundError where there is no file."""
    try:
        text = text_of(path)
        tables = tomllib.loads(text)
        # a card's reader names the key of a number that is not finite, and what is allowed there
        _require_plain(tables, finite=False)
        return text, tables
    except FileNotFoundError:
        raise
    except (OSError, UnicodeDecodeError) as error:
        raise CardError(
            "cannot be read as text", where=path, cause=type(error).__name__
        ) from None
    except RecursionError:
        raise CardError(
            "not valid TOML: nested too deep",
            where=path,
            next_step="remove the brackets",
        ) from None
    except (
        ValueError
    ) as error:  # TOMLDecodeError, or a number with more digits than Python converts
        raise CardError(
            f"not valid TOML: {str(error)[:200]}",
            where=path,
            next_step="correct that line",
        ) from None


class CardReader:
    """Checks of one card that every kind of card needs."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def table(self, raw: Mapping[str, Any], name: str) -> Json:
        """A copy of a section, empty where the card has none. Raises CardError."""
        value = raw.get(name, {})
        return dict(self.require_table(name, value))

    def require_table(self, key: str, value: Any) -> Json:
        """The value if it is a table. Raises CardError."""
        if not isinstance(value, dict):
            raise self.refused(key, value, f"a table: [{key}]")
        return value

    def require_known(
        self, names: Collection[str], allowed: Collection[str], what: str
    ) -> None:
        """Raise CardError for a name that is not among those allowed."""
        for name in names:
            if name not in allowed:
                raise CardError(
                    f"{what}: {name!r} is not known",
                    where=self.path,
                    next_step=f"allowed: {', '.join(allowed)}",
                )

    def refused(self, key: str, value: Any, allowed: str) -> CardError:
        """The error for a value that a key cannot have."""
        what = f"{key} = {repr(value)[:80]}"
        return CardError(what, where=self.path, next_step=f"allowed: {allowed}")
