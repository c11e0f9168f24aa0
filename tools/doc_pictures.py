"""`make docs`: the pictures of the documentation, from the model and from measured figures."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import onnx

from benchmarks import touch_to_grip
from benchmarks.cost.picture import figure
from examples.demo import demo_picture
from holdfast.cli.command import show
from holdfast.core.contract import Json
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.model import Model
from studies.doc_pictures.step import picture as step_picture
from studies.doc_pictures.timing import PICTURES as TIMING
from studies.shared_control.picture import picture as front_picture
from tools.doc_tables import EVALUATED
from tools.harness import for_any_page

MODEL = Path("models/holdfast-150hz.onnx")
FRONT = "docs/measured/loop-front-2026-11-29.json"
COST = "docs/measured/cost.json"
LATENCY = "docs/measured/latency-150hz.json"
SLOWER = Path("docs/measured/latency-50hz.json")
MEASURED: dict[str, tuple[str, Callable[[Json], str]]] = {
    "shared-control.svg": (FRONT, lambda loop: for_any_page(front_picture(loop))),
    "what-accuracy-costs.svg": (
        COST,
        lambda cost: for_any_page(figure(cost["rows"])),
    ),
    "touch-to-grip.svg": (LATENCY, lambda fast: touch_to_grip_of(fast)),
    **{name: (EVALUATED, draw) for name, draw in TIMING.items()},
}
"""Picture -> the file of its figures, and what draws it."""


def touch_to_grip_of(fast: Json) -> str:
    """The way of a touch, by the runs of the bench at both rates."""
    both = [fast, json.loads(SLOWER.read_text("utf-8"))]
    return for_any_page(touch_to_grip.picture(both))


def draw_all(docs: Path) -> None:
    """Draw every picture whose figures are there; name those that stay as they are."""
    write_whole(docs / "step.svg", step_picture(onnx.load(MODEL).graph))
    for name, across in (("first-sight", 3), ("first-sight-phone", 1)):
        write_whole(docs / f"{name}.svg", demo_picture.picture(Model(MODEL), across))
    draw_measured(docs)


def draw_measured(docs: Path) -> None:
    """Draw what is made from measured figures."""
    for name, (place, draw) in MEASURED.items():
        if Path(place).is_file():
            figures = json.loads(Path(place).read_text("utf-8"))
            write_whole(docs / name, draw(figures))
        else:
            show(f"{docs / name} stays: {place} is not there")


if __name__ == "__main__":
    draw_all(Path("docs"))
