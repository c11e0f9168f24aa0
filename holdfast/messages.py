"""What a verb says beside its answers."""

from __future__ import annotations

import sys


def say(line: str) -> None:
    """What happens, beside the answers."""
    sys.stderr.write(line + "\n")
