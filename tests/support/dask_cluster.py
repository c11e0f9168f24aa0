"""A Dask cluster on this machine."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[str]:
    """Address of a scheduler with one worker, threads of this process; their library warns of
    itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        import dask
        from distributed import LocalCluster

        dask.config.set({"temporary-directory": str(tmp_path)})
        with LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            protocol="tcp",
            dashboard_address=None,
        ) as local:
            yield local.scheduler_address
        # It leaves connections to the collector, which warns of each: of no later test.
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()
