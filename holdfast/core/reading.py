"""Where a shipped model is, JSON and TOML as values, and the checks that every card needs.

A TOML file's content is checked by a CardReader: its errors name file, key, value and what is
allowed there.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.errors import CardError

if TYPE_CHECKING:
    from holdfast.core.contract import Json

_PACKAGE = Path(__file__).resolve().parent.parent
_IN_WHEEL, _IN_CHECKOUT = _PACKAGE / "models", _PACKAGE.parent / "models"
MODELS = _IN_CHECKOUT if _IN_CHECKOUT.is_dir() else _IN_WHEEL
"""The models that are installed with Holdfast."""
DEFAULT_MODEL = "holdfast-150hz"
"""The shipped model that a run takes where none is named."""


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


def text_of(path: Path) -> str:
    """The text of a file, UTF-8, with the line ends that it has."""
    return path.read_bytes().decode("utf-8")


def json_of(text: str | bytes) -> Any:
    """The value of a JSON text. Raises ValueError, also for numbers that are not finite."""
    try:
        return json.loads(text, parse_constant=_not_finite)
    except RecursionError:
        raise ValueError("it nests too deep") from None


def _not_finite(word: str) -> None:
    raise ValueError(f"{word} is not a finite number")


def read_toml(path: Path) -> tuple[str, Json]:
    """(text, tables) of a card. Raises CardError, and FileNotFoundError where there is no file."""
    try:
        text = text_of(path)
        return text, tomllib.loads(text)
    except FileNotFoundError:
        raise
    except (OSError, UnicodeDecodeError) as error:
        raise CardError(
            "cannot be read as text", where=path, cause=type(error).__name__
        ) from None
    except (ValueError, RecursionError) as error:
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
