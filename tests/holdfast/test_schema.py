"""Files of ours are read by one schema: an error names file, key, value and what is allowed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.errors import CardError, LabelError
from holdfast.core.schema import checked, read

Count = Annotated[int, msgspec.Meta(ge=1, le=9)]


class Row(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    count: Count
    kind: Literal["pull", "pass"] = "pull"
    at_s: tuple[float, float] | None = None


class Card(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    rows: tuple[Row, ...] = ()
    cues: dict[str, dict[str, Row]] = {}

    def __post_init__(self) -> None:
        if len(self.rows) > 2:
            raise ValueError(f"{len(self.rows)} rows; allowed: 0 to 2")


RANGE = "next: allowed: a whole number from 1 to 9"
GOOD = "[[rows]]\ncount = 3\n[cues.slip.first]\ncount = 1\nat_s = [0, 2.5]\n"


def test_what_stands_in_a_file_is_the_struct(tmp_path: Path) -> None:
    path = tmp_path / "card.toml"
    path.write_text(GOOD)
    card = Card((Row(3),), {"slip": {"first": Row(1, at_s=(0.0, 2.5))}})
    assert read(path, Card) == card
    same = tmp_path / "card.json"
    same.write_bytes(msgspec.json.encode(card))
    assert read(same, Card) == card


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "[[rows]]\ncount = 10",
            rf"rows\[0\]\.count = 10; {RANGE}",
        ),
        ("[[rows]]", r"rows\[0\]\.count is missing; next: allowed: count, kind, at_s"),
        (
            "[[rows]]\ncount = 1\n[[rows]]\ncount = 1\nkind = 'fall'",
            r"rows\[1\]\.kind = 'fall'; next: allowed: pull or pass",
        ),
        (
            "[cues.slip.a]\ncount = 1\n[cues.lift.a]\ncount = 1\nat_s = [1, 'x']",
            r"cues\.lift\.a\.at_s\[1\] = 'x'; next: allowed: a number",
        ),
        ("[cues.slip.a]\ncount = 1\nx = 1", r"cues\.slip\.a\.x is not known; next: "),
        ("[[rows]]\ncount = 1\n" * 3, "3 rows; next: allowed: 0 to 2"),
        (
            "[[rows]]\ncount = nan",
            "not valid TOML: nan is not a finite number",
        ),
        ("rows = [", "not valid TOML: .*next: correct that line"),
        ("rows = " + "[" * 99_999, "not valid TOML"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "card.toml"
    path.write_text(text)
    with pytest.raises(CardError, match=f"card.toml: {says}"):
        read(path, Card)


def test_a_file_without_text_is_an_error_of_the_class_that_is_asked_for(
    tmp_path: Path,
) -> None:
    (tmp_path / "a.json").write_bytes(b'{"rows": "\xff"}')
    with pytest.raises(LabelError, match=r"a\.json: not valid JSON"):
        read(tmp_path / "a.json", Card, LabelError)
    with pytest.raises(LabelError, match="cannot be read"):
        read(tmp_path, Card, LabelError)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "b.json", Card)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 20) | st.text(max_size=3),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["rows", "cues", "count", "a"]), inner)
    ),
    max_leaves=12,
)


@given(JSON)
def test_whatever_a_file_holds_it_is_the_struct_or_one_error(raw: object) -> None:
    try:
        card = checked(raw, Card, "card")
    except CardError:
        return
    assert json.loads(msgspec.json.encode(card)).keys() == {"rows", "cues"}
