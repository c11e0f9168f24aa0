"""The house in numbers: how many modules a program loads, and how much is shipped."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path
from statistics import median

import pytest
from packages import ROOT, nodes_of

FILES = sorted((ROOT / "holdfast").rglob("*.py"))
COUNT = """
import sys
loaded = {
    module.__file__
    for name, module in list(sys.modules.items())
    if name.split(".")[0] == "holdfast"
}
print(len(loaded))
"""
MONITOR = """
import numpy as np
import holdfast
monitor = holdfast.load("holdfast-150hz", live=False)
for k in range(3):
    sample = holdfast.Sample(round(k * 1e9 / 150), np.zeros(18), np.ones(6, bool), k)
    monitor.feed(sample)
"""
VERB = """
import sys
from holdfast.cli.main import main
for words in {}:
    main(words)
"""
RUN = ["run", "holdfast-150hz", "--source", "virtual://ft232h", "--quiet"]
LOOP = ["loop", "thesis", "--trials", "2", "--jobs", "1", "--json", "loop.json"]
TRAIN = ["train", "--learner", "forest", "--out", "made"]
EXPORT = ["export", "made", "--out", "made.onnx"]


def loaded_by(program: str, folder: Path) -> int:
    """Distinct modules of ours that a program has loaded when it ends."""
    done = subprocess.run(
        [sys.executable, "-c", program + COUNT],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    return int(done.stdout.split()[-1])


def test_import_holdfast_loads_one_module(tmp_path: Path) -> None:
    assert loaded_by("import holdfast; dir(holdfast)", tmp_path) == 1


@pytest.mark.parametrize(
    ("program", "most"),
    [
        pytest.param(MONITOR, 15, id="a fed monitor"),
        pytest.param(
            VERB.format([[*RUN, "--seconds", "0.5"]]), 60, id="a virtual hand"
        ),
        pytest.param(VERB.format([LOOP]), 60, id="a closed loop"),
        pytest.param(VERB.format([TRAIN, EXPORT]), 57, id="train and export"),
    ],
)
def test_a_program_loads_few_modules(program: str, most: int, tmp_path: Path) -> None:
    assert loaded_by(program, tmp_path) <= most


def test_few_files_are_shipped_and_none_is_long() -> None:
    lines = {path: len(path.read_text("utf-8").splitlines()) for path in FILES}
    assert len(FILES) <= 300
    assert [path for path, n in lines.items() if n > 450] == []
    assert 120 <= median(lines.values()) <= 200


def test_what_is_shipped_is_little_and_plain() -> None:
    lines = sum(path.read_text("utf-8").count("\n") for path in FILES)
    nodes = [node for path in FILES for node in nodes_of(path)]
    kinds = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
    comprehensions = sum(isinstance(node, kinds) for node in nodes)
    assert len(nodes) <= 330_000
    assert len(nodes) / lines <= 6.3
    assert 1000 * comprehensions / lines <= 20
