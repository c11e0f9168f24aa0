"""A camera beside the recorder: real processes, and what goes wrong."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from drawn_frames import two_sizes
from recorder_bench import errors_in, meta_of, start, wait_for

from holdfast.cli.main import main
from holdfast.core.trial_file import read_trial
from holdfast.drivers.camera.recording import read_about
from holdfast.sessions.camera import OAK, film

LENS = {"fps": 30.0, "exposure_ms": 2.0, "tag_mm": 10.0}


def words_of(folder: Path) -> list[object]:
    """The recorder on a virtual hand, and more frames than a short trial takes to be read."""
    frames = two_sizes(folder / "long.frames.npz", n=900)
    source = ["--source", "virtual://ft232h", "--camera", frames]
    return [*source, *one_pull_in(folder)]


def one_pull_in(folder: Path) -> list[str]:
    words = "--person p01 --at-once --object soft-ball --action pull --trials 1"
    return ["--out", str(folder / "out"), *words.split()]


def trial_in(folder: Path) -> Path:
    return folder / "out/p01/soft-ball/pull/trial_1"


def children(pid: int) -> list[int]:
    path = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in path.read_text().split()]


@pytest.mark.hard_case(
    "What comes from outside",
    "a camera that is unplugged in the middle of a trial",
    elsewhere="the recorder ends with it, or keeps a video that stops without a message",
    here="the recording of the hand continues; the camera part is void, in meta.json and on the "
    "screen",
)
def test_a_camera_that_goes_away_voids_its_part_and_the_hand_is_recorded_to_the_end(
    tmp_path,
):
    with start(*words_of(tmp_path), "--seconds", "2") as run:
        wait_for(run, "recording p01")
        for pid in children(run.pid):
            os.kill(pid, signal.SIGKILL)
        _, err = run.communicate(timeout=300)
    assert run.returncode == 0, err
    folder = trial_in(tmp_path)
    meta = meta_of(folder)
    assert (meta["state"], meta["camera"]["void"]) == ("kept", "interrupted")
    assert len(read_trial(folder / "tactile.csv").t_s) > 250
    assert "this trial has no camera recording" in err
    assert read_about(folder).void == "interrupted"
    assert main(["watch", "--onset", str(folder)]) == 3, "a void part gets no label"


def test_an_oak_ends_with_the_recorder_whatever_ended_that(tmp_path, monkeypatch):
    """The kernel closes the pipe that the recorder holds."""
    reading, writing = os.pipe()
    stops = []

    def watch(source, out, stopped):
        stops.append(stopped())
        os.close(writing)
        stops.append(stopped())

    monkeypatch.setattr("holdfast.drivers.camera.graph.watch", watch)
    monkeypatch.setattr(os, "nice", lambda more: more)
    with open(reading) as recorder:
        monkeypatch.setattr(sys, "stdin", recorder)
        film({"camera": OAK, "out": str(tmp_path), **LENS})
    assert stops == [False, True]


def test_without_a_camera_nothing_is_recorded_and_one_error_says_why(tmp_path):
    words = "--source virtual://ft232h --camera oak --tag-mm 10 --seconds 1"
    with start(*words.split(), *one_pull_in(tmp_path)) as run:
        _, err = run.communicate(timeout=300)
    (error,) = errors_in(err)
    assert (run.returncode, "CameraUnavailable" in error) == (6, True)
    assert not list((tmp_path / "out").rglob("tactile.csv"))
    assert not trial_in(tmp_path).exists()
