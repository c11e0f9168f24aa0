"""The words and numbers that every part shares."""

from __future__ import annotations

import pytest

from holdfast.core.contract import (
    CLASSES,
    UNIT_OF,
    channel_names,
    class_id,
    is_rate,
    not_learned_of,
)
from holdfast.core.errors import ChannelError, UnitError
from holdfast.drivers.lsl import order_of, unit_of


def test_a_class_has_the_number_of_its_situation_and_weight() -> None:
    ids = [class_id(k, heavy=heavy) for k in range(4) for heavy in (False, True)]
    assert ids == [*range(8)]
    assert CLASSES[class_id(3, heavy=True)] == "risky_slip_heavy"
    assert CLASSES[class_id(0, heavy=False)] == "nothing_light"


def test_a_rate_is_a_number_from_a_thousandth_to_a_hundred_thousand_hz() -> None:
    rates = (1e-3, 150.0, 1e5, 0.999e-3, 1.001e5, float("nan"), -1.0)
    assert [is_rate(one) for one in rates] == [True] * 3 + [False] * 4


def test_each_unit_has_its_factor_to_one_of_ours() -> None:
    assert {
        "N": ("N", 1.0),
        "mN": ("N", 0.001),
        "cN": ("N", 0.01),
        "dN": ("N", 0.1),
        "kN": ("N", 1000.0),
        "gf": ("N", pytest.approx(0.00980665)),
        "kgf": ("N", pytest.approx(9.80665)),
        "lbf": ("N", pytest.approx(4.4482216152605)),
        "ozf": ("N", pytest.approx(0.2780138509537812)),
        "uT": ("uT", 1.0),
        "mT": ("uT", 1000.0),
        "G": ("uT", 100.0),
        "T": ("uT", 1e6),
        "count": ("count", 1.0),
    } == UNIT_OF


def test_channels_stand_together_sensor_by_sensor() -> None:
    assert channel_names(2) == ("X1", "Y1", "Z1", "X2", "Y2", "Z2")
    assert channel_names(0) == ()


@pytest.mark.parametrize(
    "card", [{}, {"training": 1}, {"training": {"cannot_tell": 2}}]
)
def test_a_card_that_does_not_say_what_it_cannot_tell_tells_all(card: object) -> None:
    assert not_learned_of(card) == {}  # type: ignore[arg-type]
    assert not_learned_of({"training": {"cannot_tell": {"weight": "a"}}}) == {
        "weight": "a"
    }


@pytest.mark.parametrize(
    ("words", "unit"),
    [
        ("N newton NEWTONS", "N"),
        ("uT µT Microtesla", "uT"),
        ("count counts", "count"),
        ("N uT", None),
        ("lb", None),
        ("", None),
    ],
)
def test_all_channels_of_a_stream_have_one_unit(words: str, unit: str | None) -> None:
    if unit:
        assert unit_of([f" {one} " for one in words.split()], "a") == unit
        return
    said = " and ".join(sorted(words.lower().split())) or "nothing"
    with pytest.raises(UnitError, match=said.split(" and ")[0]):
        unit_of(words.split() or [""], "lsl://a")


def test_labels_of_the_layout_give_the_order_and_others_none() -> None:
    assert order_of(["Z1", "Y1", "X1"], "a") == [2, 1, 0]
    assert order_of(["a", "Y1", "X1"], "a") == [0, 1, 2]
    for wrong in ([], ["X1", "Y1"], ["X1", "Y1", "Z1", "X2"]):
        with pytest.raises(ChannelError, match=f"{len(wrong)} channels"):
            order_of(wrong, "a")
