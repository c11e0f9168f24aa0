"""How a model file's values are prepared, and how many recordings are stepped together."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from holdfast.edge_runtime.graph import step_recordings
from holdfast.edge_runtime.preparation import MOST_ROWS, Preparation, Tare


@pytest.mark.parametrize("rows", [0, MOST_ROWS])
def test_a_description_comes_back_as_it_was(rows: int) -> None:
    made = Preparation(bias_rows=rows)
    assert msgspec.convert(made.to_json(), Preparation) == made


RAW = np.array(
    [
        [1.0, 2.0, -3.0, 1.0, 1.0, 0.5],
        [2.0, np.nan, -5.0, 3.0, 1.0, -9.0],
        [6.0, 4.0, -4.0, 2.0, 1.0, 1.5],
        [9.0, 9.0, 9.0, 9.0, 9.0, 9.0],
    ]
)


@pytest.mark.parametrize(
    ("options", "sign", "bias"),
    [
        ({}, [1] * 6, [0] * 6),
        ({"bias_rows": 3}, [1] * 6, [6, 4, -3, 2, 1, 0.5]),
        (
            {"bias_rows": 3, "statistic": "mean"},
            [1] * 6,
            [16 / 3, 5, 2 / 3, 2, 1, -7 / 3],
        ),
        (
            {"bias_rows": 3, "flip_negative_normal": True, "flip_beyond": 2.9},
            [1, 1, -1, 1, 1, 1],
            [6, 4, 3, 2, 1, 0.5],
        ),
        (
            {"bias_rows": 3, "flip_negative_normal": True, "turns": "sensor"},
            [-1, -1, -1, 1, 1, 1],
            [-6, -4, 3, 2, 1, 0.5],
        ),
        (
            {"bias_rows": 3, "flip_negative_normal": True, "flip_beyond": 3.0},
            [1] * 6,
            [6, 4, -3, 2, 1, 0.5],
        ),
        ({"flip_negative_normal": True}, [1, 1, -1, 1, 1, 1], [0] * 6),
    ],
)
def test_the_first_rows_decide_sign_and_bias(
    options: dict[str, Any], sign: list[float], bias: list[float]
) -> None:
    preparation = Preparation(**options)
    found = preparation.learn(RAW)
    assert found[0].tolist() == sign
    assert found[1].tolist() == pytest.approx(bias)
    np.testing.assert_allclose(preparation.apply(RAW), RAW * sign - np.array(bias))
    # a stream whose second sensor comes a row late is tared by its own first rows
    tare = Tare(preparation, 6)
    valid = np.array([True, False])
    needed = max(1, preparation.bias_rows) if options else 0
    known = []
    for row in np.where(np.isnan(RAW), 3.0, RAW):
        known.append(tare.prepare(row, valid)[1].tolist())
        valid = np.array([True, True])
    if not options:
        assert known == [[True, False], *[[True, True]] * 3]
    else:
        assert [one for one, _ in known] == [k >= needed for k in range(1, 5)]
        assert [two for _, two in known] == [k > needed for k in range(1, 5)]


def test_what_the_unloaded_hand_reads_is_the_bias_of_a_loaded_stream() -> None:
    preparation = Preparation(bias_rows=3, flip_negative_normal=True, flip_beyond=1.0)
    tare = Tare(preparation, 6, np.array([1.0, 2.0, -3.0, 1.0, 1.0, -0.5]))
    assert tare.known.all()
    values, valid = tare.prepare(RAW[3], np.array([True, False]))
    assert values.tolist() == [8.0, 7.0, -12.0, 8.0, 8.0, 9.5]
    assert valid.tolist() == [True, False]


# -- many recordings at once


class Counting:
    """A step that counts, and says for each hand what it was given."""

    def __init__(self, hands: int) -> None:
        self.sample = np.zeros((hands, 3))
        self.valid = np.zeros((hands, 1), np.bool_)
        self.out = {"sum": np.zeros(hands), "all": np.zeros((hands, 2))}
        self.steps = 0

    def step(self) -> Any:
        self.out["sum"][:] = self.sample.sum(axis=1)
        self.out["all"][:, 0], self.out["all"][:, 1] = self.steps, self.valid[:, 0]
        self.steps += 1
        return self.out

    def reset(self) -> None:
        """Never asked for: each batch has a step of its own."""
        raise AssertionError


def test_many_recordings_are_stepped_together_by_length_and_keep_their_rows() -> None:
    lengths = [*range(70, 0, -1), 3]
    values = [np.full((n, 3), n) + np.arange(n)[:, None] for n in lengths]
    valid = [np.arange(n)[:, None] % 2 == 0 for n in lengths]
    rows = [np.arange(n)[n % 3 :: 1 + n % 4] for n in lengths]
    batches = []

    def steps(hands: int) -> Counting:
        batches.append(Counting(hands))
        return batches[-1]

    answers = step_recordings(steps, values, valid, rows)
    assert [len(one.sample) for one in batches] == [64, 7]
    # up to the last row that is wanted of any of them
    assert [one.steps for one in batches] == [61, 69]
    for n, kept, answer in zip(lengths, rows, answers, strict=True):
        assert answer["sum"].tolist() == (3 * (n + kept)).tolist()
        assert answer["all"].tolist() == np.stack([kept, kept % 2 == 0], 1).tolist()
    assert step_recordings(steps, [], [], []) == []
    (none,) = step_recordings(steps, values[:1], valid[:1], [np.arange(0)])
    assert (none["sum"].shape, none["all"].shape) == ((0,), (0, 2))
    assert batches[-1].steps == 0
