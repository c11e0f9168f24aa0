"""`python -m tools.house`: how large the project is, and the limits of budget.toml.

Sizes are counted as nodes of the syntax tree, because lines say more about the formatter.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
COUNT_MODULES = """
import sys
ours = [m for name, m in list(sys.modules.items()) if name.split(".")[0] == "holdfast"]
print(len({module.__file__ for module in ours}))
"""
MONITOR = """
import numpy as np
import holdfast
monitor = holdfast.load("holdfast-150hz", live=False)
for k in range(3):
    sample = holdfast.Sample(round(k * 1e9 / 150), np.zeros(18), np.ones(6, bool), k)
    monitor.feed(sample)
"""
VERBS = """
from holdfast.cli.main import main
for words in {}:
    assert main(words) == 0
"""
RUN = ["run", "holdfast-150hz", "--source", "virtual://ft232h", "--to", "none"]
RUN += ["--engine", "onnxruntime", "--seconds", "0.5"]
"""With onnxruntime: a C form that lies beside the model would load other modules."""
COARSE = """
from importlib.resources import files
from pathlib import Path
card = (files("holdfast") / "simulation/cards/pull-soft-ball.toml").read_text("utf-8")
short = "[[trials]]\\nclose_at_s = 0.5\\nhold_s = 0.8\\ntail_s = 0.2"
card = card.replace("[[trials]]", short).replace("rate_hz = 150", "rate_hz = 50")
card += "[physics]\\nstep_s = 0.01\\n"
Path("coarse.toml").write_text(card, "utf-8")
"""
"""A short scene with few steps: the walk loads the same modules."""
LOOP = """
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.edge_runtime.grip import AnswerRules, Holdfast
from holdfast.edge_runtime.supervisor import Limits
from holdfast.simulation.loop.closed_loop import managed, model_of, run_loops
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
scene = Scene(read_scene_file("coarse.toml"), 0)
model = model_of(ModelChoice("holdfast-50hz"))
rules = AnswerRules.of(model.card.decision)
make = managed(scene, Holdfast, None, rules, Limits())
assert run_loops(scene, scene.trials(1), model, make)
"""
FEW = """
from holdfast.training import fitting
fitting.FIXTURE_TRIALS = 1
"""
"""A small set: the walk loads the same modules."""
TRAIN = ["train", "--learner", "forest", "--size", "tiny", "--out", "made"]
EXPORT = ["export", "made", "--out", "made.onnx"]
WALKS = {
    "import_holdfast": "import holdfast; dir(holdfast)",
    "fed_monitor": MONITOR,
    "live_run": VERBS.format([RUN]),
    "closed_loop": COARSE + LOOP,
    "train_and_export": FEW + VERBS.format([TRAIN, EXPORT]),
}
"""The name of a walk in the budget -> a program that loads what it needs."""
LIMITED = {
    "shipped": ["holdfast"],
    "studies_benchmarks_tools": ["studies", "benchmarks", "tools"],
    "tests": ["tests"],
}
"""The name of a sum in the budget -> the folders that it counts."""


@dataclass(frozen=True)
class Size:
    """Of some Python files. lines: all of them, also empty ones."""

    files: int
    lines: int
    nodes: int
    comprehensions: int
    most_lines: int

    @property
    def nodes_a_line(self) -> float:
        """How dense the code is."""
        return self.nodes / self.lines

    @property
    def comprehensions_per_1000_lines(self) -> float:
        """How much of it is in comprehensions."""
        return 1000 * self.comprehensions / self.lines


def size_of(folders: Sequence[str]) -> Size:
    """The size of all Python files below some folders of the checkout."""
    files = [path for one in folders for path in sorted((ROOT / one).rglob("*.py"))]
    lines, nodes, comprehensions = zip(*map(_counted, files), strict=True)
    return Size(len(files), sum(lines), sum(nodes), sum(comprehensions), max(lines))


@cache
def _counted(file: Path) -> tuple[int, int, int]:
    """Lines, nodes and comprehensions of a file."""
    text = file.read_text("utf-8")
    nodes = list(ast.walk(ast.parse(text)))
    comprehensions = sum(isinstance(node, COMPREHENSIONS) for node in nodes)
    return text.count("\n"), len(nodes), comprehensions


def modules_loaded(program: str, folder: Path) -> int:
    """Distinct modules of ours that a program has loaded when it ends; it runs in `folder`."""
    done = subprocess.run(
        [sys.executable, "-c", program + COUNT_MODULES],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    return int(done.stdout.split()[-1])


def budget() -> dict[str, dict[str, int]]:
    """The limits, by section of tools/budget.toml."""
    return tomllib.loads((ROOT / "tools" / "budget.toml").read_text("utf-8"))


def package_nodes() -> dict[str, int]:
    """Nodes of each package that ships; `top` are the files beside them."""
    folders = sorted(path.parent.name for path in ROOT.glob("holdfast/*/__init__.py"))
    nodes = {name: size_of([f"holdfast/{name}"]).nodes for name in folders}
    return nodes | {"top": size_of(["holdfast"]).nodes - sum(nodes.values())}


def limited_nodes() -> dict[str, int]:
    """The sums that have a limit, under their names in the budget."""
    return {name: size_of(folders).nodes for name, folders in LIMITED.items()}


def main() -> None:
    """Print the sizes, and those that have a limit beside it."""
    limits = budget()
    for name, nodes in package_nodes().items():
        print(f"{'holdfast/' + name:42}{nodes:12,}")
    shipped = size_of(["holdfast"])
    print(f"{'files':42}{shipped.files:12,}")
    print(f"{'lines':42}{shipped.lines:12,}")
    print(f"{'lines of the longest file':42}{shipped.most_lines:12,}")
    print(f"{'nodes a line':42}{shipped.nodes_a_line:12.2f}")
    per_1000 = shipped.comprehensions_per_1000_lines
    print(f"{'comprehensions in 1,000 lines':42}{per_1000:12.1f}")

    for name, nodes in limited_nodes().items():
        print(f"{'nodes: ' + name:42}{nodes:12,} of {limits['nodes'][name]:12,}")
    with tempfile.TemporaryDirectory() as folder:
        for name, program in WALKS.items():
            modules = modules_loaded(program, Path(folder))
            most = limits["walks"][name]
            print(f"{'modules loaded: ' + name:42}{modules:12,} of {most:12,}")


if __name__ == "__main__":
    main()
