"""docs/step.svg shows the graph of the shipped model."""

from __future__ import annotations

import re
from pathlib import Path

import onnx
import pytest

from studies.doc_pictures.step import EDGE_X, edges, picture, stages

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def graph() -> onnx.GraphProto:
    return onnx.load(ROOT / "models/holdfast-150hz.onnx").graph


def test_the_page_shows_the_shipped_model_as_it_is(graph: onnx.GraphProto) -> None:
    assert picture(graph) == (ROOT / "docs/step.svg").read_text("utf-8")


def test_an_arrow_is_drawn_for_each_edge_and_for_no_other_pair(
    graph: onnx.GraphProto,
) -> None:
    assert edges(stages(graph)) == set(EDGE_X)
    arrows = len(re.findall(r'<path class="a"', picture(graph)))
    assert arrows == len(EDGE_X) + 2, "and one into the file, one out of it"


def test_an_edge_without_a_place_is_an_error(graph: onnx.GraphProto) -> None:
    changed = onnx.GraphProto()
    changed.CopyFrom(graph)
    first = next(
        node for node in changed.node if node.op_type == "TreeEnsembleRegressor"
    )
    first.input.append("part_bands")
    with pytest.raises(KeyError, match="bank"):
        picture(changed)
