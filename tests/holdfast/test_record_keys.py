"""The recorder's keys: begin, keep, do again, mark, stop; the terminal is as before on every way
out."""

from __future__ import annotations

import os
import pty
import signal
import termios
from functools import partial

import pytest
from grip_bench import until
from recorder_bench import (
    AREA,
    PULL,
    REST,
    TRIAL,
    Hand,
    cup_pull,
    events_of,
    meta_of,
    on_terminal,
    said,
    session,
    start,
    states_in,
    terminal_of_its_own,
    truth_of,
    wait_for,
    wait_on_terminal_for,
)

from holdfast.core.trial_file import read_trial
from holdfast.data.datasets import load
from holdfast.sessions.recorder.plan import Task


def test_marks_become_phases_with_their_provenance(tmp_path, pressing):
    keys, press = pressing
    hand = Hand(
        120,
        says={60: lambda: press("l"), 90: lambda: press("e"), 110: lambda: press("k")},
    )
    kept, messages = session(tmp_path, hand, [PULL], keys)
    folder = tmp_path / TRIAL
    truth = truth_of(folder)
    phases = [(one["label"], one["provenance"]) for one in truth["phases"]]
    assert kept == 1
    assert phases == [
        ("nothing", "rule"),
        ("grasp", "rule"),
        ("risky_slip", "key"),
        ("nothing", "key"),
    ]
    assert truth["contact_s"] == pytest.approx(0.40, abs=0.06)
    assert (truth["load_onset_s"], truth["contact_lost_s"]) == (
        pytest.approx(0.60),
        pytest.approx(0.90),
    )
    assert said(messages, "load onset at 0.600 s")
    marks = events_of(folder)
    assert [(one["mark"], one["provenance"]) for one in marks] == [
        ("load_onset", "key"),
        ("contact_lost", "key"),
    ]


def test_without_a_mark_the_load_onset_is_not_guessed(tmp_path):
    session(tmp_path / "held", Hand(120))
    truth = truth_of(tmp_path / "held" / TRIAL)
    assert [one["label"] for one in truth["phases"]] == ["nothing", "nothing"]
    assert truth["load_onset_s"] is None
    (recording,) = load(tmp_path / "held", windows="natural").recordings
    assert [phase.situation for phase in recording.phases] == [0, 0]
    assert recording.events == ()

    session(tmp_path / "free", Hand(60), seconds=0.35)
    data = load(tmp_path / "free", windows="natural")
    assert data.recordings[0].phases == ()
    assert len(data.tasks["classes"]) == 0


@pytest.mark.parametrize(
    ("action", "labels"),
    [
        ("hold", ["nothing", "grasp", "nothing"]),
        ("pass", ["nothing", "grasp", "safe_slip", "nothing"]),
        ("fall", ["nothing", "grasp", "risky_slip", "nothing"]),
        ("nothing", ["nothing"]),
    ],
)
def test_what_an_action_makes_of_the_grip_is_its_label(
    tmp_path, pressing, action, labels
):
    keys, press = pressing
    hand = Hand(120, says={60: lambda: press("l")})
    session(tmp_path, hand, [Task("soft-ball", action)], keys)
    (path,) = tmp_path.rglob("tactile.truth.json")
    phases = truth_of(path.parent)["phases"]
    assert [phase["label"] for phase in phases] == labels
    assert (phases[0]["t0_s"], phases[-1]["t1_s"]) == (0.0, pytest.approx(1.2))


def test_redo_moves_the_trial_away_and_the_same_comes_up_again(tmp_path, pressing):
    keys, press = pressing
    pressed = {100: "r", 200: "k", 300: "q"}
    hand = Hand(400, says={at: partial(press, key) for at, key in pressed.items()})
    kept, _ = session(tmp_path, hand, [PULL, Task("my-cup", "pass")], keys)
    assert kept == 2
    moved = tmp_path / "p01/discarded/soft-ball/pull/trial_1-1"
    assert meta_of(moved)["state"] == "redone"
    assert states_in(tmp_path) == ["redone", "kept", "kept"]
    assert meta_of(tmp_path / TRIAL)["state"] == "kept"


@pytest.mark.parametrize("way", ["keys", "SIGTERM", "SIGHUP", "error"])
def test_a_terminal_is_as_before_on_every_way_out(tmp_path, way):
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    words = cup_pull(tmp_path / "out")
    fault = f"{REST}?fault=nack:2@0%2B99"
    words[1] = fault if way == "error" else REST

    with start(*words, stdin=slave, preexec_fn=terminal_of_its_own) as run:
        if way != "error":
            wait_for(run, "next: cup, pull")
            assert not termios.tcgetattr(slave)[3] & termios.ICANON
            os.write(master, b" ")
            wait_for(run, "recording p01")
        if way == "keys":
            os.write(master, b"l")
            wait_for(run, "load onset at")
            os.write(master, b"k")
            wait_for(run, "kept")
            os.write(master, b"q")
        if way in ("SIGTERM", "SIGHUP"):
            run.send_signal(signal.Signals[way])
        run.communicate(timeout=300)
    assert run.returncode == (3 if way == "error" else 0)
    assert termios.tcgetattr(slave) == before
    assert (
        states_in(tmp_path / "out")
        == {
            "keys": ["kept"],
            "SIGTERM": ["interrupted"],
            "SIGHUP": ["interrupted"],
            "error": [],
        }[way]
    )
    os.close(master)
    os.close(slave)


@pytest.mark.hard_case(
    AREA,
    "an SSH connection that drops while a trial is recorded",
    elsewhere="the recorder dies with the terminal, and its trial says for ever that it is "
    "being recorded",
    here="the trial ends as by SIGTERM: its rows are whole, its state is interrupted, "
    "it is announced again",
)
def test_a_terminal_that_goes_away_ends_the_trial_as_sigterm_does(tmp_path):
    master, slave = pty.openpty()
    words = cup_pull(tmp_path / "out")
    with on_terminal(slave, *words) as run:
        wait_on_terminal_for(master, "next: cup, pull")
        os.write(master, b" ")
        wait_on_terminal_for(master, "recording p01")
        folder = tmp_path / "out/p01/cup/pull/trial_1"
        until(lambda: (folder / "tactile.csv").read_bytes().count(b"\n") >= 20)
        os.close(master)
        assert run.wait(timeout=300) == 0
    meta = meta_of(folder)
    assert meta["state"] == "interrupted"
    assert "why" not in meta, "no error ended it"
    rows = (folder / "tactile.csv").read_bytes().count(b"\n") - 1  # below the header
    assert meta["quality"]["samples"] == rows >= 19
    # lost samples are rows there, too
    assert len(read_trial(folder / "tactile.csv").t_s) >= rows
    assert [path.name for path in folder.parent.iterdir()] == ["trial_1"]
