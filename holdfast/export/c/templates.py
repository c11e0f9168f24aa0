"""The hand-written C in templates/: words between @ are filled in, snippets come by need."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files

_SNIPPET = re.compile(r"^/\*\*\* (\w+) \*\*\*/\n", re.MULTILINE)


def template(name: str, values: Mapping[str, object] | None = None) -> str:
    """A template with every @WORD@ replaced. Raises KeyError for a word without a value."""
    text = (
        files("holdfast.export.c")
        .joinpath("templates", name)
        .read_text(encoding="utf-8")
    )
    return re.sub(r"@([A-Z_]+)@", lambda match: str((values or {})[match[1]]), text)


def snippets(used_in: str) -> str:
    """The helpers of maths.c that a source uses, and those that they use, in their order."""
    parts = _SNIPPET.split(template("maths.c"))
    helpers = dict(zip(parts[1::2], parts[2::2], strict=True))
    wanted: set[str] = set()
    text = used_in
    while more := (set(helpers) & set(re.findall(r"\w+", text))) - wanted:
        wanted |= more
        text = "\n".join(helpers[name] for name in more)
    return "\n".join(
        body.strip() + "\n" for name, body in helpers.items() if name in wanted
    )
