"""What a verb says beside its answers."""

from __future__ import annotations

import sys

from edge_runtime.visible import visible_lines


def say(line: str) -> None:
    """What happens, beside the answers."""
    sys.stderr.write(visible_lines(line) + "\n")
