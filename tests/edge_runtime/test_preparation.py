"""How a model file's values are prepared: what such a description may hold."""

from __future__ import annotations

import pytest

from holdfast.edge_runtime.preparation import (
    MOST_ROWS,
    Preparation,
    preparation_from_json,
)


@pytest.mark.parametrize("rows", [-1, MOST_ROWS + 1, 2.0, True, "5", None])
def test_rows_of_a_bias_are_a_whole_number_within_bounds(rows: object) -> None:
    value = Preparation().to_json() | {"bias_rows": rows}
    with pytest.raises(ValueError, match="bias_rows"):
        preparation_from_json(value)


@pytest.mark.parametrize("rows", [0, MOST_ROWS])
def test_a_description_comes_back_as_it_was(rows: int) -> None:
    made = Preparation(bias_rows=rows)
    assert preparation_from_json(made.to_json()) == made
