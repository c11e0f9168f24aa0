"""Tracks, onset and the camera's page without depthai."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from drawn_frames import (
    FPS,
    process,
    program,
    write_frames,
)
from hand_made_tracks import hand_made
from packages import MAY_IMPORT, ROOT, folder_of, imports_of
from page_tables import filled

from holdfast.cli.main import main
from holdfast.core.errors import (
    CameraUnavailable,
    ColumnError,
    DataNotFound,
    DeviceLost,
    EmptyRecording,
    HoldfastError,
    NotANumber,
    OutputError,
    TimeError,
    TransferFailed,
)
from holdfast.drivers.camera import graph, sources
from holdfast.drivers.camera.recording import (
    COLUMNS,
    TagFile,
    Tracks,
    read_about,
    read_tracks,
    require_same_stamps,
    require_whole,
)
from holdfast.drivers.camera.sources import (
    OAK_ISO,
    QUIET,
    Frame,
    Lens,
    Oak,
    Stored,
    read_frames,
)
from holdfast.simulation.camera_frames import HAND_TAG, OBJECT_TAG, cells
from studies.doc_pictures.tags import sheet


def spoil(path: Path, how: str) -> None:
    stamps_s = np.arange(1, 4) / FPS
    frames = np.zeros((3, 8, 8), dtype=np.uint8)
    if how == "absent":
        return
    if how == "garbage":
        path.write_bytes(b"PK\x03\x04 not frames")
    elif how == "a number missing":
        np.savez(path, frames=frames, time_s=stamps_s, fps=60.0, tag_mm=10.0)
    elif how == "other lengths":
        write_frames(path, stamps_s[:2], frames)
    elif how == "not grey":
        write_frames(path, stamps_s, np.zeros((3, 8, 8, 3), dtype=np.uint8))
    elif how == "backwards":
        write_frames(path, stamps_s[::-1], frames)
    elif how == "cut":
        write_frames(path, stamps_s, frames)
        path.write_bytes(path.read_bytes()[:300])


SPOILT: dict[str, type[HoldfastError]] = {
    "absent": DataNotFound,
    "garbage": EmptyRecording,
    "a number missing": ColumnError,
    "other lengths": EmptyRecording,
    "not grey": EmptyRecording,
    "backwards": TimeError,
    "cut": EmptyRecording,
}


@pytest.mark.parametrize("how", SPOILT)
def test_frames_that_cannot_be_used_are_refused_by_name(tmp_path, how):
    path = tmp_path / "some.frames.npz"
    spoil(path, how)
    with pytest.raises(SPOILT[how], match=r"some\.frames\.npz"):
        read_frames(path)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", ColumnError),
        ("a,b\n", ColumnError),
        ("z,b\n", ColumnError),
        ("HEAD", EmptyRecording),
        ("HEAD0,0.1,0,1,2,3,4,5,6,7,x\n", NotANumber),
        ("HEAD0,0.1,,,,,,,,,\n1,0.2,0\n2,0.3,,,,,,,,,\n", NotANumber),
        ("HEAD0,0.2,,,,,,,,,\n1,0.1,,,,,,,,,\n", TimeError),
    ],
)
def test_tracks_that_cannot_be_used_are_refused(tmp_path, text, error):
    with TagFile(tmp_path):
        pass
    head = (tmp_path / "tags.csv").read_text()
    (tmp_path / "tags.csv").write_text(text.replace("HEAD", head))
    with pytest.raises(error, match=r"tags\.csv"):
        read_tracks(tmp_path)


def test_an_incomplete_last_line_is_left_out_and_no_other(tmp_path):
    with TagFile(tmp_path) as file:
        file.write(0, 0.1, {})
        file.write(1, 0.2, {})
    path = tmp_path / "tags.csv"
    path.write_text(path.read_text() + "2,0.3,")
    assert read_tracks(tmp_path).t_s.tolist() == [0.1, 0.2]


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
        assert main(["onset", str(tmp_path), "--action", "pass"]) == 0
    first, mine = map(json.loads, (tmp_path / "events.jsonl").read_text().splitlines())
    assert first == json.loads(other)
    assert mine["t0_s"] == pytest.approx(0.55, abs=0.003)
    assert (mine["label"], mine["provenance"], mine["by"]) == (
        "safe_slip",
        "camera",
        "holdfast onset",
    )


def test_without_tactile_samples_onset_counts_from_the_first_frame(tmp_path, capsys):
    hand_made(tmp_path, at_s=5000.0, slides_at_s=0.8)
    assert main(["onset", str(tmp_path), "--action", "pull"]) == 0
    assert json.loads((tmp_path / "events.jsonl").read_text())["t0_s"] == pytest.approx(
        0.8, abs=0.003
    )


@pytest.mark.parametrize(
    ("words", "spoils", "code", "says"),
    [
        ((), "", 2, "--action pull|fall"),
        (("--action", "fly"), "", 2, "fly"),
        (("--gross-mm", "0"), "", 2, "not a number above 0"),
        (("--apart-mm", "30"), "", 3, "tags are 30 mm apart, but 20.00 mm"),
        (("--from", "0.9"), "", 3, "never rest"),
        (("--action", "pull"), "tactile.csv", 3, "host_ns"),
        (("--action", "pull"), "events.jsonl", 3, "not a JSON object"),
        (("--action", "pull"), "camera.json", 3, "cannot be used"),
    ],
)
def test_what_onset_cannot_use_is_one_line(tmp_path, capsys, words, spoils, code, says):
    hand_made(tmp_path, at_s=5000.0, slides_at_s=0.8)
    if spoils:
        (tmp_path / spoils).write_text("nonsense\nmore\n")
    assert main(["onset", str(tmp_path), *words]) == code
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert says in err


def test_a_gross_distance_within_what_the_pads_give_is_refused(tmp_path, capsys):
    for name, slides_at_s in (("slid", 0.8), ("held", 1.3)):
        (tmp_path / name).mkdir()
        hand_made(tmp_path / name, at_s=0.0, slides_at_s=slides_at_s)
    words = (
        "onset",
        str(tmp_path / "slid"),
        "--action",
        "pull",
        "--no-slip",
        str(tmp_path / "held"),
    )
    assert main([*words, "--gross-mm", "3"]) == 2
    assert "within the elastic shear" in capsys.readouterr().err
    assert main(words) == 0
    assert (
        json.loads((tmp_path / "slid" / "events.jsonl").read_text())["gross_mm"] > 4.0
    )


def test_an_object_that_stays_gets_no_line_and_needs_no_action(tmp_path, capsys):
    hand_made(tmp_path, at_s=0.0, slides_at_s=None)
    assert main(["onset", str(tmp_path)]) == 0
    assert "no onset" in capsys.readouterr().out
    assert (tmp_path / "events.jsonl").read_text() == ""


def test_an_oak_needs_the_printed_side(tmp_path, capsys):
    assert main(["watch", "--camera", "oak", "--out", str(tmp_path)]) == 2
    assert "--tag-mm" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--tag-mm", "--fps", "--exposure-ms", "--seconds"])
def test_an_option_that_stored_frames_would_ignore_is_refused(option, tmp_path, capsys):
    words = [
        "watch",
        "--camera",
        str(tmp_path / "some.frames.npz"),
        "--out",
        str(tmp_path / "out"),
    ]
    assert main([*words, option, "10"]) == 2
    err = capsys.readouterr().err
    assert f"{option} would be ignored; likely cause: only --camera oak uses it" in err
    assert not (tmp_path / "out").exists()


def test_the_camera_s_clock_is_the_machine_s_and_its_calls_are_in_the_library():
    output = program("""
import time
dai = load_depthai(quiet)
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


def test_the_printed_sheet_holds_both_tags_at_their_size():
    drawn = ElementTree.fromstring(sheet())
    assert (drawn.get("width"), drawn.get("viewBox")) == ("120mm", "0 0 120 50")
    black = [
        {key: float(shape.get(key, 0)) for key in ("x", "y", "width", "height")}
        for shape in drawn
    ][1:]
    left = [shape for shape in black if shape["width"] == 1.25]
    assert len(left) == sum(
        int((cells(tag) == 0).sum()) for tag in (OBJECT_TAG, HAND_TAG)
    )
    assert (
        max(shape["x"] for shape in left if shape["x"] < 30)
        + 1.25
        - min(shape["x"] for shape in left)
        == 10.0
    )


def test_the_page_of_the_camera_is_made_of_what_was_measured(tmp_path):
    numbers = {
        f"{name}_p{q}_ms": 1.25
        for name in ("start", "seen", "gross")
        for q in (5, 50, 95)
    }
    row = {
        "fps": 60.0,
        "mm_per_s2": 42.0,
        "n": 3,
        "found": 2,
        "hidden": 1,
        "start_worst_ms": 7.7,
        "within_10_ms": 1.0,
    }
    made = {
        "ramps": [row | numbers],
        "pulls": [row | numbers],
        "held": [{"n": 5, "onsets": 0}],
    }
    text = filled("docs/camera.md", {"onset": made}, tmp_path)
    assert "| 60 | 42 | 2 of 3 | 1 | 1.2 / 1.2 / 1.2 |" in text


def test_depthai_is_imported_in_one_file_and_by_no_help():
    naming = {
        path: text
        for room in MAY_IMPORT
        for path in folder_of(room).rglob("*.py")
        if "depthai" in (text := path.read_text("utf-8"))
    }
    files = [path for path, text in naming.items() if "depthai" in imports_of(text, "")]
    assert files == [ROOT / "holdfast/drivers/camera/sources.py"]
    code = (
        "import sys; from holdfast.cli import onset, watch; import holdfast.drivers.camera.graph; "
        "print('depthai' in sys.modules)"
    )
    assert process("-c", code).stdout == "False\n"


def test_the_longest_wait_is_longer_than_the_search():
    assert float(QUIET["DEPTHAI_SEARCH_TIMEOUT"]) < 1e3 * sources.LONGEST_WAIT_S


def test_an_oak_exposes_as_the_lens_says_and_ends_when_its_time_is_up(monkeypatch):
    now_s, exposed, linked = [100.0], [], []
    monkeypatch.setattr(sources.time, "monotonic", lambda: now_s[0])
    camera = SimpleNamespace(
        initialControl=SimpleNamespace(
            setManualExposure=lambda *given: exposed.append(given)
        ),
        requestOutput=lambda size, type, fps: SimpleNamespace(link=linked.append),
    )
    created = SimpleNamespace(build=lambda sensorFps: camera)
    dai = SimpleNamespace(
        node=SimpleNamespace(Camera="camera"),
        ImgFrame=SimpleNamespace(Type=SimpleNamespace(GRAY8="gray")),
    )
    pipeline = SimpleNamespace(create=lambda node: created)
    lens = Lens(60.0, 1.5, 12.0, "monotonic")
    goes_on = Oak(lens, seconds=2.0).connect(dai, pipeline, ["first", "second"])
    assert (exposed, linked) == ([(1500, OAK_ISO)], ["first", "second"])
    assert goes_on()
    now_s[0] = 102.0
    assert not goes_on()
    assert Oak(lens).connect(dai, pipeline, [])()


def test_a_frame_without_a_tag_has_a_cell_for_every_column(tmp_path):
    with TagFile(tmp_path) as file:
        file.write(0, 0.0, {HAND_TAG: [0.5] * 8})
        file.write(1, 0.1, {})
    lines = file.path.read_text("utf-8").splitlines()
    assert [line.count(",") for line in lines] == [len(COLUMNS) - 1] * 3


# -- the graph, where depthai does as a script says


def answer(sequence: int, end_s: float) -> Any:
    return SimpleNamespace(
        getSequenceNum=lambda: sequence,
        getTimestamp=lambda: timedelta(seconds=end_s),
        aprilTags=[],
    )


class ScriptedDepthai:
    """depthai as far as the graph calls it, and the source in front of it.

    answers: None where nothing came as long as the graph waits. sizes: of the video's queue.
    """

    class QueueException(Exception):
        pass

    name, void = "script", None
    lens = Lens(60.0, 2.0, 10.0, "trial")

    def __init__(
        self,
        answers: Sequence[Any],
        sent: int,
        sizes: Sequence[int] = (),
        last_lost: int = 0,
    ) -> None:
        self.answers, self.sent, self.sizes = list(answers), sent, list(sizes)
        self.last_lost = last_lost
        self.waited_s: list[float] = []
        self.queue: tuple[int, bool] | None = None
        self.MessageQueue = self
        self.node = SimpleNamespace(RecordVideo="video", AprilTag="tags")
        self.AprilTagConfig = SimpleNamespace(Family=SimpleNamespace(TAG_36H11="36h11"))

    def create(self, node: str) -> Any:
        called = ("VideoFile", "MetadataFile")
        names = [f"setRecord{one}" for one in called] + [
            "setFps",
            "setRunOnHost",
            "setNumThreads",
        ]
        return SimpleNamespace(
            **dict.fromkeys(names, lambda given: None),
            input=SimpleNamespace(
                getSize=lambda: self.sizes.pop(0) if self.sizes else 0
            ),
            inputImage=SimpleNamespace(setBlocking=lambda given: None),
            initialConfig=SimpleNamespace(setFamily=lambda given: None),
            out=SimpleNamespace(createOutputQueue=self.output),
        )

    def output(self, maxSize: int, blocking: bool) -> Any:
        self.queue = (maxSize, blocking)
        return self

    def get(self, wait: timedelta) -> Any:
        self.waited_s.append(wait.total_seconds())
        return self.answers.pop(0) if self.answers else None

    def tryGet(self) -> Any:  # noqa: N802
        return None

    def open(self, dai: Any) -> Any:
        return self

    def connect(self, *given: Any) -> Callable[[], bool]:
        steps = iter([True] * self.sent)
        return lambda: next(steps, False)

    def isRunning(self) -> bool:  # noqa: N802
        return True

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


def test_frames_after_the_last_tag_line_have_no_stamp_and_are_no_error(tmp_path):
    tracks = Tracks(np.array([4]), np.array([0.5]), {})
    image = np.empty((0, 0), np.uint8)
    frames = [Frame(4, 0.501, image), Frame(5, 0.6, image), Frame(6, 0.7, image)]
    require_same_stamps(frames, tracks, ScriptedDepthai.lens, tmp_path)
    late = [Frame(4, 0.6, image), *frames[1:]]
    with pytest.raises(ColumnError, match="3 frames of the video"):
        require_same_stamps(late, tracks, ScriptedDepthai.lens, tmp_path)


@pytest.mark.parametrize("expected", [2, 3, None, "4"])
def test_a_file_is_whole_with_as_many_frames_as_were_counted(tmp_path, expected):
    require_whole(3, expected, tmp_path)
    with pytest.raises(EmptyRecording, match="holds 3 of its 4 frames"):
        require_whole(3, 4, tmp_path)


# -- frames and their lens


@pytest.mark.parametrize(
    ("changed", "fits"),
    [
        ({"fps": 0.5}, False),
        ({"fps": 0.51}, True),
        ({"fps": np.inf}, False),
        ({"exposure_ms": 0.0}, False),
        ({"exposure_ms": 0.01}, True),
        ({"tag_mm": 0.01}, True),
        ({"apart_mm": 0.0}, False),
        ({"apart_mm": 0.01}, True),
        ({"apart_mm": None}, True),
    ],
)
def test_a_lens_has_positive_numbers_and_half_a_frame_a_second(changed, fits):
    numbers = {"fps": 60.0, "exposure_ms": 2.0, "tag_mm": 10.0} | changed
    if not fits:
        with pytest.raises(ValueError, match=r"fps .* apart_mm"):
            Lens.of(numbers, "trial")
        return
    lens = Lens.of(numbers, "trial")
    assert (lens.fps, lens.exposure_ms, lens.tag_mm) == tuple(
        numbers[name] for name in ("fps", "exposure_ms", "tag_mm")
    )
    assert (lens.clock, lens.apart_mm) == ("trial", changed.get("apart_mm"))


@pytest.mark.parametrize(
    ("text", "cause"), [("No Permissions", "udev rule"), ("none", "not plugged in")]
)
def test_a_camera_that_does_not_open_has_the_cause_that_its_library_names(text, cause):
    with pytest.raises(CameraUnavailable, match=rf"no camera \({text}\).*{cause}"):
        Oak(Lens(60.0, 1.5, 12.0, "monotonic")).open(
            SimpleNamespace(Device=lambda: (_ for _ in ()).throw(RuntimeError(text)))
        )


@pytest.mark.parametrize(
    ("refused", "stops_at", "taken"),
    [
        (0, 99, True),
        (3, 99, True),
        (10_001, 10**6, True),
        (10_002, 10**6, False),
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

    monkeypatch.setattr(sources.time, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(sources.time, "sleep", sleep)
    messages = []

    class Closed(Exception):
        pass

    def send(message):
        messages.append(message)
        if len(messages) == 2:
            raise Closed
        return len(messages) > refused

    queue = SimpleNamespace(trySend=send)
    dai = SimpleNamespace(
        MessageQueue=SimpleNamespace(QueueException=Closed),
        ImgFrame=lambda: SimpleNamespace(
            **{
                name: lambda *given: None
                for name in (
                    "setType",
                    "setSize",
                    "setData",
                    "setSequenceNum",
                    "setTimestamp",
                    "setTimestampDevice",
                )
            }
        ),
    )
    dai.ImgFrame.Type = SimpleNamespace(GRAY8="gray")
    made = []
    one = SimpleNamespace(
        createInputQueue=lambda maxSize, blocking: (
            made.append((maxSize, blocking)) or queue
        )
    )
    pipeline = SimpleNamespace(isRunning=lambda: len(pauses) < stops_at)
    frames = [Frame(0, 0.0, np.zeros((2, 4), np.uint8))]
    step = Stored("some", Lens(60.0, 2.0, 10.0, "trial"), frames).connect(
        dai, pipeline, [one]
    )
    assert made == [(4, True)]
    if taken:
        assert step()
        assert not step()
    else:
        with pytest.raises(TransferFailed, match="takes no more frames"):
            step()
    assert set(pauses) <= {0.001}
