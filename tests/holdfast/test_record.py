"""The recorder: what is written survives whatever happens, nothing is invented, and training reads it as it is."""

from __future__ import annotations

import argparse
import csv
import fcntl
import json
import os
import pty
import re
import resource
import shutil
import signal
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.replay import open_replay
from drivers.virtual.clock import VirtualClock
from edge_runtime import tactile_file
from edge_runtime.command import Parser
from edge_runtime.errors import (
    CardError,
    DataError,
    DataNotFound,
    EmptyRecording,
    HoldfastError,
    LabelError,
    OutputError,
    TimeError,
    UnitError,
    UsageError,
)
from edge_runtime.live import Measured
from edge_runtime.tactile_file import TactileFile, mend
from edge_runtime.trial_file import read_trial
from holdfast import record
from holdfast.cli import main
from holdfast.recorder.card import ACTIONS, Task, left, read_protocol, word
from holdfast.recorder.folder import opened
from holdfast.recorder.keys import KEYS, Keys
from holdfast.recorder.recording import record as record_trials
from holdfast.recorder.session import Session, SessionOptions
from holdfast.sources import open_source
from holdfast.stopping import stop_signals
from simulation import protocol as simulated
from training.datasets import load, thesis

ROOT = Path(__file__).resolve().parents[2]
REST = "virtual://ft232h"
AREA = "What comes from outside"
SCENES = """
[record]
rate_hz = 50
[[trials]]
objects = ["soft-ball"]
action = "pull"
close_at_s = 0.8
hold_s = 1.2
tail_s = 0.8
count = 2
[[trials]]
objects = ["soft-ball", "hard-ball"]
action = "pass"
close_at_s = 0.8
hold_s = 1.2
tail_s = 0.8
count = 2
[[trials]]
objects = ["hard-ball"]
action = "fall"
close_at_s = 0.8
hold_s = 1.2
tail_s = 0.8
count = 2
[effects.brush]
count = 3
[effects.dipole]
[effects.hall_noise]
"""
OF_TRIAL = [("soft-ball", "pull"), ("soft-ball", "pass"), ("hard-ball", "pass"), ("hard-ball", "fall")] * 2
"""What the trials of that card are."""
PROTOCOL = """
title = "Two objects"
[[trials]]
objects = ["soft-ball", "my-cup"]
action = "pull"
style = "author"
count = 3
[[trials]]
action = "nothing"
count = 2
[objects.my-cup]
mass_g = 212
"""


def never() -> bool:
    return False


def told(*words: object) -> argparse.Namespace:
    parser = Parser(prog="holdfast record")
    record.add_arguments(parser)
    return parser.parse_args([str(one) for one in words])


def recorded(out: Path, *words: object, source: object = REST, person: str = "p01") -> list[str]:
    """One run of the verb on a clock that costs nothing, without a key; what it said."""
    said: list[str] = []
    args = told("--source", source, "--out", out, "--person", person, "--at-once", *words)
    record_trials(args, VirtualClock(7_000_000_000), Keys(None), said.append, never)
    return said


def one_pull(out: Path, *words: object, **where: Any) -> list[str]:
    pull = ("--object", "soft-ball", "--action", "pull", "--trials", "1", "--seconds", "1")
    return recorded(out, *pull, *words, **where)


def meta_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "meta.json").read_text("utf-8")))


def columns_of(folder: Path) -> dict[str, list[str]]:
    with (folder / "tactile.csv").open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    return {name: [row[name] for row in rows] for name in rows[0]}


class Hand:
    """A source of a plain signal: row k after what shifts[k] adds to its stamp, and at row k says[k] happens."""

    unit, n_channels, rate_hz = "N", 18, None

    def __init__(
        self, clock: VirtualClock, n: int, *, stalls: Mapping[int, float] | None = None,
        shifts: Mapping[int, float] | None = None, says: Mapping[int, Callable[[], object]] | None = None,
    ) -> None:  # fmt: skip
        self.clock, self.n, self.k = clock, n, 0
        self.stalls, self.shifts, self.says = stalls or {}, shifts or {}, says or {}
        self.offset_ns = 0

    def read(self) -> Measured | None:
        if self.k == self.n:
            return None
        self.says.get(self.k, never)()
        self.offset_ns += round(1e9 * self.shifts.get(self.k, 0.0))
        t_ns = self.clock.now_ns() + self.offset_ns
        self.clock.spend(round(1e9 * self.stalls.get(self.k, 0.0)))
        values = 0.001 * np.arange(18.0) + (2.0 if 40 <= self.k < 80 else 0.0)
        self.k += 1
        return Measured(t_ns, values, np.ones(6, dtype=np.bool_), ("",) * 6)

    def close(self) -> None:
        pass


def session(
    out: Path, source: Any, keys: Keys, tasks: list[Task], *, at_once: bool = True, seconds: float | None = None,
    stopped: Callable[[], bool] = never, said: list[str] | None = None,
) -> tuple[int, list[str]]:  # fmt: skip
    said = [] if said is None else said
    made = Session(
        SessionOptions(out, "p01", 100.0, seconds, at_once, {}), source, source.clock, keys, said.append,
        bias=np.zeros(18), about={"unit": "N"},
    )  # fmt: skip
    return made.run(tasks, stopped), said


PULL = Task("soft-ball", "pull")


@pytest.fixture
def pressing() -> Iterator[tuple[Keys, Callable[[str], None]]]:
    """Keys that are read from a pipe, and what presses them."""
    reading, writing = os.pipe()
    yield Keys(reading), lambda text: void(os.write(writing, text.encode()))
    os.close(reading)
    os.close(writing)


def void(_: object) -> None:
    return None


# -- what is written


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("card") / "short.toml"
    path.write_text(SCENES, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def people(card: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people, four trials each, of a scene. Read only."""
    out = tmp_path_factory.mktemp("recorded") / "trials"
    for number, (thing, action) in enumerate(OF_TRIAL):
        words = ("--object", thing, "--action", action, "--trials", "1")
        recorded(out, *words, source=f"sim://{card}?trial={number}", person=f"p0{1 + number // 4}")
    return out


def test_what_the_source_gave_is_on_the_disk_to_the_last_digit_and_in_order(people, card):
    folder = people / "p01/soft-ball/pull/trial_1"
    source, again = open_source(f"sim://{card}?trial=0"), open_replay(folder)
    assert again.values.tobytes() == source.values.tobytes()
    assert again.rate_hz == pytest.approx(50.0, rel=1e-6)
    columns = columns_of(folder)
    head = ["Time", *(f"{axis}{k}" for k in range(1, 7) for axis in "XYZ"), "host_ns", "sequence"]
    assert list(columns) == [*head, *(f"valid{k}" for k in range(1, 7))]
    assert columns["sequence"] == [str(k) for k in range(len(source.values))]
    host_s = 1e-9 * np.array(columns["host_ns"], dtype=np.int64)
    np.testing.assert_allclose(host_s - host_s[0], np.array(columns["Time"], dtype=np.float64), atol=1e-9)


def test_meta_tells_who_what_how_and_how_good(tmp_path):
    one_pull(tmp_path / "out")
    meta = meta_of(tmp_path / "out/p01/soft-ball/pull/trial_1")
    assert (meta["state"], meta["person"], meta["object"], meta["action"]) == ("kept", "p01", "soft-ball", "pull")
    assert [one["finger"] for one in meta["hand"]["sensors"]] == [1, 2, 3, 4, 5, 6]
    assert meta["hand"]["averages"] == 32
    assert len(meta["bias"]["values"]) == len(meta["bias"]["spread"]) == 18
    assert meta["bias"]["good"] is True
    assert set(meta["versions"]) >= {"holdfast", "numpy", "python"}
    assert meta["configuration"]["source"] == REST
    assert meta["quality"]["samples"] == 150
    assert (meta["quality"]["lost"], meta["quality"]["invalid_readings"]) == (0, 0)
    assert meta["quality"]["rate_hz"] == pytest.approx(150.0, rel=1e-3)
    assert meta["quality"]["bias_drift"] < 0.2


def test_nothing_that_is_written_names_a_place_of_the_machine(people, card, tmp_path):
    (tmp_path / "of-anna.toml").write_text(PROTOCOL)
    recorded(tmp_path / "out", "--protocol", tmp_path / "of-anna.toml", "--trials", "1", "--seconds", "1")
    texts = [path.read_text("utf-8") for root in (people, tmp_path) for path in root.rglob("meta.json")]
    assert len(texts) > 8
    for text in texts:
        assert str(card.parent) not in text
        assert str(tmp_path) not in text
        assert os.uname().nodename not in re.findall(r'"(?:\\.|[^"])*"', text)


def test_host_stamps_are_of_the_clock_a_camera_has(tmp_path):
    import time

    before_ns = time.monotonic_ns()
    one_pull(tmp_path / "out")
    host_ns = int(columns_of(tmp_path / "out/p01/soft-ball/pull/trial_1")["host_ns"][0])
    assert before_ns < host_ns < time.monotonic_ns() + 1_000_000_000


def test_the_disk_is_told_once_a_second_of_samples(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(tactile_file.os, "fsync", synced.append)
    file = TactileFile(tmp_path / "t.csv", 3)
    for k in range(401):
        file.write(10_000_000 * k, 0, k, np.zeros(3), np.ones(1, dtype=np.bool_))
    file.close()
    assert len(synced) == 4 + 1


def test_samples_that_never_came_are_gaps_in_the_count_and_invalid_rows_to_who_reads(tmp_path):
    clock = VirtualClock()
    kept, said = session(tmp_path, Hand(clock, 100, stalls={20: 0.2}), Keys(None), [PULL])
    folder = tmp_path / "p01/soft-ball/pull/trial_1"
    sequence = np.array(columns_of(folder)["sequence"], dtype=np.int64)
    assert (kept, meta_of(folder)["quality"]["lost"]) == (1, 19)
    assert np.diff(sequence)[20] == 20
    trial = read_trial(folder / "tactile.csv")
    assert np.flatnonzero(~trial.valid.all(axis=1)).tolist() == list(range(21, 40))
    assert np.isnan(trial.raw[21:40]).all()
    assert any("19 lost" in line for line in said)


def test_a_reading_that_comes_twice_is_lost_and_no_row_is_made_up(tmp_path):
    clock = VirtualClock()
    session(tmp_path, Hand(clock, 99, shifts={30: -0.01, 31: 0.01}), Keys(None), [PULL])
    folder = tmp_path / "p01/soft-ball/pull/trial_1"
    assert "30" not in columns_of(folder)["sequence"]
    assert meta_of(folder)["quality"]["lost"] == 1


def test_a_finger_that_is_lost_is_written_as_lost_and_the_rest_goes_on(tmp_path):
    said = one_pull(tmp_path / "out", source=f"{REST}?fault=nack:3@1.6%2B0.3")
    folder = tmp_path / "out/p01/soft-ball/pull/trial_1"
    columns = columns_of(folder)
    lost = np.array(columns["valid3"]) == "0"
    assert 20 < lost.sum() < 80
    assert np.array(columns["X3"])[lost].tolist().count("nan") > 20
    assert "0" not in columns["valid2"]
    assert sum(meta_of(folder)["quality"]["why"].values()) == lost.sum()
    assert any("invalid" in line for line in said)


def test_a_saturated_finger_and_a_drifted_bias_are_told(tmp_path):
    clock = VirtualClock()
    hand = Hand(clock, 60)
    plain = hand.read

    def read() -> Measured | None:
        measured = plain()
        return measured and Measured(measured.t_ns, measured.values + 0.5, measured.valid, ("saturated", *[""] * 5))

    hand.read = read
    session(tmp_path, hand, Keys(None), [PULL], seconds=0.6)
    quality = meta_of(tmp_path / "p01/soft-ball/pull/trial_1")["quality"]
    assert quality["saturated_readings"] == 60
    assert (quality["bias_drift"], quality["bias_drift_channel"]) == (pytest.approx(0.517), "Z6")


# -- clocks that jump


@pytest.mark.hard_case(
    "Time and schedule", "a clock that is set while a trial is recorded",
    elsewhere="stamps run backwards or leap in the file, and nobody knows which rows are neighbours",
    here="the trial ends with a typed error, what came before is kept as interrupted",
)  # fmt: skip
@pytest.mark.parametrize("by_s", [-5.0, 5.0])
def test_a_clock_that_jumps_ends_the_trial_and_keeps_what_came_before(tmp_path, by_s):
    clock = VirtualClock(10_000_000_000)
    with pytest.raises(TimeError, match=r"jumped by [+-]"):
        session(tmp_path, Hand(clock, 100, shifts={50: by_s}), Keys(None), [PULL])
    folder = tmp_path / "p01/soft-ball/pull/trial_1"
    assert meta_of(folder)["state"] == "interrupted"
    assert len(read_trial(folder / "tactile.csv").t_s) == 50
    assert not (folder / "tactile.truth.json").exists()


def test_a_trial_that_lost_most_of_its_samples_is_not_kept(tmp_path):
    clock = VirtualClock()
    source = Hand(clock, 30, stalls=dict.fromkeys(range(30), 0.095))
    with pytest.raises(EmptyRecording, match="cannot be kept"):
        session(tmp_path, source, Keys(None), [PULL])
    assert meta_of(tmp_path / "p01/soft-ball/pull/trial_1")["state"] == "interrupted"


# -- keys


def test_marks_become_phases_with_their_provenance(tmp_path, pressing):
    keys, press = pressing
    hand = Hand(VirtualClock(), 120, says={60: lambda: press("l"), 90: lambda: press("e"), 110: lambda: press("k")})
    kept, said = session(tmp_path, hand, keys, [PULL])
    folder = tmp_path / "p01/soft-ball/pull/trial_1"
    truth = json.loads((folder / "tactile.truth.json").read_text())
    phases = [(one["label"], one["provenance"]) for one in truth["phases"]]
    assert kept == 1
    assert phases == [("nothing", "rule"), ("grasp", "rule"), ("risky_slip", "key"), ("nothing", "key")]
    assert truth["contact_s"] == pytest.approx(0.40, abs=0.06)
    assert (truth["load_onset_s"], truth["contact_lost_s"]) == (pytest.approx(0.60), pytest.approx(0.90))
    assert any("load onset at 0.600 s" in line for line in said)
    marks = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    assert [(one["mark"], one["provenance"]) for one in marks] == [("load_onset", "key"), ("contact_lost", "key")]


def test_without_a_mark_nobody_guesses_when_the_load_came_on(tmp_path):
    session(tmp_path, Hand(VirtualClock(), 120), Keys(None), [PULL])
    truth = json.loads((tmp_path / "p01/soft-ball/pull/trial_1/tactile.truth.json").read_text())
    assert [one["label"] for one in truth["phases"]] == ["nothing", "nothing"]
    assert truth["load_onset_s"] is None
    (recording,) = load(tmp_path, windows="natural").recordings
    assert [phase.situation for phase in recording.phases] == [0, 0]
    assert recording.events == ()


def test_a_trial_of_which_nobody_knows_anything_is_read_and_has_no_label(tmp_path):
    session(tmp_path, Hand(VirtualClock(), 60), Keys(None), [PULL], seconds=0.35)
    data = load(tmp_path, windows="natural")
    assert data.recordings[0].phases == ()
    assert len(data.tasks["classes"]) == 0


@pytest.mark.parametrize(("action", "label"), [("hold", "grasp"), ("pass", "safe_slip"), ("fall", "risky_slip")])
def test_what_an_action_makes_of_the_grip_is_its_label(tmp_path, pressing, action, label):
    keys, press = pressing
    session(tmp_path, Hand(VirtualClock(), 120, says={60: lambda: press("l")}), keys, [Task("soft-ball", action)])
    truth = json.loads((tmp_path / f"p01/soft-ball/{action}/trial_1/tactile.truth.json").read_text())
    assert truth["phases"][-2]["label"] == label


def test_the_empty_hand_is_nothing_from_end_to_end(tmp_path):
    session(tmp_path, Hand(VirtualClock(), 40), Keys(None), [Task("nothing", "nothing")])
    truth = json.loads((tmp_path / "p01/nothing/trial_1/tactile.truth.json").read_text())
    assert [(one["label"], one["t0_s"], one["t1_s"]) for one in truth["phases"]] == [("nothing", 0.0, 0.4)]


def test_redo_moves_the_trial_away_and_the_same_comes_up_again(tmp_path, pressing):
    keys, press = pressing
    hand = Hand(VirtualClock(), 400, says={100: lambda: press("r"), 200: lambda: press("k"), 300: lambda: press("q")})
    kept, _ = session(tmp_path, hand, keys, [PULL, Task("my-cup", "pass")])
    states = {str(p.parent.relative_to(tmp_path)): meta_of(p.parent)["state"] for p in tmp_path.rglob("tactile.csv")}
    assert kept == 2
    assert states == {
        "p01/discarded/soft-ball/pull/trial_1-1": "redone", "p01/soft-ball/pull/trial_1": "kept",
        "p01/my-cup/pass/trial_1": "kept",
    }  # fmt: skip


def test_after_its_figures_a_kept_trial_can_still_be_done_again(tmp_path, pressing):
    keys, press = pressing
    hand = Hand(VirtualClock(), 400, says={50: lambda: press("krr q"), 100: lambda: press("k")})
    press(" ")
    kept, said = session(tmp_path, hand, keys, [PULL, Task("my-cup", "pass")], at_once=False)
    assert kept == 0, "space, k; r does it again; the second r finds none; space, q keeps and stops"
    assert any("no trial of this session to do again" in line for line in said)


def test_stop_between_trials_stops_and_so_does_an_operator_who_is_gone(tmp_path, pressing):
    keys, press = pressing
    press("q")
    assert session(tmp_path, Hand(VirtualClock(), 10), keys, [PULL], at_once=False)[0] == 0
    kept, said = session(tmp_path, Hand(VirtualClock(), 10), Keys(None), [PULL], at_once=False)
    assert kept == 0
    assert any("--at-once" in line for line in said)
    assert not (tmp_path / "p01").exists()


def start(*words: object, stdin: Any = subprocess.DEVNULL, **told: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "holdfast", "record", *map(str, words)]
    return subprocess.Popen(
        command, cwd=ROOT, stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **told
    )


def heard(run: subprocess.Popen[str], word_: str) -> str:
    assert run.stderr is not None
    return next(line for line in run.stderr if word_ in line)


def terminal_of_its_own() -> None:
    """Make stdin the terminal of a new session, as a login does."""
    os.setsid()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


@pytest.mark.parametrize("way", ["keys", "SIGTERM", "SIGHUP", "error"])
def test_a_terminal_is_as_before_on_every_way_out(tmp_path, way):
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    words = ["--source", REST, "--out", tmp_path / "out", "--person", "p01", "--object", "cup", "--action", "pull"]
    fault = f"{REST}?fault=nack:2@0%2B99"
    words[1] = fault if way == "error" else REST

    with start(*words, stdin=slave, preexec_fn=terminal_of_its_own) as run:
        if way != "error":
            heard(run, "next: cup, pull")
            assert not termios.tcgetattr(slave)[3] & termios.ICANON
            os.write(master, b" ")
            heard(run, "recording p01")
        if way == "keys":
            os.write(master, b"l")
            heard(run, "load onset at")
            os.write(master, b"k")
            heard(run, "kept")
            os.write(master, b"q")
        if way in ("SIGTERM", "SIGHUP"):
            run.send_signal(signal.Signals[way])
        run.communicate(timeout=60)
    assert run.returncode == (3 if way == "error" else 0)
    assert termios.tcgetattr(slave) == before
    states = [meta_of(path.parent)["state"] for path in (tmp_path / "out").rglob("tactile.csv")]
    assert states == {"keys": ["kept"], "SIGTERM": ["interrupted"], "SIGHUP": ["interrupted"], "error": []}[way]
    os.close(master)
    os.close(slave)


def told_on(master: int, word_: str) -> None:
    """Read a terminal's screen until a word is on it."""
    screen = b""
    while word_.encode() not in screen:
        screen += os.read(master, 4096)


@pytest.mark.hard_case(
    AREA, "an SSH connection that drops while a trial is recorded",
    elsewhere="the recorder dies with the terminal, and its trial says for ever that it is being recorded",
    here="the trial ends as by SIGTERM: whole, interrupted, and it comes up again",
)  # fmt: skip
def test_a_terminal_that_goes_away_ends_the_trial_as_sigterm_does(tmp_path):
    master, slave = pty.openpty()
    words = ["--source", REST, "--out", tmp_path / "out", "--person", "p01", "--object", "cup", "--action", "pull"]
    command = [sys.executable, "-m", "holdfast", "record", *map(str, words)]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=slave, stdout=slave, stderr=slave, preexec_fn=terminal_of_its_own
    ) as run:
        os.close(slave)
        told_on(master, "next: cup, pull")
        os.write(master, b" ")
        told_on(master, "recording p01")
        folder = tmp_path / "out/p01/cup/pull/trial_1"
        while (folder / "tactile.csv").read_bytes().count(b"\n") < 20:
            os.sched_yield()
        os.close(master)
        assert run.wait(timeout=60) == 0
    meta = meta_of(folder)
    assert meta["state"] == "interrupted"
    assert "why" not in meta, "no error ended it"
    assert meta["quality"]["samples"] == len(read_trial(folder / "tactile.csv").t_s) >= 19
    assert [path.name for path in folder.parent.iterdir()] == ["trial_1"]


@pytest.fixture
def hangup_as_before() -> Iterator[None]:
    before = signal.getsignal(signal.SIGHUP)
    yield
    signal.signal(signal.SIGHUP, before)


def test_a_hangup_may_come_twice_and_none_counts_under_nohup(hangup_as_before):
    with stop_signals() as stopped:
        assert not stopped()
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
        assert stopped()
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with stop_signals() as stopped:
        signal.raise_signal(signal.SIGHUP)
        assert not stopped()
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN


# -- kill, power cut, full disk


KILLED = """
import os, signal, sys
from drivers.live_hand import LiveHand
from holdfast.cli import main
plain, reads = LiveHand.read, 0
def read(self):
    global reads
    reads += 1
    if reads > 100 + 77:  # a second of bias, then so many samples
        os.kill(os.getpid(), signal.SIGKILL)
    return plain(self)
LiveHand.read = read
main(sys.argv[1:])
"""


@pytest.mark.hard_case(
    AREA, "a recorder that is killed",
    elsewhere="what was buffered is gone, often the whole session",
    here="every sample is written by itself: at most the one under way is lost; repair and resume go on from there",
)  # fmt: skip
def test_kill_9_loses_at_most_the_sample_under_way_and_the_next_run_goes_on(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["--source", REST, "--out", str(out), "--person", "p01", "--object", "cup", "--action", "nothing"][:-4]
    words += ["--object", "cup", "--action", "pull", "--trials", "1", "--at-once"]
    done = subprocess.run(
        [sys.executable, "-c", KILLED, "record", *words], cwd=ROOT, capture_output=True, text=True, check=False,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip
    folder = out / "p01/cup/pull/trial_1"
    assert done.returncode == -signal.SIGKILL, done.stderr
    sequence = [int(one) for one in columns_of(folder)["sequence"]]
    assert len(sequence) == 77, "a row for every reading; a machine that stands still leaves gaps between them"
    assert sequence == sorted(set(sequence))
    assert meta_of(folder)["state"] == "recording"
    with (folder / "tactile.csv").open("a") as file:
        file.write("0.513,1.0,2.")  # and as if the kill had come in the middle of a write
    assert main(["repair", str(out)]) == 0
    said = capsys.readouterr().out
    assert "12 bytes of a torn line taken away, 77 samples whole" in said
    assert (folder / "tactile.csv.torn").read_text() == "0.513,1.0,2."
    assert "marked as interrupted with 77 samples" in said
    assert len(open_replay(folder).values) == sequence[-1] + 1
    assert main(["repair", str(out)]) == 0
    assert "whole" in capsys.readouterr().out
    recorded(out, "--object", "cup", "--action", "pull", "--trials", "1", "--seconds", "1")
    assert [meta_of(folder.with_name(f"trial_{k}"))["state"] for k in (1, 2)] == ["interrupted", "kept"]


def test_a_kill_from_outside_leaves_whole_rows_in_their_order(tmp_path):
    words = ("--source", REST, "--out", tmp_path, "--person", "p01", "--object", "cup", "--action", "pull")
    with start(*words, "--at-once", "--trials", "1") as run:
        heard(run, "recording p01")
        file = tmp_path / "p01/cup/pull/trial_1/tactile.csv"
        while file.read_bytes().count(b"\n") < 50:
            os.sched_yield()
        run.kill()
        run.communicate(timeout=60)
    whole = mend(file)
    sequence = [int(row) for row in columns_of(file.parent)["sequence"]]
    assert sequence == sorted(set(sequence))
    assert len(sequence) == whole.rows >= 49


@pytest.fixture(scope="module")
def whole_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "tactile.csv"
    file = TactileFile(path, 6)
    for k in range(6):
        file.write(10_000_000 * k, 7, k, np.random.default_rng(k).normal(size=6), np.array([True, k % 2 == 0]))
    file.close()
    return path.read_bytes()


@given(data=st.data(), zeros=st.integers(0, 3))
def test_wherever_a_file_is_cut_mending_loses_at_most_one_sample(whole_file, tmp_path_factory, data, zeros):
    head = whole_file.index(b"\n") + 1
    cut = data.draw(st.integers(head, len(whole_file)))
    path = tmp_path_factory.mktemp("cut") / "tactile.csv"
    path.write_bytes(whole_file[:cut] + bytes(zeros))
    mended = mend(path)
    assert path.read_bytes() == whole_file[: len(path.read_bytes())]
    without_newline = whole_file[cut : cut + 1] == b"\n"
    assert whole_file[:cut].count(b"\n") - 1 + without_newline == mended.rows
    assert mended.cut_bytes == cut + zeros - len(path.read_bytes())


def test_where_there_is_no_trial_nothing_can_be_mended(tmp_path, capsys):
    assert main(["repair", str(tmp_path)]) == 3
    assert main(["repair", str(tmp_path / "nowhere")]) == 3
    assert "no trial in it" in capsys.readouterr().err


@pytest.mark.hard_case(
    AREA, "a disk that is full in the middle of a trial",
    elsewhere="half a line at the end, which no reader takes, or the recorder goes on without a word",
    here="one error; the rows before stay whole, the half line is taken back, the trial says interrupted or recording",
)  # fmt: skip
@pytest.mark.parametrize("limit", [40_000, 5_000])
def test_a_full_disk_is_one_error_and_what_was_recorded_is_whole(tmp_path, limit):
    words = ("--source", REST, "--out", tmp_path, "--person", "p01", "--object", "cup", "--action", "pull")
    run = start(
        *words, "--at-once", "--trials", "1", "--seconds", "20",
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )  # fmt: skip
    _, err = run.communicate(timeout=60)
    errors = [line for line in err.splitlines() if line.startswith("error: ")]
    assert (run.returncode, len(errors)) == (5, 1), err
    assert "OutputError" in errors[0]
    files = list(tmp_path.rglob("tactile.csv"))
    for file in files:
        assert file.read_bytes().endswith(b"\n")
    assert limit < 40_000 or len(read_trial(files[0]).t_s) > 50
    assert main(["repair", str(tmp_path)]) == 0, "with room again, repair ends what the full disk left"
    assert "recording" not in [meta_of(file.parent)["state"] for file in files]


# -- who, where, and what next


NAMES = ["Anna Müller", "a@b.org", "", "p_01", "../p01", "nothing", "discarded", "p-", "x" * 25]


@pytest.mark.parametrize("name", NAMES)
def test_a_pseudonym_is_a_short_word_and_nothing_else(tmp_path, name):
    with pytest.raises(UsageError, match="pseudonym"):
        one_pull(tmp_path / "out", person=name)
    assert not (tmp_path / "out").exists()


def test_withdrawing_a_person_is_deleting_one_folder(people, tmp_path):
    copy = shutil.copytree(people, tmp_path / "trials")
    assert load(copy, windows="natural").groups() == ["p01", "p02"]
    shutil.rmtree(copy / "p01")
    left_over = load(copy, windows="natural")
    assert {recording.trial_id.split("/")[0] for recording in left_over.recordings} == {"p02"}
    assert not [path for path in copy.rglob("*") if path.is_file() and "p01" in path.read_text("utf-8")]


def test_a_folder_that_is_no_recording_is_left_alone(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/summer.txt").write_text("sun")
    with pytest.raises(OutputError, match="no folder of recordings"):
        one_pull(tmp_path / "photos")
    assert [path.name for path in (tmp_path / "photos").rglob("*")] == ["summer.txt"]
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="no folder of recordings"):
        one_pull(tmp_path / "file")


def test_a_person_is_never_recorded_into_a_second_folder_within_the_recordings(tmp_path):
    one_pull(tmp_path / "out")
    for within in ("out/p02", "out/p01/soft-ball", "out/p01/new/newer"):
        with pytest.raises(OutputError, match=r"within a folder of recordings.*--out"):
            one_pull(tmp_path / within)
    assert [path.parent.name for path in tmp_path.rglob("tactile.csv")] == ["trial_1"]
    one_pull(tmp_path / "out2")


def test_an_object_that_nobody_weighed_is_told_while_it_is_at_hand(tmp_path):
    words = ("--object", "cup", "--action", "pull", "--trials", "1", "--seconds", "1")
    said = recorded(tmp_path / "out", *words)
    assert [line for line in said if "nobody knows how heavy 'cup' is" in line and "cup/meta.json" in line]
    (tmp_path / "out/p01/cup/meta.json").write_text('{"mass_g": 80}')
    for told_ in (recorded(tmp_path / "out", *words), one_pull(tmp_path / "out")):
        assert not any("heavy" in line for line in told_)
    (tmp_path / "two.toml").write_text(PROTOCOL)
    said = recorded(tmp_path / "out", "--protocol", tmp_path / "two.toml", "--seconds", "0.5", "--trials", "1")
    assert not any("heavy" in line for line in said)


def test_two_recorders_do_not_share_a_folder(tmp_path):
    one_pull(tmp_path / "out")
    with opened(tmp_path / "out", "N", "simulated"):
        with pytest.raises(OutputError, match="another recorder"):
            one_pull(tmp_path / "out")
        assert main(["repair", str(tmp_path / "out/p01")]) == 5, "nobody mends what is being written"
    assert main(["repair", str(tmp_path / "out/p01")]) == 0


def test_units_and_what_is_simulated_are_not_mixed_in_a_folder(tmp_path):
    one_pull(tmp_path / "out")
    for unit, kind, error in (("uT", "simulated", UnitError), ("N", "recorded", UsageError)):
        with pytest.raises(error), opened(tmp_path / "out", unit, kind):
            pass


def test_a_bad_bias_is_refused_unless_told(tmp_path):
    touched = f"{REST}?fault=nack:2@0%2B99"
    with pytest.raises(DataError, match=r"X2|rows"):
        one_pull(tmp_path / "out", source=touched)
    assert not list((tmp_path / "out").rglob("tactile.csv"))
    late = f"{REST}?fault=nack:2@0.4%2B0.3"
    with pytest.raises(DataError, match="not a good bias"):
        one_pull(tmp_path / "out", source=late)
    said = one_pull(tmp_path / "out", "--anyway", source=late)
    assert any("lost in X2" in line for line in said)
    assert meta_of(tmp_path / "out/p01/soft-ball/pull/trial_1")["bias"]["good"] is False


def test_a_card_says_what_comes_next_and_each_person_has_an_order_of_their_own(tmp_path):
    (tmp_path / "two.toml").write_text(PROTOCOL)
    protocol = read_protocol(tmp_path / "two.toml")
    first, again, other = (protocol.ordered(1, person) for person in ("p01", "p01", "p02"))
    assert first == again != other
    key = lambda task: (task.thing, task.action)  # noqa: E731
    assert sorted(first, key=key) == sorted(other, key=key) == sorted(protocol.tasks, key=key)
    assert len(first) == 8
    assert protocol.ordered(2, "p01") != first
    assert left(first, first[:3]) == first[3:]


def test_a_run_goes_on_where_the_last_one_stopped(tmp_path):
    (tmp_path / "two.toml").write_text(PROTOCOL)
    words = ("--protocol", tmp_path / "two.toml", "--seconds", "0.5")
    recorded(tmp_path / "out", *words, "--trials", "3")
    said = recorded(tmp_path / "out", *words)
    assert any("3 of these trials are there already" in line for line in said)
    assert len(list((tmp_path / "out").rglob("tactile.csv"))) == 8
    assert recorded(tmp_path / "out", *words)[-1] == "leave the hand alone for 1 s: its bias is taken"
    plan = read_protocol(tmp_path / "two.toml").ordered(0, "p01")
    by_start = sorted((tmp_path / "out").rglob("trial_*/meta.json"), key=lambda path: path.stat().st_mtime_ns)
    done = [Task(*(meta_of(path.parent)[name] for name in ("object", "action", "style"))) for path in by_start]
    assert done == plan
    assert json.loads((tmp_path / "out/p01/my-cup/meta.json").read_text()) == {"mass_g": 212}


def test_actions_are_those_of_scenes_and_of_training():
    assert set(ACTIONS) == set(simulated.ACTIONS)
    assert set(ACTIONS) - {"nothing"} <= set(thesis.FOLDERS)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[[trials", "no TOML"),
        ("", "trials = None"),
        ("trials = 3", "trials = 3"),
        ("[[trials]]\naction = 'fly'\nobjects = ['a']", "action = 'fly'"),
        ("[[trials]]\naction = 'pull'", "objects = []"),
        ("[[trials]]\naction = 'nothing'\nobjects = ['a']", "objects = ['a']"),
        ("[[trials]]\naction = 'pull'\nobjects = ['../a']", "'../a'"),
        ("[[trials]]\naction = 'pull'\nobjects = ['a']\ncount = 0", "count = 0"),
        ("[[trials]]\naction = 'pull'\nobjects = ['a']\ncount = true", "count = True"),
        ("[[trials]]\naction = 'pull'\nobjects = ['a']\ncolour = 1", "'colour' is not known"),
        ("[[trials]]\naction = 'pull'\nobjects = ['a']\n[objects.a]\nmass_g = nan", "mass_g = nan"),
        ("[[trials]]\naction = 'pull'\nobjects = ['a']\n[objects]\na = 3", "objects.a = 3"),
        ("x = " + "[" * 5000, "no TOML"),
    ],
)
def test_a_card_that_cannot_be_is_refused_by_its_key(tmp_path, text, says):
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(CardError, match=re.escape(says)):
        read_protocol(tmp_path / "bad.toml")
    with pytest.raises(DataNotFound):
        read_protocol(tmp_path / "absent.toml")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "what is to be recorded"),
        (("--object", "cup"), "go together"),
        (("--action", "pull"), "go together"),
        (("--object", "cup", "--action", "nothing"), "go together"),
        (("--object", "a b", "--action", "pull", "--trials", "1"), "object 'a b'"),
        (("--object", "cup", "--action", "pull"), "without an end"),
        (("--object", "cup", "--action", "pull", "--trials", "0"), "--trials 0"),
        (("--object", "cup", "--action", "pull", "--trials", "1", "--camera", "oak"), "--tag-mm"),
        (("--object", "cup", "--action", "pull", "--trials", "1", "--camera", "scene"), "films no"),
        (("--object", "cup", "--action", "pull", "--trials", "1", "--camera", "gone.npz"), "no such file"),
    ],
)
def test_words_that_do_not_go_together_are_usage_errors(tmp_path, words, says):
    with pytest.raises(UsageError, match=says):
        recorded(tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


# -- what training makes of it


def test_people_are_groups_and_a_single_one_s_trials_are(people):
    both, one = load(people), load(people / "p01", windows="natural")
    assert both.groups() == ["p01", "p02"]
    assert (both.kind, both.unit, both.rate_hz) == ("simulated", "N", 50.0)
    assert len(one.groups()) == 4
    assert "say nothing about others" in one.caveat
    assert (both.notes["states"], both.notes["people"]) == ({"kept": 8}, 2)


def test_the_truth_of_a_scene_is_the_trial_s_and_only_kept_trials_are_read(people, tmp_path):
    data = load(people, windows="natural")
    pull = next(one for one in data.recordings if one.action == "pull")
    assert (pull.object_name, [phase.situation for phase in pull.phases]) == ("soft-ball", [0, 1, 3, 0])
    assert pull.events[0].gross_s is not None
    copy = shutil.copytree(people, tmp_path / "trials")
    meta = next(copy.glob("p01/soft-ball/pull/trial_1/meta.json"))
    meta.write_text(json.dumps(meta_of(meta.parent) | {"state": "interrupted"}))
    shutil.move(copy / "p02/hard-ball/fall/trial_1", copy / "p02/discarded/hard-ball/fall/trial_1-1")
    (copy / "p02/discarded/hard-ball/fall/trial_1-1/meta.json").write_text('{"recorder": 1, "state": "redone"}')
    again = load(copy, windows="natural")
    assert len(again.recordings) == 6
    assert again.notes["states"] == {"interrupted": 1, "kept": 6, "redone": 1}


@pytest.mark.filterwarnings("ignore::export.spec.BandsLeftOut")
def test_what_was_recorded_trains_evaluates_and_replays_as_it_is(people, tmp_path, capsys):
    from export.exporting import export_artifact
    from training.fitting import train
    from training.plan import ForestPlan, TrainingPlan

    few = ForestPlan(n_estimators=4)
    train(load(people), tmp_path / "model", TrainingPlan(situation=few, prediction=few, folds=2))
    model = str(export_artifact(tmp_path / "model")[0])
    assert main(["evaluate", model, "--data", str(people), "--json", str(tmp_path / "figures.json")]) == 0
    assert json.loads((tmp_path / "figures.json").read_text())["n_groups"] == 2
    capsys.readouterr()
    folder = people / "p01/soft-ball/pull/trial_1"
    for source in (str(folder), str(folder / "tactile.csv"), f"{people}#0"):
        assert main(["replay", model, source]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert json.loads(lines[-1])["state"] in ("nothing", "grasp", "safe_slip", "risky_slip")
    assert len(lines) > 150


def spoil(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("tactile.truth.json", "[1]", LabelError),
        ("tactile.truth.json", '{"phases": [3]}', LabelError),
        ("meta.json", "{", LabelError),
        ("tactile.csv", "Time,X1,Y1,Z1,sequence\n0,1,1,1,0\n1,1,1,1,0\n", TimeError),
        ("tactile.csv", "Time,X1,Y1,Z1,sequence\n0,1,1,1,0\n1,1,1,1,1e300\n", TimeError),
        ("tactile.csv", "Time,X1,Y1,Z1,sequence\n0,1,1,1,0\n1,1,1,1,900\n", TimeError),
        ("tactile.csv", "Time,X1,Y1,Z1,sequence\n0,1,1,1,0\n1,1,1,1,1.5\n", TimeError),
        ("tactile.csv", "Time,X1,Y1,Z1,sequence\n0,1,1,1,0\n1,1,1,1,nan\n", TimeError),
    ],
)
def test_a_recording_that_somebody_spoilt_is_refused_by_name(people, tmp_path, name, text, error):
    copy = shutil.copytree(people / "p01", tmp_path / "p01")
    spoil(copy / "soft-ball/pull/trial_1", name, text)
    with pytest.raises(error, match=re.escape(name)):
        load(copy)


@pytest.mark.parametrize("line", ["nonsense", "3", '{"mark": "contact", "provenance": "key"}'])
def test_events_that_cannot_be_understood_are_refused_by_name(people, tmp_path, line):
    from holdfast.recorder.labels import relabel

    folder = shutil.copytree(people / "p01/soft-ball/pull/trial_1", tmp_path / "trial_1")
    before = relabel(folder)
    assert before == json.loads((people / "p01/soft-ball/pull/trial_1/tactile.truth.json").read_text())
    (folder / "events.jsonl").write_text(line + "\n")
    with pytest.raises(LabelError, match=r"events\.jsonl"):
        relabel(folder)


def test_every_error_of_a_word_says_what_is_allowed():
    with pytest.raises(HoldfastError, match="letters, digits and dashes"):
        word("a b", "pseudonym")
    assert word("p-01", "pseudonym") == "p-01"


# -- the page


def test_the_page_shows_a_card_that_is_one_every_key_and_commands_that_are_understood(tmp_path):
    page = (ROOT / "docs/recording.md").read_text("utf-8")
    (card_text,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "shown.toml").write_text(card_text)
    assert read_protocol(tmp_path / "shown.toml").tasks
    shown = dict(re.findall(r"^\| `(\w+)` \| ([a-z_ ]+)", page, re.M))
    assert set(shown) == {"space"} | {key for key in KEYS if key.isalpha()}
    commands = re.findall(r"^holdfast record (.*?)(?:\s+#.*)?$", page, re.M)
    assert len(commands) >= 3
    import shlex

    for command in commands:
        told(*shlex.split(command))
