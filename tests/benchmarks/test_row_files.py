"""Rows kept on disk: computed once, and never half a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.cost.kept_rows import digest_of, kept_rows


def test_rows_are_computed_once_and_read_back_bit_for_bit(tmp_path: Path) -> None:
    rows, calls = np.arange(6, dtype=np.float32).reshape(2, 3), []

    def compute() -> np.ndarray:
        calls.append(1)
        return rows

    for _ in range(2):
        assert (
            kept_rows(tmp_path / "new" / "rows.npy", compute).tobytes()
            == rows.tobytes()
        )
    assert len(calls) == 1


def test_a_computation_that_fails_leaves_no_file(tmp_path: Path) -> None:
    def fail() -> np.ndarray:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kept_rows(tmp_path / "rows.npy", fail)
    assert not (tmp_path / "rows.npy").exists()


def test_the_digest_does_not_depend_on_the_order_of_keys() -> None:
    assert (
        digest_of({"a": 1, "b": 2})
        == digest_of({"b": 2, "a": 1})
        != digest_of({"a": 1})
    )
