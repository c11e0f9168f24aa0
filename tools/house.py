"""`python -m tools.house`: the size of the house, and how many modules each walk through it loads.

Things are counted as nodes of the syntax tree, because lines say more about the formatter.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

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
RUN = ["run", "holdfast-150hz", "--source", "virtual://ft232h", "--quiet"]
LOOP = ["loop", "coarse.toml", "--model", "holdfast-50hz"]
LOOP += ["--trials", "1", "--jobs", "1", "--json", "loop.json"]
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
TRAIN = ["train", "--learner", "forest", "--size", "tiny", "--out", "made"]
EXPORT = ["export", "made", "--out", "made.onnx"]
WALKS = {
    "import holdfast": "import holdfast; dir(holdfast)",
    "a fed monitor": MONITOR,
    "a virtual hand": VERBS.format([[*RUN, "--seconds", "0.5"]]),
    "a closed loop": COARSE + VERBS.format([LOOP]),
    "train and export": VERBS.format([TRAIN, EXPORT]),
}
"""A walk through the house -> the program that goes it."""


@dataclass(frozen=True)
class Size:
    """Of some Python files. lines: all of them, also empty ones."""

    files: int
    lines: int
    nodes: int
    comprehensions: int
    median_lines: float
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
    texts = [path.read_text("utf-8") for path in files]
    lines = [text.count("\n") for text in texts]
    nodes = [node for text in texts for node in ast.walk(ast.parse(text))]
    return Size(
        files=len(files),
        lines=sum(lines),
        nodes=len(nodes),
        comprehensions=sum(isinstance(node, COMPREHENSIONS) for node in nodes),
        median_lines=median(lines),
        most_lines=max(lines),
    )


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


def main() -> None:
    """Print the size of each part, and each walk."""
    packages = sorted(path.parent.name for path in ROOT.glob("holdfast/*/__init__.py"))
    parts = {f"holdfast/{name}": [f"holdfast/{name}"] for name in packages}
    parts |= {"shipped": ["holdfast"], "studies, benchmarks": ["studies", "benchmarks"]}
    parts["tests"] = ["tests"]
    print(f"{'':24}files   lines   nodes  nodes a line  comprehensions per 1,000")
    for name, folders in parts.items():
        size = size_of(folders)
        dense, comprehensions = size.nodes_a_line, size.comprehensions_per_1000_lines
        counts = f"{size.files:5} {size.lines:7,} {size.nodes:7,}"
        print(f"{name:24}{counts} {dense:13.2f} {comprehensions:25.1f}")
    with tempfile.TemporaryDirectory() as folder:
        for name, program in WALKS.items():
            print(f"{name:24}{modules_loaded(program, Path(folder)):5} modules of ours")


if __name__ == "__main__":
    main()
