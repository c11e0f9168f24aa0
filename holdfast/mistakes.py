"""Suggestions for a source that is neither a URL nor an existing file."""

from __future__ import annotations

import re
from pathlib import Path

from holdfast.edge_runtime.errors import UsageError

SCHEMES = ("usb", "i2c", "virtual", "sim", "replay")
_NATIVE = re.compile(r"(?:/dev/)?i2c-(\d{1,3})")


def require_meant(word: str) -> None:
    """Raise UsageError with a suggestion, if the word looks like a source without its scheme."""
    if "://" in word or _exists(word):
        return
    meant = _meant(word)
    if meant:
        what = f"{word!r} is not a file, and a source needs its scheme"
        raise UsageError(what, next_step=f"write {meant}")


def _exists(word: str) -> bool:
    try:
        return Path(word).exists()
    except (OSError, ValueError):
        return False


def _meant(word: str) -> str:
    """What to write instead; empty without a suggestion."""
    scheme, colon, name = word.partition(":")
    if colon and scheme in SCHEMES:
        return f"{scheme}://{name.lstrip('/')}"
    if native := _NATIVE.fullmatch(word):
        return f"i2c://{native[1]}"
    return _bridge(word) or _card(word)


def _bridge(word: str) -> str:
    from holdfast.drivers.bridges import BRIDGES

    name, _, options = word.partition("?")
    if name not in BRIDGES:
        return ""
    query = f"?{options}" if options else ""
    return f"usb://{name}{query} for the bridge itself, virtual://{name}{query} for an emulated one"


def _card(word: str) -> str:
    from holdfast.simulation.card import shipped

    name, _, _ = word.partition("?")
    return f"sim://{word}" if name in shipped() else ""
