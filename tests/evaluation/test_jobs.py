"""Where independent jobs run: the same results in the same order, and none lost with a worker."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from command_line import Run
from loop_bench import SLOWER, card_text, row
from small_jobs import dies_at_gate, square

from holdfast.core.errors import WorkersLost
from holdfast.evaluation.jobs import Job, Workers

SUPPORT = Path(__file__).resolve().parents[1] / "support"
PROGRAM = """
import sys
from functools import partial
from pathlib import Path
from small_jobs import held
from holdfast.cli.command import finish
from holdfast.evaluation.jobs import Workers

def main(words):
    where = Workers(dask=words[1]) if words[1:] else Workers(2)
    list(where.run([partial(held, Path(words[0])) for _ in range(2)]))
    return 0

if __name__ == "__main__":
    raise SystemExit(finish(main, sys.argv[1:]))
"""
"""Two held jobs, in processes or on a cluster."""
LONGEST_S = 60.0
"""A wait that lasts so long has failed."""


def results_of(workers: Workers) -> tuple[list[int], set[int]]:
    found = list(workers.run([partial(square, number) for number in range(7)]))
    return [one for one, _ in found], {process for _, process in found}


def test_results_come_in_the_order_of_the_jobs_wherever_these_run(cluster: str) -> None:
    squares = [number * number for number in range(7)]
    assert results_of(Workers()) == (squares, {os.getpid()})
    assert results_of(Workers(dask=cluster))[0] == squares
    answers, processes = results_of(Workers(2))
    assert answers == squares
    assert os.getpid() not in processes


@contextmanager
def held_jobs(
    folder: Path, n_running: int, *words: str
) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A program whose jobs run, and a pipe that ends with the last of the jobs."""
    pipe = folder / "pipe"
    os.mkfifo(pipe)
    reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    command = [sys.executable, "-c", PROGRAM, str(pipe), *words]
    environment = {**os.environ, "PYTHONPATH": str(SUPPORT)}
    with subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, text=True
    ) as program:
        try:
            for _ in range(n_running):
                assert next_byte(reading) == b"."
            yield program, reading
        finally:
            program.kill()
            os.close(reading)


def next_byte(pipe: int) -> bytes:
    """The next byte of a pipe; nothing at its end."""
    readable, _, _ = select.select([pipe], [], [], LONGEST_S)
    assert readable, "no byte and no end"
    return os.read(pipe, 1)


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGKILL, -9), (signal.SIGTERM, -15), (signal.SIGINT, 130)],
)
def test_no_worker_outlives_the_program_that_started_it(
    number: int, code: int, tmp_path: Path
) -> None:
    with held_jobs(tmp_path, 2) as (program, pipe):
        program.send_signal(number)
        assert next_byte(pipe) == b"", "the last worker has ended"
        _, err = program.communicate(timeout=LONGEST_S)
    assert program.returncode == code
    assert "Traceback" not in err


def test_a_worker_that_is_killed_is_an_error_that_says_how_far_it_came(
    tmp_path: Path,
) -> None:
    # it dies only when the first result is here: a pool that breaks gives none
    gate = tmp_path / "gate"
    os.mkfifo(gate)
    lethal = partial(dies_at_gate, gate)
    three: list[Job[Any]] = [partial(square, 1), lethal, partial(square, 2)]
    run = Workers(2).run(three)
    assert next(run)[0] == 1
    gate.write_bytes(b"")
    with pytest.raises(WorkersLost, match="the first 1 of 3 jobs were finished"):
        list(run)


def test_sets_scored_on_a_cluster_have_the_figures_of_this_process(
    run: Run, tmp_path: Path, cluster: str
) -> None:
    (tmp_path / "pulls.toml").write_text(card_text(row("pull"), rate_hz=50))
    for number in (1, 2):
        words = ("--trials", 2, "--seed", number, "--out", tmp_path / f"set{number}")
        assert run("simulate", tmp_path / "pulls.toml", *words)[0] == 0
    written = []
    for name, where in (("here", ()), ("there", ("--dask", cluster))):
        out = tmp_path / f"{name}.json"
        sets = (tmp_path / "set1", tmp_path / "set2")
        code, _, err = run(
            "evaluate",
            SLOWER,
            "--data",
            *sets,
            "--json",
            out,
            *where,
        )
        assert code == 0, err
        written.append(out.read_bytes())
    assert written[0] == written[1]
    assert len(json.loads(written[0])["sets"]) == 2
