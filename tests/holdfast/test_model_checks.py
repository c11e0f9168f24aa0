"""`holdfast doctor MODEL` says what holds, and fails on a model that only its seal speaks for."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnx
import pytest

from holdfast.cli.main import main
from holdfast.edge_runtime.model_file import CARD_KEY
from holdfast.edge_runtime.monitor import Model
from holdfast.export.exporting import seal
from holdfast.step.artifact import read_artifact

if TYPE_CHECKING:
    from conftest import Built

DEFAULT = Path(__file__).resolve().parents[2] / "models" / "holdfast-150hz.onnx"
EVERY = [
    "golden rows",
    "one sample against a batch",
    "reset forgets",
]


HEAVY = {
    "scipy",
    "sklearn",
    "pandas",
    "onnx",
    "usb",
    "rich",
    "training",
    "export",
    "simulation",
}
ALONE = """
import sys
from holdfast.cli.main import main
code = main(["doctor", *sys.argv[1:]])
print(*sorted({name.removeprefix("holdfast.").split(".")[0] for name in sys.modules}))
sys.exit(code)
"""


def alone(model: Path, *words: str) -> tuple[list[str], set[str]]:
    """What the check says of a model that holds, in a process of its own, whose memory it looks
    at; and the packages that the process has loaded."""
    command = [sys.executable, "-c", ALONE, str(model), *words]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    *lines, modules = done.stdout.splitlines()
    return lines, set(modules.split())


@pytest.fixture(scope="module")
def default_alone() -> tuple[list[str], set[str]]:
    """The check of the default model: its lines, and the packages that it has loaded."""
    return alone(DEFAULT)


@pytest.mark.hard_case(
    "Forest and ONNX",
    "the board answers otherwise than the machine it was verified on",
    elsewhere="the tests ran on another machine only",
    here="`holdfast doctor MODEL` replays the stored answers on the board, with the very file "
    "that is deployed",
)
def test_the_default_model_holds_line_by_line(default_alone, record_property):
    lines, _ = default_alone
    assert [line[9:39].strip() for line in lines] == EVERY
    assert {line[:9] for line in lines} == {"ok       "}
    record_property("checks", len(lines))


def test_it_needs_what_is_on_the_hand_and_nothing_else(default_alone):
    _, modules = default_alone
    assert modules & HEAVY == set()


# -- models that are damaged and sealed again, with golden rows of their own

Graph = onnx.GraphProto


def rewired(graph: Graph, name: str, *nodes: onnx.NodeProto) -> None:
    """Nodes that read `name` read the last of these nodes' output instead."""
    for node in graph.node:
        for k, wanted in enumerate(node.input):
            if wanted == name:
                node.input[k] = nodes[-1].output[0]
    after = list(graph.node)
    del graph.node[:]
    graph.node.extend([*nodes, *after])


def constant(graph: Graph, value: np.generic) -> str:
    graph.initializer.append(
        onnx.numpy_helper.from_array(
            np.asarray(value), name := f"more_{len(graph.initializer)}"
        )
    )
    return name


def a_reset_that_is_ignored(graph: Graph) -> None:
    rewired(
        graph,
        "reset",
        onnx.helper.make_node(
            "And", ["reset", constant(graph, np.bool_(False))], ["never"]
        ),
    )


def damaged(built: Built, damage: Callable[[Graph], None], path: Path) -> Path:
    """A file that is sealed after the damage, with golden rows of its own."""
    model = onnx.load_from_string(built.model.read_bytes())
    card = json.loads(
        {entry.key: entry.value for entry in model.metadata_props}[CARD_KEY]
    )
    damage(model.graph)
    path.write_bytes(seal(model, card, read_artifact(built.artifact).spec))
    return path


@pytest.mark.hard_case(
    "Forest and ONNX",
    "a model that is wrong and properly sealed",
    elsewhere="its hash is right, its golden rows are its own, and so it is trusted",
    here="`holdfast doctor MODEL` checks properties of the file that golden rows cannot show",
)
def test_the_check_fails_on_a_model_that_ignores_its_reset(
    four_situations: Built, tmp_path: Path, capsys
):
    path = damaged(four_situations, a_reset_that_is_ignored, tmp_path / "m.onnx")
    Model(path)
    assert main(["doctor", str(path), "--json"]) == 1
    content = json.loads(capsys.readouterr().out)["findings"]
    broken = [one["what"] for one in content if one["status"] == "broken"]
    assert "reset forgets" in broken
