"""What an error says: one line, of a bounded length, and which extra is missing."""

from __future__ import annotations

import pytest

from holdfast.core.errors import LibraryMissing, needs_extra


def test_a_library_that_does_not_load_is_an_error_that_names_its_extra() -> None:
    with (
        pytest.raises(LibraryMissing, match="no_such_library does not load") as error,
        needs_extra("camera"),
    ):
        __import__("no_such_library")
    assert error.value.next_step == "pip install 'holdfast[camera]'"
