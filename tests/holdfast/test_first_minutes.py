"""The first five minutes of an engineer: what a terminal shows, and steps that exist."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from live_bench import free_port

if TYPE_CHECKING:
    pass

LINE = b'{"sequence":'
PORT = "PORT"
"""Stands for a free port of this machine."""


def shown_on_a_terminal(*words: str) -> bytes:
    """What a short run of a virtual hand writes to a terminal on stdout."""
    seen, terminal = os.openpty()
    command = [sys.executable, "-m", "holdfast", "run", "--source", "virtual://ft232h"]
    done = subprocess.run(
        [*command, "--seconds", "0.2", *words],
        stdout=terminal,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(terminal)
    shown = b""
    # once all its writers have closed it, reading a terminal is an error
    try:
        while part := os.read(seen, 65536):
            shown += part
    except OSError:
        pass
    os.close(seen)
    assert done.returncode == 0, done.stderr
    assert b" samples, " in done.stderr
    return shown


@pytest.mark.parametrize(
    ("words", "lines"),
    [((), True), (("--to", "view"), False), (("--to", PORT), False)],
    ids=["alone", "beside a view", "beside a page"],
)
def test_a_terminal_shows_json_lines_or_a_picture_and_never_both(
    words: tuple[str, ...], lines: bool
) -> None:
    # chosen now: another program may have taken one that was free when tests were collected
    chosen = [f"web:{free_port()}" if word == PORT else word for word in words]
    assert (LINE in shown_on_a_terminal(*chosen)) is lines
