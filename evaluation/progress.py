"""Progress of long work: one bar on the terminal, one line a stage where there is none."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from edge_runtime.visible import visible
from training.say import Say


@contextmanager
def stages(total: int) -> Iterator[Say]:
    """Yields `say(line)`, which ends one stage and names the next; `total` is how many lines will come."""
    started, console = time.perf_counter(), Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("starting", total=total)

        def say(text: str) -> None:
            line = visible(text)
            progress.update(bar, description=line, advance=1)
            elapsed_s = time.perf_counter() - started
            progress.console.print(f"{elapsed_s:6.0f} s  {line}", style="dim", highlight=False, markup=False)

        yield say
