"""Text that a command writes into a page, between `<!-- name: .. -->` and `<!-- /name -->`."""

from __future__ import annotations

import re
from pathlib import Path

from holdfast.edge_runtime.errors import DataNotFound
from holdfast.edge_runtime.writing import write_whole


def write_between(page: str | Path, name: str, written: str) -> None:
    """Replace the text between a page's markers. Raises DataNotFound without markers."""
    text = Path(page).read_text(encoding="utf-8")
    marked = re.compile(rf"(<!-- {name}:[^\n]*-->\n).*?(<!-- /{name} -->)", re.DOTALL)
    if not marked.search(text):
        raise DataNotFound(
            f"no markers <!-- {name}: --> and <!-- /{name} -->",
            where=page,
            cause="a page written anew, or the wrong page",
            next_step="put both lines where the table belongs",
        )
    write_whole(page, marked.sub(lambda found: found[1] + written + found[2], text))
