"""Where independent jobs run: the same results in the same order, and none lost with a worker."""

from __future__ import annotations

import json
import os
import socket
import sys
from functools import partial
from pathlib import Path

import pytest
from command_line import Run
from distributed import LocalCluster
from loop_bench import card_text, row
from small_jobs import dies_once, square

from holdfast.core.errors import UsageError
from holdfast.evaluation.jobs import Workers


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


@pytest.mark.filterwarnings(
    "default"
)  # of a library that is here for these tests alone
def test_what_a_killed_worker_computed_is_computed_by_another(tmp_path: Path) -> None:
    jobs = [partial(dies_once, tmp_path / name) for name in ("one", "two", "three")]
    (tmp_path / "one").touch()
    (tmp_path / "three").touch()
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as local:
        assert list(Workers(dask=local.scheduler_address).run(jobs)) == [
            "one",
            "two",
            "three",
        ]
    assert (tmp_path / "two").exists()


def test_an_error_of_a_job_is_raised(cluster: str) -> None:
    with pytest.raises(ZeroDivisionError):
        list(Workers(dask=cluster).run([partial(divmod, 1, 0)]))


def test_an_address_without_a_scheduler_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    for address in (f"127.0.0.1:{port}", "nonsense"):
        with pytest.raises(UsageError, match="no scheduler answers") as refused:
            list(Workers(dask=address).run([partial(square, 1)]))
        assert "dask scheduler" in refused.value.next_step


def test_without_its_package_a_cluster_names_the_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match="needs the package") as refused:
        list(Workers(dask="127.0.0.1:1").run([partial(square, 1)]))
    assert "holdfast[dask]" in refused.value.next_step


def test_zero_processes_are_refused(run: Run) -> None:
    code, _, err = run("loop", "thesis", "--jobs", 0)
    assert code == 2
    assert "'0' is not a number of processes from 1 on" in err


def test_sets_scored_on_a_cluster_have_the_figures_of_this_process(
    run: Run, tmp_path: Path, cluster: str
) -> None:
    (tmp_path / "pulls.toml").write_text(card_text(row("pull")))
    for number in (1, 2):
        words = ("--trials", 2, "--seed", number, "--out", tmp_path / f"set{number}")
        assert run("simulate", tmp_path / "pulls.toml", *words)[0] == 0
    written = []
    for name, where in (("here", ()), ("there", ("--dask", cluster))):
        out = tmp_path / f"{name}.json"
        sets = (tmp_path / "set1", tmp_path / "set2")
        code, _, err = run(
            "evaluate",
            "models/holdfast-150hz.onnx",
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


def test_a_closed_loop_on_a_cluster_ends_as_in_this_process(
    run: Run, tmp_path: Path, cluster: str
) -> None:
    card, written = tmp_path / "two.toml", []
    card.write_text(
        card_text(row("fall", "weak_grip = 0.5\n", "hard-ball"), row("pass"))
    )
    for name, where in (("here", ("--jobs", 1)), ("there", ("--dask", cluster))):
        out = tmp_path / f"{name}.json"
        code, _, err = run(
            "loop", card, "--controller", "pd-shear", "--json", out, *where
        )
        assert code == 0, err
        written.append(out.read_bytes())
    assert written[0] == written[1]
