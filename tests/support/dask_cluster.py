"""A Dask cluster on this machine."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import pytest


@pytest.fixture
def cluster() -> Iterator[str]:
    """Address of a scheduler with one worker in this process; its library warns of itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        from distributed import LocalCluster

        with LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            protocol="tcp",
            dashboard_address=None,
        ) as local:
            yield local.scheduler_address
