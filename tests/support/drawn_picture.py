"""The terminal view as text."""

from __future__ import annotations

import io

from rich.console import Console

from holdfast.live.view import Shown, picture


def drawn(shown: Shown) -> str:
    """The picture without its colours, 80 columns wide."""
    file = io.StringIO()
    Console(file=file, width=80, no_color=True).print(picture(shown))
    return file.getvalue()
