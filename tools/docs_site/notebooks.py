"""Notebooks that are Python files with cells (`# %%`): executed, with what they printed."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

from holdfast.evaluation.style import with_label
from tools.harness import for_any_page

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 300
PROGRESS = re.compile(r"^\x1b\[2m.*\x1b\[0m\n?", re.MULTILINE)
"""What a terminal shows faintly while it works: how far it is, which differs on every machine."""
SETUP = "%config InlineBackend.figure_formats = ['svg']"


def executed(source: Path) -> dict[str, str]:
    """The page of a notebook and its pictures, name -> content. Raises where a cell fails."""
    book = jupytext.read(source, fmt="py:percent")
    book.cells.insert(0, nbformat.v4.new_code_cell(SETUP))
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(
            book,
            timeout=SECONDS,
            kernel_name="python3",
            resources={"metadata": {"path": folder}},
        ).execute()
        pages = _pages(book.cells[1:], source.stem)
        private = [
            path for path in (folder, str(ROOT)) if path in "".join(pages.values())
        ]
    if private:
        raise ValueError(
            f"{source.name}: its output names a folder of this machine: {private}"
        )
    return pages


def _pages(cells: list[nbformat.NotebookNode], name: str) -> dict[str, str]:
    page, pictures = [], {}
    for place, cell in enumerate(cells):
        if cell.cell_type == "markdown":
            page.append(cell.source)
            continue
        page.append(f"```python\n{cell.source}\n```")
        printed = "".join(filter(None, map(_text, cell.outputs))).rstrip()
        page += [f"```text\n{printed}\n```"] if printed else []
        for output in cell.outputs:
            drawn = output.get("data", {}).get("image/svg+xml")
            if drawn:
                alt = cell.metadata["alt"]
                file = f"{name}-{place}.svg"
                pictures[file] = for_any_page(with_label(_element(drawn), alt))
                page.append(f"![{alt}]({file})")
    return {f"{name}.md": "\n\n".join(page) + "\n", **pictures}


def _element(svg: str) -> str:
    return svg[svg.index("<svg") :]


def _text(output: nbformat.NotebookNode) -> str:
    """What an output prints, a whole number of lines; nothing for a picture."""
    data = output.get("data", {})
    if "image/svg+xml" in data:
        return ""
    printed = output.get("text") or data.get("text/plain", "")
    return f"{PROGRESS.sub('', printed).rstrip()}\n"
