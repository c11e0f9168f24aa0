"""Independent jobs, in processes of this machine or on a Dask cluster.

A job computes the same wherever it runs, so results do not depend on where. A cluster gives a job
whose worker died to another one.

Processes of this machine end with the one that started them, whatever ends that one, also SIGKILL:
each watches a pipe that only the starting process can write to, and the kernel closes it.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import socket
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection
from threading import Event, Thread
from typing import TYPE_CHECKING, TypeVar

from joblib import Parallel, delayed

from holdfast.core.errors import UsageError, WorkersLost

if TYPE_CHECKING:
    from distributed import Client, Future

Result = TypeVar("Result")
Job = Callable[[], Result]
ANSWERS_S = 10.0
"""How long a scheduler may take to answer."""
LOOK_S = 2.0
"""Between two looks at a cluster whose result is waited for."""
CLOSES_S = 1.0
"""How long a scheduler may take to say goodbye."""


class NoWorkers(UserWarning):
    """A cluster without a worker: jobs wait until one comes."""


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

        Raises UsageError where no scheduler answers, or the package `distributed` is missing;
        WorkersLost where the scheduler or a process dies, with how many results there were. Warns
        (NoWorkers) of a cluster without a worker.
        """
        if self.dask is not None:
            yield from _on_cluster(self.dask, jobs)
        elif self.here:
            yield from (job() for job in jobs)
        else:
            yield from _in_processes(self.processes, jobs)


# -- processes of this machine


def _in_processes(processes: int, jobs: Sequence[Job[Result]]) -> Iterator[Result]:
    parallel = Parallel(
        processes,
        # One job a batch: they last minutes, and differ in length.
        batch_size=1,
        return_as="generator",
        initializer=_end_with,
        initargs=(_lifeline()[0],),
    )
    n_results = 0
    try:
        for result in parallel(delayed(job)() for job in jobs):
            yield result
            n_results += 1
    except BrokenProcessPool as error:
        raise WorkersLost(
            f"a process died; {_so_far(n_results, jobs)}",
            cause="too little memory for so many processes, or it was killed",
            next_step="give fewer with --jobs",
        ) from error


@cache
def _lifeline() -> tuple[Connection, Connection]:
    """A pipe that nothing is written to: what reads from it learns when this process has ended.

    One for all workers, and never closed here: the kernel does that, also after SIGKILL.
    """
    return multiprocessing.Pipe(duplex=False)


def _end_with(starter: Connection) -> None:
    """Begin a worker: it ends when the other end of the pipe is closed, whatever it computes."""
    # Ctrl-C in a terminal reaches every process; the one that started this one ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def wait() -> None:
        # At the end of a pipe it becomes readable.
        starter.poll(None)
        # Not an exception: it would end this thread only.
        os._exit(1)

    Thread(target=wait, daemon=True).start()


def _so_far(n_results: int, jobs: Sequence[Job[Result]]) -> str:
    return f"the first {n_results} of {len(jobs)} jobs were finished"


# -- a Dask cluster


def _on_cluster(address: str, jobs: Sequence[Job[Result]]) -> Iterator[Result]:
    with _client(address) as client:
        # Not by their arguments: a job may write files, so one that was done is done again.
        futures = deque(client.submit(job, pure=False) for job in jobs)
        while futures:
            # In the order of the jobs, and each future let go once its result was taken.
            so_far = _so_far(len(jobs) - len(futures), jobs)
            with _losses(address, so_far):
                result = _result(client, futures.popleft())
            yield result


def _result(client: Client, future: Future[Result]) -> Result:
    """The result of a job. Warns while no worker could give it."""
    # Not Dask's own `wait`: Ctrl-C in it is logged with a traceback.
    settled = Event()
    future.add_done_callback(lambda _: settled.set())
    warned = False
    while not settled.wait(LOOK_S):
        no_worker = not client.nthreads()
        if no_worker and not warned:
            _warn_of_no_worker(client)
        warned = no_worker
    return future.result()


def _warn_of_no_worker(client: Client) -> None:
    address = client.scheduler.address
    warnings.warn(
        f"{address} has no worker, and jobs wait until one comes; next: dask worker {address}",
        NoWorkers,
        stacklevel=3,
    )


@contextmanager
def _losses(address: str, so_far: str) -> Iterator[None]:
    """Raise WorkersLost for a scheduler that ends, and for a job that workers die of."""
    from distributed import KilledWorker
    from distributed.comm import CommClosedError

    try:
        yield
    except (CancelledError, CommClosedError):
        raise WorkersLost(
            f"--dask {address}: the scheduler was lost; {so_far}",
            cause="it ended, or the network did",
            next_step="start it again, and give its address to the same command",
        ) from None
    except KilledWorker as error:
        raise WorkersLost(
            f"--dask {address}: {error.allowed_failures + 1} workers died of one job; {so_far}",
            cause="it needs more memory than a worker may have",
            next_step="start workers with a larger --memory-limit",
        ) from None


@contextmanager
def _client(address: str) -> Iterator[Client]:
    """A client that is closed at the end; the cluster goes on without it."""
    try:
        from distributed import Client
        from distributed.comm import get_address_host_port
    except ImportError as error:
        raise UsageError(
            f"--dask needs the package {error.name}",
            cause="only the extra `dask` installs it",
            next_step="pip install 'holdfast[dask]'",
        ) from None

    # What it logs, with tracebacks, is raised as an error as well.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)

    # Dask's own client waits much longer, and logs instead of raising.
    try:
        # A plain connection shows within ANSWERS_S whether anything listens.
        socket.create_connection(get_address_host_port(address), ANSWERS_S).close()
        client = Client(address, timeout=ANSWERS_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"--dask {address}: no scheduler answers ({error})",
            cause="it is not running, or its address is another one",
            next_step="start one with `dask scheduler`, and give the address that it prints",
        ) from None

    try:
        yield client
    finally:
        # A scheduler that was lost says no goodbye, and after Ctrl-C the user waits for the end.
        with suppress(TimeoutError):
            client.close(timeout=CLOSES_S)
