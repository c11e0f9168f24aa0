"""Progress of long work on stderr: a bar with the time left, or one line a stage.

A function that takes long has two parameters: `say`, which receives the name of each stage as it
begins, and `part`, which receives the share of the stage that is done.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from holdfast.core.errors import visible


class Stages:
    """Call it with the stage that begins; `part` takes the share of it that is done, 0 to 1."""

    def __init__(self, progress: Any, bar: Any) -> None:
        self._progress, self._bar, self._begun = progress, bar, -1
        self._started_s = time.perf_counter()

    def __call__(self, text: str) -> None:
        """The stage under way has ended, and this one begins."""
        line = visible(text)
        elapsed_s = time.perf_counter() - self._started_s
        timed = f"{elapsed_s:6.0f} s  {line}"
        if self._progress is None:
            sys.stderr.write(f"{timed}\n")
            return

        self._begun += 1
        self._progress.update(self._bar, description=line, completed=self._begun)
        self._progress.console.print(
            timed,
            style="dim",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )

    def part(self, share: float) -> None:
        """So much of the stage under way is done."""
        if self._progress is not None:
            self._progress.update(self._bar, completed=max(self._begun, 0) + share)


@contextmanager
def stages(total: int) -> Iterator[Stages]:
    """Yields a Stages, to be called once for each of `total` stages as it begins."""
    try:
        progress = _progress()
    except ModuleNotFoundError:
        # On the hand, where only the live path is installed, there are lines without a bar.
        yield Stages(None, None)
        return
    with progress:
        yield Stages(progress, progress.add_task("starting", total=total))


@contextmanager
def counted(text: str, total: int) -> Iterator[Callable[[float], None]]:
    """Yields a function that takes how many of `total` are done. text: the name of the work."""
    line = visible(text)
    try:
        progress = _progress()
    except ModuleNotFoundError:
        sys.stderr.write(f"{line}\n")
        yield ignored
        return
    with progress:
        if not progress.console.is_terminal:
            progress.console.print(line, highlight=False, markup=False, soft_wrap=True)

        bar = progress.add_task(line, total=total)
        yield lambda done: progress.update(bar, completed=done)


def _progress() -> Any:
    # late, so that what only counts loads no rich
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    # Lines printed on a terminal go above the bar; a pipe gets them unchanged.
    return Progress(
        *columns,
        console=console,
        transient=True,
        redirect_stdout=sys.stdout.isatty(),
        disable=not console.is_terminal,
    )


Say = Callable[[str], None]
Part = Callable[[float], None]
"""Takes which share of the stage under way is done, 0 to 1."""


def ignored(message: object) -> None:
    """A Say or a Part that shows nothing."""
