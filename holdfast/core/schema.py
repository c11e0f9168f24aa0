"""Every TOML and JSON of ours, read into a `msgspec.Struct` that declares keys, types and bounds.

    class Row(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
        object: str
        count: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 1

    rows = read(path, dict[str, Row])

A value that does not fit is one error that names file, key, value and what is allowed there.
msgspec says neither which key of a dictionary it was nor the value: both are looked up in what was
read. Here is also where the shipped models are.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
import tomllib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from holdfast.core.errors import CardError, DataError, HoldfastError

with suppress(ImportError):  # the doctor runs without it, and reads no card
    import msgspec

T = TypeVar("T")
_PACKAGE = Path(__file__).resolve().parent.parent
_IN_WHEEL, _IN_CHECKOUT = _PACKAGE / "models", _PACKAGE.parent / "models"
MODELS = _IN_CHECKOUT if _IN_CHECKOUT.is_dir() else _IN_WHEEL
"""The models that are installed with Holdfast."""
LIBRARY = "libholdfast.so"
"""The compiled C form of a model, in a folder of `c_folders`."""
DEFAULT_MODEL = "holdfast-150hz"
"""The shipped model that a run takes where none is named."""
LONGEST_VALUE = 80
"""Characters of a value in an error."""
MOST_DIGITS = 300
"""Of a whole number in a message."""
NO_NUMBER = r"[+-]?(?:nan(?:\([^)]*\))?|inf(?:inity)?)"
"""What printf writes for a number that is none, in any case: nan, -inf, -nan(ind)."""
_BARE_NO_NUMBER = re.compile(rf"(?<=[:,\[])\s*{NO_NUMBER}(?=\s*[,\]}}])", re.IGNORECASE)
NAMES = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    list: "a list, of length",
    tuple: "a list, of length",
    dict: "a table",
}
"""A type, as an error calls it."""
BOUNDS = {
    "ge": "from",
    "gt": "above",
    "min_length": "from",
    "le": "to",
    "lt": "below",
    "max_length": "to",
}
"""A bound of a number or of a length, as an error calls it."""


def shipped() -> list[str]:
    """Names of the shipped models, sorted: "holdfast-150hz" is the default."""
    return sorted(path.stem for path in MODELS.glob("*.onnx"))


def card_names(folder: Path) -> list[str]:
    """Names of the cards of a folder that is installed with Holdfast, sorted."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def find_card(name: str, shipped_in: Path, what: str, near: Path = Path()) -> Path:
    """A shipped card by name, or a file, seen from the folder `near` first.

    what: the card, for people. Raises CardError.
    """
    names = card_names(shipped_in)
    if name in names:
        return shipped_in / f"{name}.toml"
    for path in (near / name, Path(name)):
        # a name that no file can have is no file
        with suppress(OSError, ValueError):
            if path.is_file():
                return path
    raise CardError(
        f"no {what} {name!r:.80}",
        cause=f"neither a shipped {what} nor a file",
        next_step=f"choose from {', '.join(names)}, or give a path",
    )


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
    # the folder of an artifact has an index; another one of that name means nothing
    is_ours = path.is_file() or (path / "artifact.json").is_file()
    is_bare_name = path == Path(path.name) and not is_ours
    return inside if is_bare_name and inside.is_file() else path


def c_folder(model: str | Path) -> Path:
    """Where the C form of a model is looked for: beside the file.

    Nowhere else, above all not in the working folder: what a library does when it is loaded comes
    before any check, and a folder may hold what another person put there.

    >>> c_folder("models/holdfast-150hz.onnx").as_posix()
    'models/holdfast-150hz-c'
    """
    path = model_path(model)
    return path.with_name(f"{path.stem}-c")


def text_of(path: Path) -> str:
    """The text of a file, UTF-8, with the line ends that it has."""
    return path.read_bytes().decode("utf-8")


def json_of(text: str | bytes, number: Callable[[str], float] | None = None) -> Any:
    """The value of a JSON text. Raises ValueError, also for nan and infinity.

    number: what reads a number with a point or an exponent, if not C.
    """
    try:
        return json.loads(text, parse_constant=_finite, parse_float=number)
    except RecursionError:
        raise ValueError("it nests too deep") from None


def message_of(text: str | bytes) -> Any:
    """The value of a JSON text that another program sent, which may hold nan and infinity.

    They stand there as NaN and Infinity, as Python and ROS write them, or as printf does. Raises
    ValueError.
    """
    text = text.decode("utf-8") if isinstance(text, bytes) else text
    try:
        return _message_of(text)
    except json.JSONDecodeError:
        return _message_of(_BARE_NO_NUMBER.sub("NaN", text))


def _message_of(text: str) -> Any:
    try:
        return json.loads(text, parse_constant=float, parse_int=_whole)
    except RecursionError:
        raise ValueError("it nests too deep") from None


def _whole(digits: str) -> float:
    # Python refuses more, and numpy has no room for them: infinite, as 1e999 is
    return int(digits) if len(digits) <= MOST_DIGITS else float(digits)


def toml_of(text: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises ValueError, also for nan and infinity."""
    try:
        return tomllib.loads(text, parse_float=_finite)
    except RecursionError:
        raise ValueError("it nests too deep") from None


def _finite(word: str) -> float:
    number = float(word)
    if not math.isfinite(number):
        raise ValueError(f"{word} is not a finite number")
    return number


def read(path: Path, kind: type[T], error: type[DataError] = CardError) -> T:
    """What a .toml or JSON file holds, as a kind. Raises FileNotFoundError, and error.

    error: its class for a file that cannot be read, or whose content does not fit.
    """
    try:
        text = text_of(path)
        raw = toml_of(text) if path.suffix == ".toml" else json_of(text, _finite)
    except FileNotFoundError:
        raise
    except OSError as reason:
        raise error(
            "cannot be read", where=path, cause=reason.strerror or str(reason)
        ) from None
    except ValueError as reason:
        form = "TOML" if path.suffix == ".toml" else "JSON"
        raise error(
            f"not valid {form}: {str(reason)[:200]}",
            where=path,
            next_step="correct that line",
        ) from None
    return checked(raw, kind, path, error)


def checked(
    raw: Any,
    kind: type[T],
    where: Path | str,
    error: type[HoldfastError] = CardError,
    *,
    strict: bool = True,
) -> T:
    """A value that was read, as a kind; where: what its error names. Raises error.

    strict: false where numbers stand as text, as in a URL.
    A Struct whose __post_init__ raises ValueError("what; allowed: what is") is heard too.
    """
    try:
        return msgspec.convert(raw, kind, strict=strict)
    except msgspec.ValidationError as reason:
        what, allowed = _explained(raw, kind, str(reason))
        step = f"allowed: {allowed}" if allowed else "correct that value"
        raise error(what, where=where, next_step=step) from None


def ranged(default: float, about: str, ge: float = 0.0, le: float | None = None) -> Any:
    """A field of a dataclass that is a number, with what it is and its ends (see ranges)."""
    meta = msgspec.Meta(ge=ge, le=le, description=about)
    return dataclasses.field(default=default, metadata={"range": meta})


def ranges(kind: type) -> dict[str, msgspec.Meta]:
    """Field -> what it is and its ends, of all fields of a dataclass that are ranged."""
    return {
        one.name: one.metadata["range"]
        for one in dataclasses.fields(kind)
        if "range" in one.metadata
    }


# -- what msgspec leaves out: the key of a dictionary, the value, the fields that are known


def _explained(raw: Any, kind: Any, message: str) -> tuple[str, str]:
    """(key and value, what is allowed there) of a message of msgspec."""
    said, _, place = message.partition(" - at `")
    key, value, kind = _place(raw, kind, place)
    if named := re.fullmatch(r"Object (.+) field `(.+)`", said):
        what = "is missing" if "missing" in named[1] else "is not known"
        fields = [one.encode_name for one in msgspec.structs.fields(_bare(kind))]
        return f"{_joined(key, named[2])} {what}", ", ".join(fields)
    if not said.startswith(("Expected ", "Invalid ")):
        own, _, allowed = said.partition("; allowed: ")
        return f"{key}: {own}" if key else own, allowed

    shown = repr(value)[:LONGEST_VALUE]
    if isinstance(value, list) and " length " in said:
        shown = f"{len(value)} of them"
    return f"{key} = {shown}" if key else shown, _allowed(kind) or said


def _place(raw: Any, kind: Any, place: str) -> tuple[str, Any, Any]:
    """(key, value, kind) of what does not fit; place: as msgspec writes it, `$.rows[2].count`."""
    key = ""
    for field, index in re.findall(r"\.([^.\[`]+)|\[([^\]]+)\]", place):
        kind = _bare(kind)
        if field:
            fields = msgspec.structs.fields(kind)
            kind = next(one.type for one in fields if one.encode_name == field)
            raw, key = raw[field], _joined(key, field)
        elif index == "...":
            # A dictionary: msgspec does not say which of its values it was.
            kind = get_args(kind)[1]
            name = next(name for name in raw if not _fits(raw[name], kind))
            raw, key = raw[name], _joined(key, name)
        else:
            kinds = get_args(kind)
            is_fixed = get_origin(kind) is tuple and kinds[-1] is not Ellipsis
            kind = kinds[int(index) if is_fixed else 0]
            raw, key = raw[int(index)], f"{key}[{index}]"
    return key, raw, kind


def _joined(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _fits(value: Any, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True


def _bare(kind: Any) -> Any:
    """A kind without its bounds and without None."""
    if get_origin(kind) is Annotated:
        return _bare(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        return _bare(next(one for one in get_args(kind) if one is not type(None)))
    return kind


def _allowed(kind: Any) -> str:
    """A kind and its bounds in words; empty for a kind that has none here."""
    bare = _bare(kind)
    if get_origin(bare) is Literal:
        return " or ".join(map(str, get_args(bare)))
    words = [NAMES.get(get_origin(bare) or bare, "")]
    info = msgspec.inspect.type_info(kind)
    # A kind or None is a union, of which None has no bounds.
    for one in getattr(info, "types", [info]):
        # a kind with a description is wrapped once more
        one = getattr(one, "type", one)
        for bound, word in BOUNDS.items():
            end = getattr(one, bound, None)
            if end is not None:
                words.append(f"{word} {end:g}")
    return " ".join(filter(None, words))
