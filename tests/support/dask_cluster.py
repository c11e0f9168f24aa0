"""A Dask cluster on this machine."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def of_this_process(n_workers: int) -> Iterator[Any]:
    """A cluster whose scheduler and workers are threads; its library warns of itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        from distributed import LocalCluster

        with LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=False,
            protocol="tcp",
            dashboard_address=None,
        ) as local:
            yield local
        # It leaves connections to the collector, which warns of each: of no later test.
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


@pytest.fixture
def cluster() -> Iterator[str]:
    """Address of a scheduler with one worker in this process."""
    with of_this_process(n_workers=1) as local:
        yield local.scheduler_address
