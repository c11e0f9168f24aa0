"""The graph where depthai does as a script says: silence, a camera that is lost, a late queue."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from holdfast.core.errors import DeviceLost, EmptyRecording, OutputError, TransferFailed
from holdfast.drivers.camera import graph
from holdfast.drivers.camera.recording import Lens, read_about, read_tracks

STEP_S = 0.1


def answer(sequence: int, *tags: Any) -> Any:
    return SimpleNamespace(
        getSequenceNum=lambda: sequence,
        getTimestamp=lambda: timedelta(seconds=STEP_S * sequence),
        aprilTags=list(tags),
    )


def tag(number: int, *corners: float) -> Any:
    """A tag as depthai has it: corners top left, top right, bottom right, bottom left."""
    names = ("topLeft", "topRight", "bottomRight", "bottomLeft")
    pairs = zip(corners[::2], corners[1::2], strict=True)
    places = [SimpleNamespace(x=x, y=y) for x, y in pairs]
    return SimpleNamespace(id=number, **dict(zip(names, places, strict=True)))


class Node:
    """Takes every setting; `input` has these sizes in turn."""

    def __init__(self, script: Script) -> None:
        self.input = SimpleNamespace(getSize=lambda: next(script.sizes, 0))
        self.inputImage = self.initialConfig = self
        self.out = SimpleNamespace(createOutputQueue=lambda **given: script)

    def __getattr__(self, name: str) -> Callable[[Any], None]:
        return lambda given: None


class Script:
    """depthai and the source in front of it.

    answers: one for each wait, None where nothing came. last_lost: above 0 for a camera. runs: so
    often the pipeline says that it runs.
    """

    class QueueException(Exception):
        pass

    name = "script"
    lens = Lens(60.0, 2.0, 10.0, "trial")

    def __init__(
        self,
        answers: list[Any],
        last_lost: int = 0,
        sizes: tuple[int, ...] = (),
        runs: int = 10**9,
        fails: Exception | None = None,
    ) -> None:
        self.answers = answers
        self.last_lost = last_lost
        self.sizes: Iterator[int] = iter(sizes)
        self.runs = runs
        self.fails = fails
        self.sent = len(answers)
        self.waited_s: list[float] = []
        self.MessageQueue = self
        self.node = SimpleNamespace(RecordVideo="video", AprilTag="tags")
        self.AprilTagConfig = SimpleNamespace(Family=SimpleNamespace(TAG_36H11=""))

    def create(self, node: str) -> Node:
        return Node(self)

    def open(self, dai: Any) -> Any:
        return self

    def connect(self, *given: Any) -> Callable[[], bool]:
        def step() -> bool:
            if self.answers:
                return True
            if self.fails is not None:
                raise self.fails
            return False

        return step

    def get(self, wait: timedelta) -> Any:
        self.waited_s.append(wait.total_seconds())
        found = self.answers.pop(0)
        if isinstance(found, Exception):
            raise found
        return found

    def tryGet(self) -> None:  # noqa: N802
        return None

    def isRunning(self) -> bool:  # noqa: N802
        self.runs -= 1
        return self.runs >= 0

    def start(self) -> None:
        pass

    stop = wait = close = start


Watched = Callable[..., Any]


@pytest.fixture
def watched(monkeypatch: Any, tmp_path: Path) -> Watched:
    """Runs a script; the video holds these frames."""

    def run(script: Any, in_video: range, pauses: list[float] | None = None) -> Any:
        kept: list[float] = [] if pauses is None else pauses
        monkeypatch.setitem(sys.modules, "depthai", script)
        monkeypatch.setattr(time, "sleep", kept.append)
        stamps_s = {k: STEP_S * k for k in in_video}
        monkeypatch.setattr(graph, "stamps_of_video", lambda folder, dai: stamps_s)
        return graph.watch(script, tmp_path)

    return run


def test_a_frame_from_disk_that_gets_no_answer_for_ten_seconds_voids_the_trial(
    watched, tmp_path
):
    script = Script([answer(0), None, answer(2)])
    with pytest.raises(DeviceLost, match="stopped coming"):
        watched(script, range(3))
    assert script.waited_s == [10.0, 10.0]
    about = read_about(tmp_path)
    assert (about.frames, "stopped coming" in str(about.void)) == (1, True)


def test_a_camera_is_not_waited_for(watched):
    script = Script([answer(0), None, None, answer(5)], last_lost=1)
    found = watched(script, range(6))
    assert (found.frames, found.lost) == (2, 4)
    assert script.waited_s == [0.1] * 4


def test_two_tags_of_a_number_in_one_frame_are_none(watched, tmp_path):
    square = (1.5, 2.0, 3.0, 2.25, 3.5, 4.0, 1.0, 4.5)
    tags = [tag(1, *square), tag(5, *square), tag(5, *square)]
    watched(Script([answer(0, *tags)]), range(1))
    tracks = read_tracks(tmp_path)
    assert tracks.t_s.tolist() == [-0.001]
    assert list(tracks.corners_px) == [1]
    assert tracks.of(1).reshape(-1).tolist() == list(square)


@pytest.mark.parametrize(
    ("in_video", "last_lost", "missing"),
    [
        (range(4), 0, 0),
        (range(3), 1, 0),
        (range(3), 0, 1),
        (range(2), 1, 1),
        (range(1, 4), 1, 1),
        (range(0), 9, 1),
    ],
)
def test_only_the_last_frames_of_a_camera_may_be_missing_in_the_video(
    watched, tmp_path, in_video, last_lost, missing
):
    script = Script([answer(k) for k in range(4)], last_lost)
    if missing:
        with pytest.raises(OutputError, match=f"{missing} of 4 frames are not in"):
            watched(script, in_video)
    else:
        assert watched(script, in_video).in_video == len(in_video)
    about = read_about(tmp_path)
    assert (about.frames, about.in_video) == (4, len(in_video))
    assert (about.void is None) == (missing == 0)


def test_a_frame_of_another_time_is_not_the_frame_of_its_number(watched, monkeypatch):
    monkeypatch.setattr(graph, "STAMP_S", -1.0)
    with pytest.raises(OutputError, match="4 of 4 frames"):
        watched(Script([answer(k) for k in range(4)]), range(4))


@pytest.mark.parametrize(
    ("script", "where", "frames"),
    [
        ({"runs": 2, "last_lost": 1}, "script", 3),
        ({"answers": [answer(0), Script.QueueException()]}, "script", 1),
        ({"fails": TransferFailed("full", where="x")}, "x: full", 5),
    ],
)
def test_a_run_that_fails_keeps_its_frames_and_says_what_failed(
    watched, tmp_path, script, where, frames
):
    answers = [answer(k) for k in range(5)]
    with pytest.raises((DeviceLost, TransferFailed), match=f"^{where}") as error:
        watched(Script(**({"answers": answers} | script)), range(5))
    about = read_about(tmp_path)
    assert (about.frames, about.void) == (frames, str(error.value))
    assert len(read_tracks(tmp_path).t_s) == frames


def test_a_run_without_a_frame_is_an_error(watched, tmp_path):
    with pytest.raises(EmptyRecording, match="no frame"):
        watched(Script([]), range(0))
    assert "no frame" in str(read_about(tmp_path).void)


@pytest.mark.parametrize(
    ("sizes", "pauses"),
    [((), 5), ((3, 0, 0, 1, 0, 0, 0, 0, 0, 1), 15), ((1,) * 2000, 1000)],
)
def test_a_video_s_queue_is_waited_for_until_it_stays_empty_or_ten_seconds_are_over(
    watched, sizes, pauses
):
    slept: list[float] = []
    watched(Script([answer(0)], sizes=sizes), range(1), slept)
    assert slept == [0.01] * pauses


@pytest.mark.parametrize(
    "name", ["camera.mkv", "camera.mcap", "tags.csv", "camera.json"]
)
def test_a_folder_with_any_file_of_a_recording_is_left_alone(watched, tmp_path, name):
    (tmp_path / name).write_text("before")
    with pytest.raises(OutputError, match=f"holds {name} already"):
        watched(Script([answer(0)]), range(1))
    assert [one.read_text() for one in tmp_path.iterdir()] == ["before"]
