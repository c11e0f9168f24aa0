"""docs/tags.svg, the two camera tags to print, with a ruler: `make docs`."""

from __future__ import annotations

import numpy as np

from holdfast.evaluation.style import with_label
from holdfast.simulation.camera_frames import CODES, SIDE_CELLS, cells

TAG_MM = 10.0
MARGIN_MM = 10.0
RULER_MM = 100
FONT = 'font-size="3" font-family="sans-serif"'


def sheet() -> str:
    """Both tags at their size with a ruler, as SVG in mm."""
    size = (
        'width="120mm" height="50mm" viewBox="0 0 120 50" shape-rendering="crispEdges"'
    )
    label = (
        "Two printed tags, 0 for the object and 1 for the hand, and a ruler of 100 mm"
    )
    head = with_label(f'<svg xmlns="http://www.w3.org/2000/svg" {size}>', label)
    white = '<rect width="120" height="50" fill="white"/>'
    tags = [shape for tag in range(len(CODES)) for shape in _tag(tag)]
    return "\n".join([head, white, *tags, *_ruler(), "</svg>"]) + "\n"


def _tag(tag: int) -> list[str]:
    """The black cells of one tag, and its name."""
    cell_mm = TAG_MM / SIDE_CELLS
    left_mm = MARGIN_MM + tag * (TAG_MM + 4.0 * MARGIN_MM)
    shapes = []
    for row, column in np.argwhere(cells(tag) == 0.0).tolist():
        at = f'x="{left_mm + cell_mm * column:g}" y="{MARGIN_MM + cell_mm * row:g}"'
        shapes.append(f'<rect {at} width="{cell_mm:g}" height="{cell_mm:g}"/>')
    name = ("object", "hand")[tag]
    return [*shapes, f'<text x="{left_mm:g}" y="30" {FONT}>{tag}: {name}</text>']


def _ruler() -> list[str]:
    marks = "".join(
        f"M{MARGIN_MM + k:g} 40v{-3 if k % 10 == 0 else -1.5:g}"
        for k in range(RULER_MM + 1)
    )
    pen = 'stroke="black" stroke-width="0.2" fill="none"'
    return [
        f'<path d="M{MARGIN_MM:g} 40h{RULER_MM}{marks}" {pen}/>',
        f'<text x="10" y="45" {FONT}>100 mm</text>',
    ]
