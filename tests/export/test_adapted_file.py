"""An adapted file: whole votes, the base inside it byte for byte, and no way around the checks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from adapted_model import RULES, base_of, correction, file_of
from small_model import card_of, metadata_of, spec, with_metadata

from holdfast.core.errors import NotAdapted, VerificationFailed
from holdfast.edge_runtime.model import Model
from holdfast.export.changed import (
    BASE_KEY,
    adapted,
    is_adapted,
    undone,
    verify_adapted,
)
from holdfast.step.features import feature_count


def rows(n: int = 300) -> np.ndarray:
    return (
        np.random.default_rng(2)
        .normal(size=(n, feature_count(spec())))
        .astype(np.float32)
    )


@pytest.mark.parametrize("committee", [False, True])
@pytest.mark.parametrize("eight", [True, False])
def test_the_base_comes_back_byte_for_byte(eight: bool, committee: bool) -> None:
    base = base_of(eight, committee)
    made = file_of(base)
    assert made != base
    assert is_adapted(made)
    assert not is_adapted(base)
    assert undone(made) == base


def test_parameters_alone_can_be_undone_too() -> None:
    base = base_of()
    made = adapted(base, None, RULES, {})
    assert card_of(made)["decision"]["min_risky_permille"] == 700
    assert undone(made) == base


@pytest.mark.parametrize("committee", [False, True])
@pytest.mark.parametrize("eight", [True, False])
def test_every_vote_of_an_adapted_file_is_the_reference_s(
    eight: bool, committee: bool, tmp_path: Path
) -> None:
    base = base_of(eight, committee)
    made, path = file_of(base), tmp_path / "m.onnx"
    path.write_bytes(made)
    assert Model(path).card.decision == RULES
    report = verify_adapted(base, made, correction(base), rows())
    assert report.rows > 300
    with pytest.raises(VerificationFailed, match="votes"):
        verify_adapted(base, made, correction(base, bias=-4000.0), rows())


def test_a_correction_takes_risky_votes_gives_them_to_safe_slip_and_keeps_the_sum() -> (
    None
):
    one = correction(base_of())
    votes = np.random.default_rng(3).integers(0, 4096, size=(300, 8))
    found = one.corrected(rows(), votes)
    assert (found >= 0).all()
    assert np.array_equal(found.sum(axis=1), votes.sum(axis=1))
    assert np.array_equal(found[:, :4], votes[:, :4])
    taken = votes[:, 6:] - found[:, 6:]
    assert (taken >= 0).all()
    assert taken.any()
    assert np.array_equal(found[:, 4:6] - votes[:, 4:6], taken)


def test_what_is_not_adapted_or_was_altered_cannot_be_undone() -> None:
    base = base_of()
    with pytest.raises(NotAdapted, match="not adapted"):
        undone(base)
    adapted = file_of(base)
    cut_off = metadata_of(adapted)[BASE_KEY][:-8]
    with pytest.raises(NotAdapted, match="restored"):
        undone(with_metadata(adapted, **{BASE_KEY: cut_off}))
