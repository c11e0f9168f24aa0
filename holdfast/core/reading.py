"""Checks of a card that its reader makes itself: see schema.py for what replaces them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.errors import CardError
from holdfast.core.schema import text_of, toml_of

if TYPE_CHECKING:
    from holdfast.core.contract import Json


def read_toml(path: Path) -> tuple[str, Json]:
    """(text, tables) of a card. Raises CardError, and FileNotFoundError where there is no file."""
    try:
        text = text_of(path)
        return text, toml_of(text)
    except FileNotFoundError:
        raise
    except (OSError, UnicodeDecodeError) as error:
        raise CardError(
            "cannot be read as text", where=path, cause=type(error).__name__
        ) from None
    except ValueError as error:
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
