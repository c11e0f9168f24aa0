"""A model as one static page: its C form in WebAssembly, with a simulated example. `make browser`.

python examples/browser/build.py MODEL OUT.html
"""

from __future__ import annotations

import base64
import json
import sys
import tempfile
from pathlib import Path

from benchmarks.runtimes.c_programs import WASM, compiled
from benchmarks.runtimes.programs import require
from holdfast.cli.command import show
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.model import Model
from holdfast.export.c.exporting import export_c
from holdfast.simulation.folder import write_recording
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file

HERE = Path(__file__).parent
SEED, TRIALS = 1, 9


def page(model: Path) -> str:
    """The page's text. Raises LibraryMissing without clang, and what `holdfast export` raises."""
    require(*WASM.programs[:1], *WASM.also)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        export_c(model, work / "c")
        wasm = compiled(WASM, work / "c", WASM.main, work / "hand.wasm").read_bytes()
        example = _example(Model(model).card.rate_hz, work)
    parts = {
        "/* TRIAL_JS */": (HERE / "trial.js").read_text("utf-8"),
        "/* PAGE_JS */": (HERE / "page.js").read_text("utf-8"),
        "WASM_BASE64": base64.b64encode(wasm).decode("ascii"),
        "EXAMPLE_JSON": json.dumps(example).replace("</", "<\\/"),
        "HOLDFAST_MODEL": Model(model).card.model_id,
    }
    text = (HERE / "page.html").read_text("utf-8")
    for mark, content in parts.items():
        text = text.replace(mark, content)
    return text


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
    show(str(write_whole(Path(sys.argv[2]), page(Path(sys.argv[1])))))
