"""Libraries that only an extra installs: what is said when one of them is missing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from holdfast.edge_runtime.errors import LibraryMissing


@contextmanager
def needs_extra(name: str) -> Iterator[None]:
    """Around the imports of an extra's libraries. Raises LibraryMissing, which names the extra."""
    try:
        yield
    except ImportError as error:
        raise LibraryMissing(
            f"the library {error.name or '?'} does not load ({error})",
            cause=f"only the extra `{name}` installs it",
            next_step=f"pip install 'holdfast[{name}]'",
        ) from None
