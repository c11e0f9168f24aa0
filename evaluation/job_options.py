"""Where jobs run: the options --jobs and --dask."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from holdfast.evaluation.jobs import Workers

CORES = len(os.sched_getaffinity(0))
"""That this process may use."""


def add_job_options(parser: argparse.ArgumentParser, processes: int) -> None:
    """The options that `evaluate`, `loop`, `bench cost`, `make real` and `make real-more` share.

    processes: the default.
    """
    option = parser.add_argument
    jobs = f"processes (default {processes})"
    option("--jobs", type=_count, default=processes, metavar="N", help=jobs)
    dask = "run on a Dask cluster instead: the address of its scheduler (docs/cluster.md)"
    option("--dask", metavar="ADDRESS", help=dask)


def chosen_workers(args: argparse.Namespace) -> Workers:
    """Where the user wants jobs to run."""
    from holdfast.evaluation.jobs import Workers

    return Workers(args.jobs, args.dask)


def _count(word: str) -> int:
    if not word.isdecimal() or int(word) < 1:
        raise argparse.ArgumentTypeError(f"{word!r} is not a number of processes from 1 on")
    return int(word)
