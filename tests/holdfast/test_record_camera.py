"""A camera beside the recorder: a scene that is felt and filmed at once, real processes, and what
goes wrong."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_frames import two_sizes
from recorder_bench import (
    columns_of,
    context_of,
    errors_in,
    events_of,
    meta_of,
    options_of,
    start,
    truth_of,
    wait_for,
)

from holdfast.cli.main import main
from holdfast.core.trial_file import read_trial
from holdfast.drivers.camera.recording import read_about, read_tracks
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.sessions.camera import LOG, CameraProcess
from holdfast.sessions.recorder.keys import Keys
from holdfast.sessions.recorder.recording import record
from holdfast.training.datasets import load

ROOT = Path(__file__).resolve().parents[2]
CARD = """
[record]
rate_hz = 150
[physics]
step_s = {step_s}
[[trials]]
objects = ["soft-ball"]
action = "pull"
style = "author"
close_at_s = {close_at_s}
hold_s = 1.0
tail_s = 1.0
[effects.brush]
count = 5
[effects.dipole]
[effects.camera_frames]
[camera]
"""
SHARP = "width_px = 240\nheight_px = 160\n"
SMALL = SHARP + "fps = 30\n"
LATEST_S = 300.0


def words_of(
    folder: Path, size: str = SMALL, close_at_s: float = 60.0, step_s: float = 0.003
) -> list[object]:
    """The recorder on a virtual hand in a scene, and a camera before it.

    close_at_s: of the scene, whose time begins with the hand's, before the camera is looked for; on
    a slow machine it takes long until that films.
    """
    scene = folder / "filmed.toml"
    text = CARD.format(close_at_s=close_at_s, step_s=step_s) + size
    scene.write_text(text, encoding="utf-8")
    source = f"virtual://ft232h?burst=1&bus_hz=1000000&scene={scene}&seed=1"
    return ["--source", source, "--camera", "scene", *one_pull_in(folder)]


def one_pull_in(folder: Path) -> list[str]:
    words = "--person p01 --at-once --object soft-ball --action pull --trials 1"
    return ["--out", str(folder / "out"), *words.split()]


def finished(*words: object, timeout_s: float = LATEST_S) -> str:
    """What a recorder that ends well printed."""
    with start(*words) as run:
        _, err = run.communicate(timeout=timeout_s)
    assert run.returncode == 0, err
    return err


def require_filmed_throughout(folder: Path, late_s: float) -> None:
    """Frames go on from before the first sample to the last, but for late_s."""
    assert meta_of(folder)["camera"]["void"] is None
    tactile_s = 1e-9 * np.array(columns_of(folder)["host_ns"], dtype=np.int64)
    frames_s = read_tracks(folder).t_s
    assert frames_s[0] < tactile_s[0], "a trial begins when the camera films"
    assert frames_s[-1] > tactile_s[-1] - late_s


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


FILM = """
import json, sys
from pathlib import Path
from holdfast.drivers.camera.graph import watch
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.sessions.camera import filmed
options = json.loads(sys.argv[1])
clock = VirtualClock(options["from_ns"])
until_ns = options["until_ns"]
shown = filmed(options["source"], options["began_ns"], clock, lambda: clock.now_ns() >= until_ns)
watch(shown, Path(options["out"]), say=lambda line: None)
"""


class FilmsAfterwards(CameraProcess):
    """A camera on a virtual clock: what it would have filmed from start to stop is filmed when it
    is stopped."""

    def __init__(self, options: dict[str, Any], clock: VirtualClock) -> None:
        super().__init__(options)
        self.clock, self.from_ns = clock, 0

    def start(self, folder: Path) -> None:
        self._folder, self.from_ns = folder, self.clock.now_ns()

    def stop(self) -> dict[str, Any]:
        span = {
            "out": str(self._folder),
            "from_ns": self.from_ns,
            "until_ns": self.clock.now_ns(),
        }
        command = [sys.executable, "-c", FILM, json.dumps(self.options | span)]
        with (self._folder / LOG).open("wb") as log:
            self._process = subprocess.Popen(
                command, cwd=ROOT, stdin=subprocess.PIPE, stdout=log, stderr=log
            )
        return super().stop()


def recorded_with_film(*words: object) -> None:
    """The verb on a clock that costs nothing, for hand and camera alike."""
    clock = VirtualClock(7_000_000_000)
    context = context_of(
        clock,
        Keys(None),
        host_ns=clock.now_ns,
        camera=lambda options: FilmsAfterwards(options, clock),
    )
    record(options_of(*words), context)


def test_a_scene_that_is_felt_and_filmed_at_once_gives_the_onset_that_it_had(
    tmp_path, capsys
):
    words = words_of(tmp_path, size=SHARP, close_at_s=2.0)
    recorded_with_film(*words, "--seconds", "4")
    folder = trial_in(tmp_path)
    scene = truth_of(folder)
    meta = meta_of(folder)
    assert (meta["quality"]["samples"], meta["quality"]["lost"]) == (600, 0)
    assert meta["camera"]["doubt"] is None
    require_filmed_throughout(folder, late_s=0.02)

    assert main(["onset", str(folder)]) == 0
    lines = events_of(folder)
    (seen,) = [line for line in lines if line["provenance"] == "camera"]
    assert (seen["label"], scene["phases"][2]["label"]) == ("risky_slip", "risky_slip")
    assert abs(seen["t0_s"] - scene["incipient_slip_s"]) < 0.010
    assert abs(seen["gross_s"] - scene["gross_slip_s"]) < 0.015
    assert truth_of(folder) == scene, "a scene is believed before a camera"
    report_path = tmp_path / "report.html"
    row, printed = evaluated(tmp_path, capsys, "--report", report_path)
    by_camera = row["camera"]
    counts = (by_camera["onsets"], by_camera["events"], by_camera["found"])
    assert counts == (1, 1, row["found"]) == (1, 1, 1)
    off_ms = 1e3 * (seen["t0_s"] - scene["incipient_slip_s"])
    truth_ms = by_camera["truth"]["delay_ms"]["p50"]
    assert by_camera["delay_ms"]["p50"] == pytest.approx(truth_ms - off_ms, abs=0.01)
    assert f"act {by_camera['delay_ms']['p50']:+.0f} ms from its onset" in printed
    assert f"by the scene's truth: act {truth_ms:+.0f} ms from" in printed
    report = report_path.read_text()
    assert "Alarms against a camera" in report
    assert "<td>1 of 1<br>" in report

    (folder / "events.jsonl").write_text(f"{json.dumps(seen)}\n")
    assert main(["onset", str(folder)]) == 0
    alone = truth_of(folder)
    assert [(one["label"], one["provenance"]) for one in alone["phases"]] == [
        ("nothing", "rule"),
        ("grasp", "rule"),
        ("risky_slip", "camera"),
        ("nothing", "rule"),
    ]
    assert alone["contact_s"] == pytest.approx(scene["contact_s"], abs=0.15)
    (event,) = load(tmp_path / "out", windows="natural").recordings[0].events
    assert event.gross_s == pytest.approx(seen["gross_s"])
    row, printed = evaluated(tmp_path, capsys)
    assert row["camera"]["truth"] is None
    assert "the truth of these events is not known" in printed
    assert "source of load onsets: camera 1" in printed


def evaluated(folder: Path, capsys: Any, *more: object) -> tuple[dict[str, Any], str]:
    """The deployed model's row of figures on what was recorded, and what evaluate prints."""
    figures = folder / "figures.json"
    model = ROOT / "models/holdfast-150hz.onnx"
    words = ("evaluate", model, "--data", folder / "out", "--json", figures, *more)
    capsys.readouterr()
    assert main([str(word) for word in words]) == 0
    rows = json.loads(figures.read_text())["sets"]["out"]["rows"]
    return rows["ours, as deployed"], capsys.readouterr().out


def test_in_real_time_frames_go_on_from_before_the_first_sample_to_the_last(tmp_path):
    """A slow machine must do only this: a frame is drawn when there is time, but its stamp is
    when it was due."""
    finished(*words_of(tmp_path), "--seconds", "1")
    require_filmed_throughout(trial_in(tmp_path), late_s=0.04)


@pytest.mark.hard_case(
    "What comes from outside",
    "a camera that is unplugged in the middle of a trial",
    elsewhere="the recorder ends with it, or keeps a video that stops without a message",
    here="the recording of the hand continues; the camera part is void, in events.jsonl, meta.json "
    "and on the screen",
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
    events = events_of(folder)
    assert [one["event"] for one in events if "event" in one] == ["camera_lost"]
    assert "the camera failed" in err
    assert "this trial has no camera recording" in err
    assert read_about(folder)["void"] == "interrupted"
    assert main(["onset", str(folder)]) == 3, "a void part gets no label"


def test_tags_of_two_sizes_are_reported_after_the_trial_and_everything_is_kept(
    tmp_path,
):
    film = tmp_path / "some.frames.npz"
    two_sizes(film, n=45)
    source = ["--source", "virtual://ft232h", "--camera", film]
    err = finished(*source, *one_pull_in(tmp_path), "--seconds", "1")
    (warning,) = [line for line in err.splitlines() if "TagError" in line]
    assert "if the hand's tag is 10 mm, the object's is 12.5" in warning
    folder = trial_in(tmp_path)
    meta = meta_of(folder)
    assert (meta["state"], meta["camera"]["void"]) == ("kept", None)
    assert "TagError" in meta["camera"]["doubt"]
    assert len(read_tracks(folder).t_s) == 45
    assert len(read_trial(folder / "tactile.csv").t_s) > 100


def test_a_camera_outlives_no_recorder_that_was_killed(tmp_path):
    with start(*words_of(tmp_path), "--seconds", "600") as run:
        wait_for(run, "recording p01")
        (camera,) = children(run.pid)
        run.kill()
        run.communicate(timeout=300)
    until_s = time.monotonic() + LATEST_S
    while runs(camera) and time.monotonic() < until_s:
        os.sched_yield()
    assert not runs(camera)
    assert meta_of(trial_in(tmp_path))["state"] == "recording"


def test_without_a_camera_nothing_is_recorded_and_one_error_says_why(tmp_path):
    words = "--source virtual://ft232h --camera oak --tag-mm 10 --seconds 1"
    with start(*words.split(), *one_pull_in(tmp_path)) as run:
        _, err = run.communicate(timeout=300)
    (error,) = errors_in(err)
    assert (run.returncode, "CameraUnavailable" in error) == (6, True)
    assert not list((tmp_path / "out").rglob("tactile.csv"))
    assert not trial_in(tmp_path).exists()


@pytest.mark.soak
def test_ten_minutes_at_300_hz_with_a_camera_lose_no_sample(tmp_path, record_property):
    """HOLDFAST_SOAK_MINUTES: other than ten. Needs real-time priority, as the recorder does for
    this."""
    minutes = float(os.environ.get("HOLDFAST_SOAK_MINUTES", "10"))
    seconds = 60.0 * minutes
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began_s = time.monotonic()
    words = [*words_of(tmp_path, size=""), "--rate", "300", "--seconds", seconds]
    finished(*words, timeout_s=seconds + LATEST_S)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    quality = meta_of(trial_in(tmp_path))["quality"]
    about = read_about(trial_in(tmp_path))
    found = {name: quality[name] for name in ("samples", "lost", "jitter_p99_ms")}
    found["frames"] = about["frames"]
    found["cpu_share_of_a_core"] = round(spent_s / (time.monotonic() - began_s), 2)
    for name, value in found.items():
        record_property(name, value)
    sys.stdout.write(json.dumps(found) + "\n")
    assert (trial_in(tmp_path) / "camera.mkv").stat().st_size > 0
    assert (found["lost"], about["lost"]) == (0, 0)
