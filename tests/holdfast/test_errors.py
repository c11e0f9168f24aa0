"""What an error says: one line, of a bounded length, and which extra is missing."""

from __future__ import annotations

import pytest

from holdfast.core.errors import LONGEST_LINE, LibraryMissing, needs_extra, one_line


def test_a_library_that_does_not_load_is_an_error_that_names_its_extra() -> None:
    with (
        pytest.raises(LibraryMissing, match="no_such_library does not load") as error,
        needs_extra("camera"),
    ):
        __import__("no_such_library")
    assert error.value.next_step == "pip install 'holdfast[camera]'"


def test_a_long_text_keeps_its_beginning_and_its_end() -> None:
    half = LONGEST_LINE // 2
    text = "a" * half + "b" * 5 * LONGEST_LINE + "c" * half
    assert one_line(text) == f"{'a' * half} .. {'c' * half}"
    assert one_line("a  b\n c") == "a b c"
