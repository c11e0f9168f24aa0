"""Tracks, onset and the camera's page without depthai."""

from __future__ import annotations

import json
import time
from itertools import chain, repeat
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, call

import numpy as np
import pytest
from camera_frames import HAND_TAG
from drawn_frames import FPS, program, write_frames
from hand_made_tracks import hand_made

from holdfast.cli.main import main
from holdfast.core.errors import (
    ColumnError,
    DataNotFound,
    EmptyRecording,
    HoldfastError,
    NotANumber,
    TimeError,
    TransferFailed,
)
from holdfast.drivers.camera.graph import Oak, StoredFrames
from holdfast.drivers.camera.recording import (
    Frame,
    Lens,
    new_tag_file,
    read_frames,
    read_tracks,
    write_tags,
)

STAMPS_S = np.arange(1, 4) / FPS
FRAMES = np.zeros((3, 24, 24), dtype=np.uint8)
NO_FRAMES: dict[str, tuple[Any, Any, type[HoldfastError]]] = {
    "other lengths": (STAMPS_S[:2], FRAMES, EmptyRecording),
    "odd": (STAMPS_S, FRAMES[:, 1:], EmptyRecording),
    "no bytes": (STAMPS_S, FRAMES.astype(np.uint16), EmptyRecording),
    "one picture": (STAMPS_S, FRAMES[:, 0], EmptyRecording),
    "no frames": (STAMPS_S[:0], FRAMES[:0], EmptyRecording),
    "backwards": (STAMPS_S[::-1], FRAMES, TimeError),
    "no time": (np.array([0.1, np.nan, 0.3]), FRAMES, TimeError),
    # a picture of two pixels ended the interpreter in depthai
    "two pixels": (STAMPS_S, FRAMES[:, :2, :2], EmptyRecording),
    "a stamp of a million years": (STAMPS_S + 3e13, FRAMES, TimeError),
    "stamps in ms": (1e3 * STAMPS_S, FRAMES, TimeError),
}


@pytest.mark.parametrize("how", NO_FRAMES)
def test_frames_that_cannot_be_used_are_refused_by_name(tmp_path, how):
    stamps_s, frames, error = NO_FRAMES[how]
    path = write_frames(tmp_path / "some.frames.npz", stamps_s, frames)
    with pytest.raises(error, match=r"some\.frames\.npz"):
        read_frames(path)


@pytest.mark.parametrize(
    "number",
    [{"fps": np.inf}, {"fps": np.nan}, {"exposure_ms": np.inf}, {"tag_mm": 1e9}],
)
def test_a_lens_that_cannot_be_is_refused_by_name(
    tmp_path: Path, number: dict[str, float]
) -> None:
    path = write_frames(tmp_path / "some.frames.npz", STAMPS_S, FRAMES, **number)
    (name,) = number
    with pytest.raises(EmptyRecording, match=rf"some\.frames\.npz: {name} = "):
        read_frames(path)


@pytest.mark.parametrize("content", [b"PK\x03\x04 not frames", b""])
def test_a_file_that_holds_no_frames_is_refused_by_name(tmp_path, content):
    path = tmp_path / "some.frames.npz"
    with pytest.raises(DataNotFound, match=r"some\.frames\.npz"):
        read_frames(path)
    path.write_bytes(content)
    with pytest.raises(EmptyRecording, match=r"some\.frames\.npz"):
        read_frames(path)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", ColumnError),
        ("a,b\n", ColumnError),
        ("z,b\n", ColumnError),
        ("HEAD", EmptyRecording),
        ("HEAD0,0.1,,,,,,,,,\n1,0.2,0\n2,0.3,,,,,,,,,\n", NotANumber),
        ("HEAD0,0.2,,,,,,,,,\n1,0.1,,,,,,,,,\n", TimeError),
        ("HEAD0,0.2,,,,,,,,,\n1,0.2,,,,,,,,,\n", TimeError),
        ("HEAD0,nan,,,,,,,,,\n", TimeError),
        ("HEAD0,1e300,,,,,,,,,\n", TimeError),
        ("HEAD0,0.1,0\n", NotANumber),
    ],
)
def test_tracks_that_cannot_be_used_are_refused(tmp_path, text, error):
    with new_tag_file(tmp_path):
        pass
    head = (tmp_path / "tags.csv").read_text()
    (tmp_path / "tags.csv").write_text(text.replace("HEAD", head))
    with pytest.raises(error, match=r"tags\.csv"):
        read_tracks(tmp_path)


def test_an_incomplete_last_line_is_left_out_and_no_other(tmp_path):
    with new_tag_file(tmp_path) as file:
        write_tags(file, 0, 0.1, {HAND_TAG: [0.5] * 8})
        write_tags(file, 1, 0.2, {})
        file.write("2,0.3,")
    tracks = read_tracks(tmp_path)
    assert tracks.t_s.tolist() == [0.1, 0.2]
    assert np.isfinite(tracks.of(HAND_TAG)).all(axis=(1, 2)).tolist() == [True, False]


def test_onset_counts_from_the_first_tactile_sample_and_leaves_other_events_alone(
    tmp_path, capsys
):
    hand_made(tmp_path, at_s=5000.0, slides_at_s=0.8)
    (tmp_path / "tactile.csv").write_text(
        "Time,X1,Y1,Z1,host_ns\n0.0,0,0,0,5000250000000\n"
    )
    other = json.dumps(
        {"t0_s": 0.1, "t1_s": 0.2, "label": "grasp", "provenance": "person"}
    )
    (tmp_path / "events.jsonl").write_text(other + "\n")
    for _ in range(2):
        assert main(["watch", "--onset", str(tmp_path), "--action", "pass"]) == 0
    first, mine = map(json.loads, (tmp_path / "events.jsonl").read_text().splitlines())
    assert first == json.loads(other)
    assert mine["t0_s"] == pytest.approx(0.55, abs=0.006)
    assert (mine["label"], mine["provenance"], mine["by"]) == (
        "safe_slip",
        "camera",
        "holdfast watch",
    )


def test_without_tactile_samples_onset_counts_from_the_first_frame(tmp_path, capsys):
    hand_made(tmp_path, at_s=5000.0, slides_at_s=0.8)
    assert main(["watch", "--onset", str(tmp_path), "--action", "pull"]) == 0
    assert json.loads((tmp_path / "events.jsonl").read_text())["t0_s"] == pytest.approx(
        0.8, abs=0.006
    )


@pytest.mark.parametrize(
    ("words", "spoils", "code", "says"),
    [
        ((), "", 2, "--action pull|fall"),
        (("--action", "fly"), "", 2, "fly"),
        (("--gross-mm", "0"), "", 2, "not a number from"),
        (("--until", "0.1"), "", 3, "rest"),
        (("--action", "pull"), "tactile.csv", 3, "host_ns"),
        (("--action", "pull"), "events.jsonl", 3, "not a JSON object"),
        (("--action", "pull"), "camera.json", 3, "not valid JSON"),
    ],
)
def test_what_onset_cannot_use_is_one_line(tmp_path, capsys, words, spoils, code, says):
    hand_made(tmp_path, at_s=5000.0, slides_at_s=0.8)
    if spoils:
        (tmp_path / spoils).write_text("nonsense\nmore\n")
    assert main(["watch", "--onset", str(tmp_path), *words]) == code
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert says in err


def test_an_object_that_stays_gets_no_line_and_needs_no_action(tmp_path, capsys):
    hand_made(tmp_path, at_s=0.0, slides_at_s=None)
    assert main(["watch", "--onset", str(tmp_path)]) == 0
    assert "no onset" in capsys.readouterr().out
    assert (tmp_path / "events.jsonl").read_text() == ""


def test_the_camera_s_clock_is_the_machine_s_and_its_calls_are_in_the_library():
    output = program("""
import time
dai = load_depthai()
before, middle, after = time.monotonic(), dai.Clock.now().total_seconds(), time.monotonic()
names = [(dai.Device, "setMaxReconnectionAttempts"), (dai.Device, "close"),
         (dai.Pipeline, "setStopOnDeviceLoss"),
         (dai.node.Camera, "build"), (dai.node.Camera, "requestOutput"),
         (dai.node.Camera, "initialControl"),
         (dai.CameraControl, "setManualExposure"), (dai.Node.Output, "link")]
between = before - 2e-6 <= middle <= after + 2e-6
lacks = [name for one, name in names if not hasattr(one, name)]
print(json.dumps({"between": between, "lacks": lacks}))
""")
    assert output == {"between": True, "lacks": []}


def test_an_oak_films_as_the_lens_says_and_ends_when_its_time_is_up(monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    dai, pipeline, inputs = MagicMock(), MagicMock(), [MagicMock(), MagicMock()]
    oak = Oak(Lens(60.0, 1.5, 12.0, "monotonic"), seconds=2.0)
    assert oak.last_lost == 20
    goes_on = oak.connect(dai, pipeline, inputs)
    build = pipeline.create.return_value.build
    build.assert_called_once_with(sensorFps=60.0)
    camera = build.return_value
    camera.initialControl.setManualExposure.assert_called_once_with(1500, 800)
    grey = dai.ImgFrame.Type.GRAY8
    camera.requestOutput.assert_called_once_with((640, 400), type=grey, fps=60.0)
    link = camera.requestOutput.return_value.link
    assert link.call_args_list == [call(one) for one in inputs]
    assert goes_on()
    now_s[0] = 102.0
    assert not goes_on()


def test_an_oak_that_falls_off_the_bus_ends_its_graph_and_is_given_back():
    dai = MagicMock()
    oak = Oak(Lens(60.0, 1.5, 12.0, "monotonic"))
    oak.close()
    pipeline = oak.open(dai)
    pipeline.setStopOnDeviceLoss.assert_called_once_with(True)
    dai.Device.return_value.setMaxReconnectionAttempts.assert_called_once_with(0)
    dai.Device.return_value.close.assert_not_called()
    oak.close()
    dai.Device.return_value.close.assert_called_once_with()


def test_frames_from_disk_are_numbered_in_order_and_are_whole_as_they_were(tmp_path):
    images = np.arange(3 * 24 * 26, dtype=np.uint8).reshape(3, 24, 26)
    path = write_frames(tmp_path / "a.frames.npz", np.arange(3) / 4, images, fps=4.0)
    name, lens, stored = read_frames(path)
    assert (name, lens) == (path.name, Lens(4.0, 2.0, 10.0, "trial"))
    frames = list(stored)
    assert [(one.sequence, one.end_s) for one in frames] == [
        (0, 0),
        (1, 0.25),
        (2, 0.5),
    ]
    np.testing.assert_array_equal([one.image for one in frames], images)


@pytest.mark.parametrize(
    ("refused", "stops_at", "taken"),
    [
        (9_990, 10**6, True),
        (10_010, 10**6, False),
        (5, 3, False),
    ],
)
def test_a_frame_waits_ten_seconds_for_room_unless_the_graph_stops(
    monkeypatch, refused, stops_at, taken
):
    now_s, pauses = [50.0], []

    def sleep(pause_s):
        pauses.append(pause_s)
        now_s[0] = 50.0 + len(pauses) / 1000

    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(time, "sleep", sleep)
    dai, one = MagicMock(), MagicMock()
    dai.MessageQueue.QueueException = ArithmeticError
    answers = chain([False, ArithmeticError], repeat(False, refused), repeat(True))
    one.createInputQueue.return_value.trySend.side_effect = answers
    pipeline = SimpleNamespace(isRunning=lambda: len(pauses) < stops_at)
    frames = [Frame(0, 0.0, np.zeros((2, 4), np.uint8))]
    source = StoredFrames("some", Lens(60.0, 2.0, 10.0, "trial"), frames)
    step = source.connect(dai, pipeline, [one])
    one.createInputQueue.assert_called_once_with(maxSize=4, blocking=True)
    if taken:
        assert step()
        assert not step()
    else:
        with pytest.raises(TransferFailed, match="takes no more frames"):
            step()
    assert set(pauses) <= {0.001}
