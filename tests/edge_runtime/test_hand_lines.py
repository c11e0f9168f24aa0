"""Lines to a hand: which are obeyed, and what is skipped."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.hand_lines import (
    SILENCE_NS,
    RisingRule,
    SkippedLines,
    fields_of,
    printable,
    sequence_of,
)
from holdfast.drivers.virtual.faults import VirtualClock

# -- the rule


@given(
    st.lists(
        st.tuples(st.integers(0, 400_000_000), st.none() | st.integers(0, 9)),
        max_size=60,
    )
)
def test_a_line_that_is_obeyed_is_above_the_last_one_or_comes_after_a_silence(
    lines: list[tuple[int, int | None]],
) -> None:
    rule, now_ns, obeyed_ns, newest = RisingRule(), 0, None, None
    for later_ns, sequence in lines:
        now_ns += later_ns
        silent = obeyed_ns is None or now_ns - obeyed_ns > SILENCE_NS
        above = sequence is None or newest is None or sequence > newest
        assert rule.obeys(now_ns, sequence) == (silent or above)
        if silent or above:
            obeyed_ns, newest = now_ns, sequence


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"1",
        b"[]",
        b"null",
        b"[" * 2000,
        b"{",
        b"\xff",
        b"{}{}",
        b"{" + b" " * (16 << 10) + b"}",
    ],
)
def test_what_is_not_one_json_object_has_no_fields(line: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        fields_of(line)


@pytest.mark.parametrize("value", [-1, 1.0, True, "1", [1]])
def test_a_sequence_is_a_whole_number_from_0_on(value: object) -> None:
    with pytest.raises(ValueError, match="sequence"):
        sequence_of(value)
    assert sequence_of(None) is None
    assert sequence_of(0) == 0


def test_what_is_skipped_is_said_once_a_second_and_counted() -> None:
    clock, said = VirtualClock(), list[str]()
    skipped = SkippedLines("commands", said.append, clock.now_ns)
    for _ in range(150):
        skipped.count("not rising", "a line")
        clock.spend(10_000_000)
    skipped.close()
    assert said == [
        "commands: a line",
        "commands: a line",
        "commands: 150 skipped in all",
    ]
    assert skipped.total == {"not rising": 150}
    assert printable(b"\x1b[2J\x00" + b"a" * 90) == r"\x1b[2J\x00" + "a" * 75
