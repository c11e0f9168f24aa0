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
        monkeypatch.setattr(graph, "frames_of_video", lambda *given: {*in_video})
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
