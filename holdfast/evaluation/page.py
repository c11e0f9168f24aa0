"""Pages whose sections are still written as strings; new pages are templates, see html.py."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from holdfast.core.contract import SITUATIONS
from holdfast.core.writing import write_whole
from holdfast.evaluation.statistics import Spread
from holdfast.evaluation.style import dark_rules
from holdfast.training.figures import ABSENT

CSS = """
body{font:16px/1.5 system-ui,sans-serif;color:#1f2933;max-width:62rem;margin:2rem auto;
padding:0 1rem}
h1{font-size:1.7rem;line-height:1.2;margin-bottom:.2rem} h2{font-size:1.2rem;margin-top:2.4rem}
table{border-collapse:collapse;font-size:.8rem;width:100%;font-variant-numeric:tabular-nums}
th,td{padding:.3rem .45rem;border-bottom:1px solid #e4e7eb;text-align:right;white-space:nowrap}
th:first-child,td:first-child{text-align:left;white-space:normal;min-width:9.5rem}
th{font-weight:600;vertical-align:bottom}
tr.ours td{font-weight:600} tr.warning td{color:#9a4a06} .note{color:#52606d;font-size:.9rem}
.answer{display:flex;gap:2.5rem;flex-wrap:wrap;margin:1rem 0}
.answer b{display:block;font-size:2rem;line-height:1.1}
.key i{display:inline-block;width:.9em;height:.9em;margin:0 .3em 0 1em;vertical-align:-.1em}
.side{display:flex;flex-wrap:wrap;gap:1rem} svg{max-width:100%;height:auto} .wide{overflow-x:auto}
.side>*{max-width:100%} @media(max-width:45rem){svg{max-width:none}}
@media(prefers-color-scheme:dark){body{background:#1e2129;color:#e4e7eb}.note{color:#b8c2cc}
th,td{border-color:#3e4c59}tr.warning td{color:#f0a35e}a{color:#5fb0e5}}
"""
DRAWN = re.compile(r"<svg.*?</svg>", re.DOTALL)


def write_page(path: Path, title: str, sections: list[str]) -> Path:
    """One self-contained page of sections, each HTML; OutputError where it cannot be written.

    On a phone a picture keeps its size and scrolls; the page follows a reader who prefers dark.
    """
    meta = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    head = (
        f"<title>{html.escape(title)}</title>{meta}<style>{CSS}{dark_rules()}</style>"
    )
    body = DRAWN.sub(r"<div class=wide>\g<0></div>", "\n".join(sections))
    return write_whole(path, f"<!doctype html><html lang=en>{head}{body}</html>")


class Row(NamedTuple):
    """A row of a table, each cell HTML. style: ours, warning, or none."""

    cells: Sequence[str]
    style: str = ""


def table(heads: Sequence[str], rows: Iterable[Row]) -> str:
    """An HTML table; a row of one cell is a heading over all columns."""
    lines = [_row(row, len(heads)) for row in rows]
    head = "".join(f"<th>{name}" for name in heads)
    body = "\n".join(lines)
    return f"<div class=wide><table class=close><tr>{head}\n{body}</table></div>"


def _row(row: Row, n_columns: int) -> str:
    if len(row.cells) == 1:
        look = "text-align:left;padding-top:.9rem"
        return f"<tr><th colspan={n_columns} style='{look}'>{row.cells[0]}"
    style = f" class={row.style}" if row.style else ""
    return f"<tr{style}>" + "".join(f"<td>{cell}" for cell in row.cells)


def key(colours: Sequence[str]) -> str:
    """What the colours of the four situations mean."""
    pairs = zip(colours, SITUATIONS, strict=True)
    return "".join(
        f'<i style="background:{colour}"></i>{name.replace("_", " ")}'
        for colour, name in pairs
    )


def median(of: Spread | None) -> str:
    """The median alone, rounded; "-" where there is none."""
    return ABSENT if of is None else f"{of.p50:.0f}"


def above(value: str, below: str) -> str:
    """A value, and a note in small below it."""
    return f"{value}<br><span class=note>{below}</span>" if below else value
