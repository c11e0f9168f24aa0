"""A camera beside the recorder: real processes, and what goes wrong."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from drawn_frames import two_sizes
from grip_bench import until
from recorder_bench import errors_in, meta_of, start, wait_for

from holdfast.cli.main import main
from holdfast.core.trial_file import read_trial
from holdfast.drivers.camera.recording import read_about


def words_of(folder: Path) -> list[object]:
    """The recorder on a virtual hand, and more frames than a short trial takes to be read."""
    film = two_sizes(folder / "long.frames.npz", n=900)
    source = ["--source", "virtual://ft232h", "--camera", film]
    return [*source, *one_pull_in(folder)]


def one_pull_in(folder: Path) -> list[str]:
    words = "--person p01 --at-once --object soft-ball --action pull --trials 1"
    return ["--out", str(folder / "out"), *words.split()]


def trial_in(folder: Path) -> Path:
    return folder / "out/p01/soft-ball/pull/trial_1"


def children(pid: int) -> list[int]:
    path = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in path.read_text().split()]


def runs(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


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


def test_a_camera_outlives_no_recorder_that_was_killed(tmp_path):
    with start(*words_of(tmp_path), "--seconds", "600") as run:
        wait_for(run, "recording p01")
        (camera,) = children(run.pid)
        run.kill()
        run.communicate(timeout=300)
    until(lambda: not runs(camera))
    assert meta_of(trial_in(tmp_path))["state"] == "recording"


def test_without_a_camera_nothing_is_recorded_and_one_error_says_why(tmp_path):
    words = "--source virtual://ft232h --camera oak --tag-mm 10 --seconds 1"
    with start(*words.split(), *one_pull_in(tmp_path)) as run:
        _, err = run.communicate(timeout=300)
    (error,) = errors_in(err)
    assert (run.returncode, "CameraUnavailable" in error) == (6, True)
    assert not list((tmp_path / "out").rglob("tactile.csv"))
    assert not trial_in(tmp_path).exists()
