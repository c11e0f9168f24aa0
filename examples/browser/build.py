"""A model as static pages: its C form in WebAssembly, with a hand to pull at. `make browser`.

python examples/browser/build.py MODEL FOLDER [HOME]

FOLDER gets try.html, a simulated hand that answers, and trial.html, for a trial's own CSV.
HOME: where a link back leads, for pages of a site.
"""

from __future__ import annotations

import base64
import gzip
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.runtimes.c_programs import compiled, for_a_browser
from benchmarks.runtimes.programs import require
from examples.browser.setups import setup_numbers
from holdfast.cli.command import show
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.model import Model
from holdfast.export.c.exporting import export_c
from holdfast.simulation.physics.objects import OBJECTS, HeldObject
from holdfast.simulation.scenes.folder import write_recording
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file

HERE = Path(__file__).parent
SEED, TRIALS = 1, 9
SCRIPTS = {
    "try": ("situations.js", "stage.js", "strip.js", "outcome.js", "try.js"),
    "trial": ("situations.js", "trial.js", "page.js"),
}
"""Of each page, in the order in which they are needed."""


def pages(model: Path, home: str = "") -> dict[str, str]:
    """Names and texts of the pages; home: a link back, for a page of a site.

    Raises LibraryMissing without a compiler, and what `holdfast export` raises.
    """
    compiler = for_a_browser()
    require(compiler.compiler, *compiler.also)
    card = Model(model).card
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        export_c(model, work / "c")
        wasm = compiled(compiler, work / "c", HERE / "try.c", work / "try.wasm")
        # A third of the page's size, and the browser unpacks it by itself.
        packed = gzip.compress(wasm.read_bytes(), mtime=0)
        example = _example(card.rate_hz, work)
    shared = {
        "WASM_BASE64": base64.b64encode(packed).decode("ascii"),
        "HOLDFAST_MODEL": card.model_id,
        "<!-- HOME -->": f'<a href="{home}">Holdfast</a>' if home else "",
        "/* STYLE_CSS */": _text("style.css"),
        "/* TRY_CSS */": _text("try.css"),
    }
    data = {"try": ("OBJECTS_JSON", _objects()), "trial": ("EXAMPLE_JSON", example)}
    made = {}
    for page, (mark, value) in data.items():
        scripts = "\n".join(f"<script>{_text(one)}</script>" for one in SCRIPTS[page])
        text = _text(f"{page}.html").replace("<!-- SCRIPTS -->", scripts)
        text = text.replace(mark, json.dumps(value).replace("</", "<\\/"))
        for each, content in shared.items():
            text = text.replace(each, content)
        made[f"{page}.html"] = text
    return made


def _text(name: str) -> str:
    return (HERE / name).read_text("utf-8")


def _objects() -> list[dict[str, Any]]:
    """What the page offers to hold: figures of the scenes, and the setup of try.c."""
    return [_object(held) for held in OBJECTS.values()]


def _object(held: HeldObject) -> dict[str, Any]:
    tall_mm = held.half_length_mm or held.axial_radius_mm
    return {
        "name": held.name,
        "mass_g": held.mass_g,
        "radius_mm": held.radius_mm,
        "half_tall_mm": tall_mm,
        "is_bottle": held.half_length_mm > 0.0,
        "friction": held.friction,
        "kinetic_share": held.kinetic_share,
        "setup": setup_numbers(held.name),
    }


def _example(rate_hz: float, work: Path) -> dict[str, str]:
    """A pull that this model has not seen."""
    scene = Scene(read_scene_file("thesis", rate_hz=rate_hz), SEED)
    pull = next(one for one in scene.trials(TRIALS) if one.action == "pull")
    write_recording(work / "pull", scene, scene.run_together([pull]))
    csv = work / "pull.csv"
    return {
        "csv": csv.read_text("utf-8"),
        "truth": csv.with_suffix(".truth.json").read_text("utf-8"),
    }


if __name__ == "__main__":
    folder = Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages(Path(sys.argv[1]), *sys.argv[3:]).items():
        path = write_whole(folder / name, text)
        show(f"{path}: {len(text.encode()) / 1e6:.2f} MB")
