"""The graph and the folder that it leaves, where depthai does as a script says."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from datetime import timedelta
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from holdfast.core.errors import (
    ColumnError,
    DeviceLost,
    EmptyRecording,
    HoldfastError,
    OutputError,
    TimeError,
    TransferFailed,
)
from holdfast.drivers.camera import graph, recording
from holdfast.drivers.camera.recording import (
    COLUMNS,
    TagFile,
    Tracks,
    read_about,
    read_tracks,
    read_video,
    require_same_stamps,
)
from holdfast.drivers.camera.sources import Frame, Lens

LENS = Lens(60.0, 2.0, 10.0, "trial")
NO_IMAGE = np.empty((0, 0), np.uint8)


def tag(number: int, *corners: float) -> Any:
    """A tag as depthai has it: corners top left, top right, bottom right, bottom left."""
    names = ("topLeft", "topRight", "bottomRight", "bottomLeft")
    pairs = zip(corners[::2], corners[1::2], strict=True)
    places = [SimpleNamespace(x=x, y=y) for x, y in pairs]
    return SimpleNamespace(id=number, **dict(zip(names, places, strict=True)))


def answer(sequence: int, end_s: float, *tags: Any) -> Any:
    return SimpleNamespace(
        getSequenceNum=lambda: sequence,
        getTimestamp=lambda: timedelta(seconds=end_s),
        aprilTags=list(tags),
    )


def picture(sequence: int, end_s: float, size: tuple[int, int] = (2, 4)) -> Any:
    """A message of the video; depthai's data may be longer than the picture."""
    return SimpleNamespace(
        getSequenceNum=lambda: sequence,
        getTimestamp=lambda: timedelta(seconds=end_s),
        getHeight=lambda: size[0],
        getWidth=lambda: size[1],
        getData=lambda: list(range(size[0] * size[1] + 3)),
    )


class ScriptedNode:
    """A node of depthai: `received` keeps what it is given, by the name of the call."""

    received: dict[str, Any]

    def __init__(self, received: dict[str, Any], **parts: Any) -> None:
        self.__dict__.update(parts, received=received)

    def __getattr__(self, name: str) -> Callable[[Any], None]:
        def call(given: Any) -> None:
            self.received[name] = given
            if name.startswith("setRecord"):
                given.touch()

        return call

    def __setattr__(self, name: str, value: Any) -> None:
        self.received[name] = value


class ScriptedReplay:
    """The pipeline that plays a video: a thread hands its messages to the callback."""

    def __init__(self, video: Sequence[Any]) -> None:
        self.video = video
        self.received: dict[str, Any] = {}
        self.thread = Thread(target=self.play)

    def create(self, node: str) -> Any:
        self.received["node"] = node
        return ScriptedNode(
            self.received, out=SimpleNamespace(createOutputQueue=self.output)
        )

    def output(self, maxSize: int, blocking: bool) -> Any:
        self.received["queue"] = maxSize, blocking
        return self

    def addCallback(self, take: Callable[[Any], None]) -> None:  # noqa: N802
        self.take = take

    def play(self) -> None:
        for message in self.video:
            self.take(message)

    def start(self) -> None:
        self.thread.start()

    def isRunning(self) -> bool:  # noqa: N802
        return self.thread.is_alive()

    def stop(self) -> None:
        self.thread.join()


class ScriptedDepthai:
    """depthai as far as the graph calls it, and the source in front of it.

    answers: None where nothing came as long as the graph waits; a list came at once. sizes: of the
    video's queue. runs: so often the pipeline says that it runs. video: what is read again.
    """

    class QueueException(Exception):
        pass

    name, void = "script", None
    lens = LENS

    def __init__(
        self,
        answers: Sequence[Any],
        sent: int,
        sizes: Sequence[int] = (),
        last_lost: int = 0,
        runs: int = 10**9,
        video: Sequence[Any] = (),
        fails: HoldfastError | None = None,
    ) -> None:
        self.answers, self.sent, self.sizes = list(answers), sent, list(sizes)
        self.last_lost, self.runs, self.fails = last_lost, runs, fails
        self.stepped = 0
        self.waited_s: list[float] = []
        self.queue: tuple[int, bool] | None = None
        self.received: dict[str, Any] = {}
        self.replay = ScriptedReplay(video)
        self.MessageQueue = self
        self.ImgFrame = SimpleNamespace(Type=SimpleNamespace(GRAY8="gray"))
        self.node = SimpleNamespace(
            RecordVideo="video", AprilTag="tags", ReplayVideo="replay"
        )
        self.AprilTagConfig = SimpleNamespace(Family=SimpleNamespace(TAG_36H11="36h11"))

    def Pipeline(self, createImplicitDevice: bool) -> Any:  # noqa: N802
        self.replay.received["implicit"] = createImplicitDevice
        return self.replay

    def create(self, node: str) -> Any:
        return ScriptedNode(
            self.received,
            input=SimpleNamespace(
                getSize=lambda: self.sizes.pop(0) if self.sizes else 0
            ),
            inputImage=ScriptedNode(self.received),
            initialConfig=ScriptedNode(self.received),
            out=SimpleNamespace(createOutputQueue=self.output),
        )

    def output(self, maxSize: int, blocking: bool) -> Any:
        self.queue = (maxSize, blocking)
        return self

    def get(self, wait: timedelta) -> Any:
        self.waited_s.append(wait.total_seconds())
        return self._came()

    def tryGet(self) -> Any:  # noqa: N802
        # further answers are there at once only where a list says so
        if self.answers and isinstance(self.answers[0], list):
            if self.answers[0]:
                return self.answers[0].pop(0)
            del self.answers[0]
        return None

    def _came(self) -> Any:
        if not self.answers:
            return None
        if isinstance(self.answers[0], list):
            return self.tryGet()
        found = self.answers.pop(0)
        if isinstance(found, Exception):
            raise found
        return found

    def open(self, dai: Any) -> Any:
        return self

    def connect(self, *given: Any) -> Callable[[], bool]:
        steps = iter([True] * self.sent)

        def one() -> bool:
            if next(steps, False):
                self.stepped += 1
                return True
            if self.fails is not None:
                raise self.fails
            return False

        return one

    def isRunning(self) -> bool:  # noqa: N802
        self.runs -= 1
        return self.runs >= 0

    def start(self) -> None:
        pass

    stop = wait = close = start


def watched(monkeypatch: Any, out: Path, script: Any) -> tuple[Any, list[float]]:
    """camera.json of a run, whose video is never there, and the pauses of its end."""
    slept: list[float] = []
    monkeypatch.setitem(sys.modules, "depthai", script)
    monkeypatch.setattr(time, "sleep", slept.append)
    out.mkdir()
    with pytest.raises((DeviceLost, OutputError, TimeError)):
        graph.watch(script, out, say=print)
    return read_about(out), slept


@pytest.mark.parametrize(("quiet", "frames"), [(99, 3), (100, 2)])
def test_answers_are_waited_for_until_none_came_for_ten_seconds(
    monkeypatch, tmp_path, quiet, frames
):
    silence = [None] * quiet
    first, second, third = (answer(k, 0.1 * k) for k in range(3))
    script = ScriptedDepthai([first, *silence[:99], second, *silence, third], sent=3)
    about, _ = watched(monkeypatch, tmp_path / "out", script)
    assert (about["frames"], script.queue) == (frames, (30, True))
    assert set(script.waited_s) == {0.1}
    assert ("stopped coming" in about["void"]) == (frames < 3)


def test_lost_frames_are_counted_from_the_first_and_stamps_that_stand_still_void_a_trial(
    monkeypatch, tmp_path
):
    stamps = ((5, -0.5), (6, 0.1), (9, 0.2), (10, 0.2), (10, 0.3))
    script = ScriptedDepthai([answer(*one) for one in stamps], sent=5)
    about, _ = watched(monkeypatch, tmp_path / "out", script)
    assert (about["frames"], about["lost"], about["backwards"]) == (5, 2, 1)
    assert "1 frames are not later" in about["void"]
    lines = (tmp_path / "out/tags.csv").read_text("utf-8").splitlines()
    assert lines[1] == "5,-0.501000" + "," * 9


def test_frames_of_a_camera_are_not_waited_for_at_its_end(monkeypatch, tmp_path):
    script = ScriptedDepthai([answer(0, 0.0)], sent=4, last_lost=1)
    about, _ = watched(monkeypatch, tmp_path / "out", script)
    assert (about["frames"], script.waited_s) == (1, [0.1] * 4)


@pytest.mark.parametrize(
    ("sizes", "pauses"),
    [([], 5), ([3, 0, 0, 1, 0, 0, 0, 0, 0, 1], 15), ([1] * 2000, 1000)],
)
def test_a_video_s_queue_is_waited_for_until_it_stays_empty_or_ten_seconds_are_over(
    monkeypatch, tmp_path, sizes, pauses
):
    script = ScriptedDepthai([answer(0, 0.0)], sent=1, sizes=sizes)
    assert watched(monkeypatch, tmp_path / "out", script)[1] == [0.01] * pauses


@pytest.mark.parametrize("off_s", [-2.1e-6, -1.9e-6, 1.9e-6, 2.1e-6])
def test_a_stamp_of_the_video_may_differ_by_two_microseconds(tmp_path, off_s):
    tracks = Tracks(np.array([4]), np.array([0.5]), {})
    frames = [Frame(4, 0.501 + off_s, np.empty((0, 0), np.uint8))]
    if abs(off_s) < 2e-6:
        require_same_stamps(frames, tracks, ScriptedDepthai.lens, tmp_path)
        return
    with pytest.raises(ColumnError, match="1 frames of the video"):
        require_same_stamps(frames, tracks, ScriptedDepthai.lens, tmp_path)


# -- a run from its first frame to camera.json


def run(out: Path, script: Any, **more: Any) -> graph.CameraResult:
    out.mkdir()
    return graph.watch(script, out, say=print, **more)


@pytest.fixture
def scripted(monkeypatch: Any) -> Callable[..., ScriptedDepthai]:
    """A script in place of depthai; nothing pauses."""
    monkeypatch.setattr(time, "sleep", lambda pause_s: None)

    def made(*given: Any, **more: Any) -> ScriptedDepthai:
        script = ScriptedDepthai(*given, **more)
        monkeypatch.setitem(sys.modules, "depthai", script)
        return script

    return made


def test_a_recording_and_its_result_say_what_was_filmed_and_what_depthai_was_told(
    scripted, tmp_path
):
    answers = [answer(k, 0.1 * k) for k in (3, 4, 6)]
    script = scripted(answers, sent=3, video=[picture(k, 0.1 * k) for k in (3, 4, 6)])
    result = run(tmp_path / "out", script)
    assert result == graph.CameraResult(frames=3, lost=1, backwards=0, in_video=3)
    about = read_about(tmp_path / "out")
    assert about.pop("depthai")
    assert about == {
        "source": "script",
        "fps": 60.0,
        "exposure_ms": 2.0,
        "tag_mm": 10.0,
        "apart_mm": None,
        "clock": "trial",
        "family": "36h11",
        "quad_decimate": 2,
        "frames": 3,
        "in_video": 3,
        "lost": 1,
        "backwards": 0,
        "void": None,
    }
    assert script.received == {
        "setRecordVideoFile": tmp_path / "out/camera.mkv",
        "setRecordMetadataFile": tmp_path / "out/camera.mcap",
        "setFps": 60,
        "setRunOnHost": True,
        "setNumThreads": 1,
        "setFamily": "36h11",
        "quadDecimate": 2,
        "setBlocking": True,
    }


def test_answers_that_came_at_once_are_all_written_and_two_tags_of_a_number_are_none(
    scripted, tmp_path
):
    square = (1.5, 2.0, 3.0, 2.25, 3.5, 4.0, 1.0, 4.5)
    tags = [tag(1, *square), tag(0, *square), tag(5, *square), tag(5, *square)]
    answers = [answer(0, 0.001, *tags), answer(1, 0.101, tag(7, *square))]
    video = [picture(0, 0.001), picture(1, 0.101)]
    script = scripted([answers], sent=2, video=video)
    assert run(tmp_path / "out", script).frames == 2
    assert script.waited_s == []
    corners = "1.5,2,3,2.25,3.5,4,1,4.5"
    assert (tmp_path / "out/tags.csv").read_text("utf-8").splitlines() == [
        ",".join(COLUMNS),
        f"0,0.000000,0,{corners}",
        f"0,0.000000,1,{corners}",
        f"1,0.100000,7,{corners}",
    ]


@pytest.mark.parametrize(
    ("in_video", "last_lost", "says"),
    [
        ([0, 1, 2, 3], 0, None),
        ([0, 1, 2], 1, None),
        ([0, 1, 2], 0, "1 of 4 frames are not in the video"),
        ([0, 1], 1, "1 of 4 frames are not in the video"),
        ([0, 2, 3], 1, "1 of 4 frames are not in the video"),
        ([3], 2, "2 of 4 frames are not in the video"),
    ],
)
def test_only_the_last_frames_of_a_camera_may_be_missing_in_the_video(
    scripted, tmp_path, in_video, last_lost, says
):
    video = [picture(k, 0.1 * k) for k in in_video]
    answers = [answer(k, 0.1 * k) for k in range(4)]
    script = scripted(answers, sent=4, last_lost=last_lost, video=video)
    if says is None:
        assert run(tmp_path / "out", script).in_video == len(in_video)
    else:
        with pytest.raises(OutputError, match=says):
            run(tmp_path / "out", script)
    about = read_about(tmp_path / "out")
    assert (about["frames"], about["in_video"]) == (4, len(in_video))
    assert (says is None) == (about["void"] is None)


class Closed(ScriptedDepthai.QueueException):
    pass


@pytest.mark.parametrize(
    ("script", "where", "frames", "steps"),
    [
        # the pipeline stops while frames are sent, and while answers are waited for
        ({"last_lost": 1, "runs": 2}, "script", 3, 3),
        ({"runs": 6}, "depthai", 1, 5),
        # a queue that depthai closed
        ({"answers": [answer(0, 0.0), Closed()]}, "script", 1, 5),
        # a source that fails is answered to its end
        ({"sent": 3, "fails": TransferFailed("full", where="x")}, "x: full", 3, 3),
        ({"last_lost": 1, "sent": 1, "fails": TransferFailed("a")}, "a", 1, 1),
    ],
)
def test_a_run_that_fails_keeps_its_frames_and_says_what_failed(
    scripted, tmp_path, script, where, frames, steps
):
    answers = [answer(k, 0.1 * k) for k in range(5)]
    video = [picture(k, 0.1 * k) for k in range(frames)]
    made = scripted(**({"answers": answers, "sent": 5, "video": video} | script))
    with pytest.raises((DeviceLost, TransferFailed), match=f"^{where}") as error:
        run(tmp_path / "out", made)
    about = read_about(tmp_path / "out")
    assert (about["frames"], about["in_video"], made.stepped) == (frames, frames, steps)
    assert about["void"] == str(error.value)
    assert len(read_tracks(tmp_path / "out").t_s) == frames


def test_a_run_that_is_stopped_sends_no_further_frame_and_waits_for_what_it_sent(
    scripted, tmp_path
):
    answers = [answer(k, 0.1 * k) for k in range(9)]
    video = [picture(k, 0.1 * k) for k in range(9)]
    made = scripted(answers, sent=9, video=video[:2])
    assert run(tmp_path / "out", made, stopped=lambda: made.stepped == 2).frames == 2
    assert len(made.waited_s) == 2


def test_a_run_without_a_frame_and_a_video_that_cannot_be_read_are_errors(
    scripted, tmp_path
):
    with pytest.raises(EmptyRecording, match="script: no frame was recorded"):
        run(tmp_path / "none", scripted([], sent=0))
    assert "no frame was recorded" in read_about(tmp_path / "none")["void"]
    with pytest.raises(OutputError, match=r"mkv: the video was not written \(.*no fr"):
        run(tmp_path / "unread", scripted([answer(0, 0.0)], sent=1))
    other = [picture(0, 0.5)]
    with pytest.raises(OutputError, match=r"not written \(1 frames of the video"):
        run(tmp_path / "other", scripted([answer(0, 0.0)], sent=1, video=other))


@pytest.mark.parametrize(
    "name", ["camera.mkv", "camera.mcap", "tags.csv", "camera.json"]
)
def test_a_folder_with_any_file_of_a_recording_is_left_alone(scripted, tmp_path, name):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("before")
    script = scripted([answer(0, 0.0)], sent=1)
    with pytest.raises(OutputError, match=f"holds {name} already"):
        graph.watch(script, tmp_path / "out", say=print)
    assert [one.read_text() for one in (tmp_path / "out").iterdir()] == ["before"]


# -- a recorded folder, read again


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two frames of a recording; the pictures come from a script."""
    with TagFile(tmp_path) as tags:
        tags.write(7, 0.1, {})
        tags.write(8, 0.2, {})
    for name in ("camera.mkv", "camera.mcap"):
        (tmp_path / name).touch()
    return tmp_path


VIDEO = [picture(7, 0.101), picture(8, 0.201)]


def dai_of(*videos: Sequence[Any]) -> Any:
    """depthai, where each pipeline plays the next of these videos."""
    replays = [ScriptedReplay(video) for video in videos]
    script: Any = ScriptedDepthai([], sent=0)
    waiting = iter(replays)

    def pipeline(createImplicitDevice: bool) -> ScriptedReplay:
        replay = next(waiting)
        replay.received["implicit"] = createImplicitDevice
        return replay

    script.Pipeline = pipeline
    script.replays = replays
    return script


def test_a_video_is_played_once_as_fast_as_it_is_read_with_few_frames_ahead(
    folder, monkeypatch
):
    sizes: list[int] = []

    class Counted(recording.Queue):
        def __init__(self, maxsize: int) -> None:
            sizes.append(maxsize)
            super().__init__(maxsize)

    monkeypatch.setattr(recording, "Queue", Counted)
    dai = dai_of(VIDEO, VIDEO)
    frames = list(read_video(folder, dai))
    assert [(one.sequence, one.end_s) for one in frames] == [(7, 0.101), (8, 0.201)]
    assert frames[1].image.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert [one.image.size for one in read_video(folder, dai, images=False)] == [0, 0]
    assert dai.replays[0].received == {
        "implicit": False,
        "node": "replay",
        "setReplayVideoFile": folder / "camera.mkv",
        "setReplayMetadataFile": folder / "camera.mcap",
        "setOutFrameType": "gray",
        "setLoop": False,
        "setFps": 1000,
        "queue": (1, False),
    }
    assert sizes == [8, 8]


def test_a_video_of_more_frames_than_fit_ahead_comes_whole_and_in_order(folder):
    video = [picture(k, 0.1 * k) for k in range(50)]
    frames = list(read_video(folder, dai_of(video), images=False))
    assert [one.sequence for one in frames] == list(range(50))


def test_a_video_that_breaks_off_gives_its_frames_and_then_the_error(folder):
    broken = picture(8, 0.2)
    broken.getData = lambda: [1, 2]
    found = []
    with pytest.raises(EmptyRecording, match=r"camera\.mkv.*ValueError: cannot resh"):
        found.extend(read_video(folder, dai_of([*VIDEO, broken])))
    assert [one.sequence for one in found] == [7, 8]
    with pytest.raises(EmptyRecording, match=r"cannot be read \(no frame\)"):
        list(read_video(folder, dai_of([])))


@pytest.mark.parametrize("name", ["camera.mkv", "camera.mcap"])
def test_a_folder_without_a_file_of_its_video_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(HoldfastError, match=f"no {name}"):
        next(read_video(folder, dai_of(VIDEO)))


def test_a_video_may_have_fewer_or_far_more_frames_than_lines_and_none_that_is_off(
    tmp_path,
):
    tracks = Tracks(np.arange(4), 0.1 * np.arange(4), {})
    late = [Frame(k, 0.1 * k, NO_IMAGE) for k in range(4, 400)]
    for first in ([], [Frame(2, 0.201, NO_IMAGE)]):
        require_same_stamps(first, tracks, LENS, tmp_path)
    whole = [Frame(k, 0.1 * k + 1e-3, NO_IMAGE) for k in range(4)]
    require_same_stamps([*whole, *late], tracks, LENS, tmp_path)
    with pytest.raises(ColumnError, match="1 frames of the video"):
        require_same_stamps([Frame(2, 0.202, NO_IMAGE)], tracks, LENS, tmp_path)
