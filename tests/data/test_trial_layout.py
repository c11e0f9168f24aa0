"""The names of a trial's files, the masses of objects, and when a hand is closed on something."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from holdfast.core.errors import LabelError
from holdfast.core.trial_layout import (
    Mass,
    contact_rows,
    is_heavy,
    mass_g,
    mass_of,
    named_mass,
    object_name,
    read_events,
)


def test_heavy_is_from_150_g_on() -> None:
    assert [is_heavy(one) for one in (149.9, 150.0, 150.1)] == [False, True, True]
    names = ("Soft_Ball", "EMPTY bottle", "colabottle", "mug")
    assert [object_name(one) for one in names] == [
        "soft-ball",
        "empty-bottle",
        "full-bottle",
        "mug",
    ]
    heavy = {name: named_mass(name).heavy for name in ("hard ball", "apple")}  # type: ignore[union-attr]
    assert heavy == {"hard ball": True, "apple": False}
    assert named_mass("mug") is None
    assert named_mass("softball", {"Soft_Ball": 150}).heavy  # type: ignore[union-attr]


@pytest.mark.parametrize("mass", [0, -1.0, True, "12", float("inf"), None])
def test_a_mass_is_a_positive_number_beside_the_recordings_first(
    tmp_path: Path, mass: object
) -> None:
    folder = tmp_path / "soft-ball"
    folder.mkdir()
    assert mass_g(folder) == 15.1
    (folder / "meta.json").write_text('{"mass_g": 5e-324}')
    assert mass_of(folder) == Mass(5e-324, str(folder / "meta.json"))
    if mass is not None:
        with pytest.raises(LabelError, match="mass of 'mug'"):
            named_mass("mug", {"mug": mass})
    with pytest.raises(LabelError, match=r'no mass given.*"mass_g": 120.0'):
        mass_g(tmp_path / "mug")


@pytest.mark.parametrize(
    ("rate_hz", "rows"), [(100.0, (46, 155)), (10.0, (50, 150)), (1.0, (50, 150))]
)
def test_a_hand_is_closed_while_its_mean_load_is_a_tenth_of_the_largest(
    rate_hz: float, rows: tuple[int, int]
) -> None:
    load = np.zeros(200)
    load[50:150] = 2.0
    assert contact_rows(load, rate_hz) == rows
    # one knock is not the measure of the trial
    load[100] = 1e3
    assert contact_rows(load, 1.0) == (50, 150)
    assert contact_rows(load, 1.0, 2.0) == (50, 150)
    assert contact_rows(load, 1.0, 2.001) is None
    load[20:30] = 0.2
    assert contact_rows(load, 1.0) == (20, 150)
    load[20:30] = 0.19
    assert contact_rows(load, 1.0) == (50, 150)


def test_the_last_event_may_be_torn_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    assert read_events(path) == []
    for text, count in (('{"a": 1}\n\n{"a": 2}', 2), ('{"a": 1}\n{"a": ', 1), ("", 0)):
        path.write_text(text)
        assert len(read_events(path)) == count
    for text in ('{"a"\n{"a": 1}\n', "[1]\n", '{"a": 1}\n[1]'):
        path.write_text(text)
        with pytest.raises(LabelError, match="not a JSON object"):
            read_events(path)
