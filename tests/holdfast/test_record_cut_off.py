"""A recorder that is killed, a file that is cut, a disk that is full: at most the sample under way
is lost."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys

import pytest
from full_disk import full_disk
from grip_bench import until
from recorder_bench import (
    AREA,
    ROOT,
    columns_of,
    cup_pull,
    errors_in,
    meta_of,
    one_pull,
    recorded,
    start,
    states_in,
    wait_for,
)

from holdfast.cli.main import main
from holdfast.core.errors import OutputError
from holdfast.core.tactile_file import repair_table
from holdfast.core.trial_file import read_trial
from holdfast.drivers.replay import open_replay

KILLED = """
import os, signal, sys
from holdfast.drivers.hand import Hand
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.cli.command import Parser
from holdfast.cli.people import add_record_arguments
from holdfast.sessions.recorder.plan import RecordOptions
from holdfast.sessions.recorder.terminal import Keys
from holdfast.sessions.recorder.recording import record as record_trials
from holdfast.sessions.recorder.terminal import Display, RunContext
plain, reads = Hand.read, 0
def read(self):
    global reads
    reads += 1
    if reads > 100 + 77:  # a second of bias, then so many samples
        os.kill(os.getpid(), signal.SIGKILL)
    return plain(self)
Hand.read = read
parser = Parser(prog="holdfast record")
add_record_arguments(parser)
options = RecordOptions.of(parser.parse_args(sys.argv[1:]))
clock = VirtualClock(7_000_000_000)
display = Display(print)
context = RunContext(clock, Keys(None), display, lambda: False, host_ns=clock.now_ns)
record_trials(options, context)
"""


@pytest.mark.hard_case(
    AREA,
    "a recorder that is killed",
    elsewhere="what was buffered is gone, often the whole session",
    here="every sample is written by itself: at most the one under way is lost; repair "
    "and resume go on from there",
)
def test_kill_9_loses_at_most_the_sample_under_way_and_the_next_run_goes_on(
    tmp_path, capsys
):
    out = tmp_path / "out"
    words = [*map(str, cup_pull(out)), "--trials", "1", "--at-once", "--seconds", "600"]
    command = [sys.executable, "-c", KILLED, *words]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    folder = out / "p01/cup/pull/trial_1"
    assert done.returncode == -signal.SIGKILL, done.stderr
    sequence = [int(one) for one in columns_of(folder)["sequence"]]
    assert sequence == list(range(77)), (
        "a row for every reading, and none between them is lost"
    )
    assert meta_of(folder)["state"] == "recording"
    with (folder / "tactile.csv").open("a") as file:
        # and as if the kill had come in the middle of a write
        file.write("0.513,1.0,2.")
    assert main(["check", "--repair", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "12 bytes of an incomplete line removed, 77 samples complete" in printed
    assert (folder / "tactile.csv.torn").read_text() == "0.513,1.0,2."
    assert "marked as interrupted with 77 samples" in printed
    assert len(open_replay(folder).values) == 77
    assert main(["check", "--repair", str(out)]) == 0
    assert "complete" in capsys.readouterr().out
    again = "--object cup --action pull --trials 1 --seconds 1"
    recorded(out, *again.split())
    assert states_in(out) == ["interrupted", "kept"]


def test_a_kill_from_outside_leaves_whole_rows_in_their_order(tmp_path):
    words = cup_pull(tmp_path)
    with start(*words, "--at-once", "--trials", "1", "--seconds", "600") as run:
        wait_for(run, "recording p01")
        file = tmp_path / "p01/cup/pull/trial_1/tactile.csv"
        until(lambda: file.read_bytes().count(b"\n") >= 50)
        run.kill()
        run.communicate(timeout=300)
    whole = repair_table(file)
    sequence = [int(row) for row in columns_of(file.parent)["sequence"]]
    assert sequence == sorted(set(sequence))
    assert len(sequence) == whole.rows >= 49


@pytest.mark.hard_case(
    AREA,
    "a disk that is full in the middle of a trial",
    elsewhere="half a line at the end, which no reader takes, or the recorder continues without "
    "a message",
    here="one error; the rows before stay whole, the half line is taken back, the trial "
    "says interrupted or recording",
)
@pytest.mark.parametrize("limit", [40_000, 5_000])
def test_a_full_disk_is_one_error_and_what_was_recorded_is_whole(tmp_path, limit):
    words = cup_pull(tmp_path)
    one_of_20_s = "--at-once --trials 1 --seconds 20"
    run = start(
        *words,
        *one_of_20_s.split(),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    _, err = run.communicate(timeout=300)
    (error,) = errors_in(err)
    assert (run.returncode, "OutputError" in error) == (5, True)
    files = list(tmp_path.rglob("tactile.csv"))
    for file in files:
        assert file.read_bytes().endswith(b"\n")
    assert limit < 40_000 or len(read_trial(files[0]).t_s) > 50
    assert main(["check", "--repair", str(tmp_path)]) == 0, (
        "with room again, repair ends what the full disk left"
    )
    assert "recording" not in states_in(tmp_path)


ROOMS = (0, 90, 3_000, 3_400, 3_900, 30_000, -3_300, -400, -1)
"""Bytes; below 0: less than a whole trial needs."""


@pytest.fixture(scope="module")
def needed(tmp_path_factory: pytest.TempPathFactory) -> int:
    """Bytes that a trial writes."""
    with full_disk(1e9) as disk:
        one_pull(tmp_path_factory.mktemp("needed"))
    return disk.written


@pytest.mark.parametrize("room", ROOMS)
def test_wherever_the_disk_is_full_repair_ends_what_is_left_and_the_next_run_goes_on(
    tmp_path, needed, room, capsys
):
    with full_disk(room % needed), pytest.raises(OutputError, match="No space left"):
        one_pull(tmp_path)
    left = list(tmp_path.rglob("trial_*/meta.json"))
    code = 0 if left else 3
    assert main(["check", "--repair", str(tmp_path)]) == code
    assert set(states_in(tmp_path)) <= {"interrupted", "void"}
    for meta in left:
        table = meta.with_name("tactile.csv").read_bytes()
        assert table.count(b"\n") == len(table.splitlines())
    assert main(["check", "--repair", str(tmp_path)]) == code
    assert "marked" not in capsys.readouterr().out.splitlines()[-1:]
    assert any(line.startswith("kept: ") for line in one_pull(tmp_path))


def test_on_a_disk_that_is_still_full_repair_says_so_for_each_trial(
    tmp_path, needed, capsys
):
    for _ in range(2):
        with full_disk(needed // 2), pytest.raises(OutputError):
            one_pull(tmp_path)
    with full_disk(0):
        assert main(["check", "--repair", str(tmp_path)]) == 5
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert all("not repaired: " in line and "next: make room" in line for line in lines)
    assert main(["check", "--repair", str(tmp_path)]) == 0
