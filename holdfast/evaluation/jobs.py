"""Independent jobs, in processes of this machine or on a Dask cluster.

A job computes the same wherever it runs, so results do not depend on where. A cluster gives a job
whose worker died to another one.
"""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from joblib import Parallel, delayed

from holdfast.core.errors import UsageError

if TYPE_CHECKING:
    from distributed import Client

Result = TypeVar("Result")
Job = Callable[[], Result]
ANSWERS_S = 10.0
"""How long a scheduler may take to answer."""


@dataclass(frozen=True)
class Workers:
    """Where jobs run.

    processes: how many of this machine. dask: address of a scheduler instead; its workers have the
    same Holdfast installed, and see the same files under the same names.
    """

    processes: int = 1
    dask: str | None = None

    @property
    def here(self) -> bool:
        """Whether jobs run one after another in this very process."""
        return self.dask is None and self.processes == 1

    def run(self, jobs: Sequence[Job[Result]]) -> Iterator[Result]:
        """The results in the order of the jobs. Raises what a job raises.

        Raises UsageError where no scheduler answers, or the package `distributed` is missing.
        """
        if self.dask is not None:
            yield from _on_cluster(self.dask, jobs)
        elif self.here:
            yield from (job() for job in jobs)
        else:
            # One job a batch: they last minutes, and differ in length.
            parallel = Parallel(self.processes, batch_size=1, return_as="generator")
            yield from parallel(delayed(job)() for job in jobs)


def _on_cluster(address: str, jobs: Sequence[Job[Result]]) -> Iterator[Result]:
    with _client(address) as client:
        # Not by their arguments: a job may write files, so one that was done is done again.
        futures = deque(client.submit(job, pure=False) for job in jobs)
        while futures:
            # In the order of the jobs, and each future let go once its result was taken.
            yield futures.popleft().result()


@contextmanager
def _client(address: str) -> Iterator[Client]:
    try:
        from distributed import Client
        from distributed.comm import get_address_host_port
    except ImportError as error:
        raise UsageError(
            f"--dask needs the package {error.name}",
            cause="only the extra `dask` installs it",
            next_step="pip install 'holdfast[dask]'",
        ) from None

    # Dask's own client waits much longer, and logs instead of raising.
    try:
        # A plain connection shows within ANSWERS_S whether anything listens.
        socket.create_connection(get_address_host_port(address), ANSWERS_S).close()
        client = Client(address, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"--dask {address}: no scheduler answers ({error})",
            cause="it is not running, or its address is another one",
            next_step="start one with `dask scheduler`, and give the address that it prints",
        ) from None

    # Closed at the end, also where a job raises: the cluster goes on without this client.
    with client:
        yield client
