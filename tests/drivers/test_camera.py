"""A camera beside the hand, through depthai itself: its own pipeline without a device, only the frames are drawn.

depthai runs in processes of its own: what crashes it fails one test, not the run.
"""

from __future__ import annotations

import http.server
import json
import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from test_house import MAY_IMPORT, imports_by_file

from benchmarks import camera_page
from drivers.camera import sources
from drivers.camera.library import QUIET
from drivers.camera.recording import TagFile, Tracks, read_about, read_tracks, write_about
from drivers.camera.sources import LENS, read_frames
from edge_runtime.contract import FloatArray
from edge_runtime.errors import ColumnError, DataNotFound, EmptyRecording, HoldfastError, NotANumber, TimeError
from holdfast.cli import main
from simulation.camera.apriltag import cells
from simulation.camera.frames import AWAY_SIDES, CAMERA, GREY, HAND_TAG, OBJECT_TAG, Camera, Frames
from training.timeline import read_truth

ROOT = Path(__file__).resolve().parents[2]
SIZE = {"width_px": 320.0, "height_px": 240.0}
FPS, N_FRAMES = 60.0, 90
COVERED, TWICE = range(60, 66), range(70, 72)
CARD = """
[record]
rate_hz = 150
[[trials]]
objects = ["soft-ball"]
action = "pull"
style = "author"
hold_s = 1.5
close_at_s = 0.3
tail_s = 0.2
[[trials]]
objects = ["basket-ball"]
action = "hold"
style = "author"
hold_s = 1.0
close_at_s = 0.3
tail_s = 0.2
load_n = 1.0
[effects.brush]
count = 5
[effects.camera_frames]
[camera]
width_px = 240
height_px = 160
noise_levels = 2
"""


def camera(**said: float) -> Camera:
    return Camera(**({name: told.default for name, told in CAMERA.items()} | SIZE | said))


def command(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own; what the machine says about depthai is not heard."""
    return process("-m", "holdfast", *map(str, words), environment=environment)


def process(
    *words: str, file_limit: int | None = None, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    def limit() -> None:
        if file_limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_limit, file_limit))

    plain = {key: value for key, value in os.environ.items() if key not in QUIET and not key.startswith("DEPTHAI_")}
    told = plain | dict(environment or {})
    return subprocess.run(
        [sys.executable, *words], cwd=ROOT, env=told, capture_output=True, text=True, check=False, preexec_fn=limit
    )


def program(text: str, *words: object) -> dict[str, Any]:
    """What a program prints as its last line, which is JSON."""
    done = process("-c", PRELUDE + text, *map(str, words))
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout.splitlines()[-1]))


PRELUDE = """
import json, os, signal, sys
from pathlib import Path
from typing import Any
import numpy as np
from drivers.camera.graph import watch
from drivers.camera.library import load_depthai
from drivers.camera.recording import read_about, read_recorded, read_tracks, read_video
from drivers.camera.sources import Frame, Lens, Stored, read_frames
from edge_runtime.errors import DeviceLost, HoldfastError
quiet = lambda line: None
"""


def motion_m(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """[T, 3] of object in the hand and of the hand: it sways, and lets the object slide from 0.5 s on."""
    thing, hand = np.zeros((len(t_s), 3)), np.zeros((len(t_s), 3))
    thing[:, 2] = -0.015 * np.maximum(t_s - 0.5, 0.0) ** 2
    hand[:, 0], hand[:, 2] = 2e-3 * np.sin(5.0 * t_s), 1e-3 * np.sin(3.0 * t_s)
    return thing, hand


def write_frames(path: Path, stamps_s: FloatArray, frames: Frames, **said: float) -> Path:
    numbers: dict[str, Any] = {"fps": FPS, "exposure_ms": 2.0, "tag_mm": 10.0} | said
    np.savez(path, frames=frames, time_s=stamps_s, **numbers)
    return path


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FloatArray, Frames]:
    """Frames of a known motion; the hand's tag is covered for a while, and the object's seen twice for a while."""
    t_s = np.arange(N_FRAMES + 1) / FPS
    stamps_s, frames = camera().film(t_s, *motion_m(t_s), np.random.default_rng(0))
    for k in COVERED:
        frames[k, :, 90:150] = GREY
    for k in TWICE:
        frames[k, 10:80, 10:80] = frames[k, 113:183, 165:235]
    return write_frames(tmp_path_factory.mktemp("drawn") / "known.frames.npz", stamps_s, frames), stamps_s, frames


@pytest.fixture(scope="module")
def recorded(drawn: tuple[Path, FloatArray, Frames], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that watching them leaves. Read only."""
    out = tmp_path_factory.mktemp("recorded") / "trial"
    done = command("watch", "--camera", drawn[0], "--out", out)
    assert done.returncode == 0, done.stderr
    assert f"{N_FRAMES} frames with tags read, {N_FRAMES} in the video, 0 lost" in done.stdout
    return out


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pull and a loaded hold, simulated with their frames."""
    folder = tmp_path_factory.mktemp("filmed")
    (folder / "card.toml").write_text(CARD, encoding="utf-8")
    assert main(["simulate", str(folder / "card.toml"), "--out", str(folder / "set"), "--seed", "1"]) == 0
    return folder / "set"


# -- tracks and video


def test_drawn_tags_of_known_motion_are_tracked_to_a_twentieth_of_a_pixel(recorded):
    tracks = read_tracks(recorded)
    fine_s = np.arange(N_FRAMES + 1) / FPS
    thing, hand = (CubicSpline(fine_s, 1e3 * path)(tracks.t_s) for path in motion_m(fine_s))
    for tag, moved_mm in ((OBJECT_TAG, thing + hand), (HAND_TAG, hand)):
        true_px = np.array([camera().centre_px(tag, at[[0, 2]]) for at in moved_mm])
        error_px = tracks.of(tag).mean(axis=1) - true_px
        error_px = error_px[np.isfinite(error_px[:, 0])]
        assert len(error_px) > 80
        assert np.sqrt((error_px**2).mean()) < 0.05


def test_a_covered_tag_and_one_seen_twice_are_gaps(recorded):
    tracks = read_tracks(recorded)
    hidden = {tag: np.flatnonzero(np.isnan(tracks.of(tag)[:, 0, 0])).tolist() for tag in (OBJECT_TAG, HAND_TAG)}
    assert hidden == {OBJECT_TAG: list(TWICE), HAND_TAG: list(COVERED)}


def test_stamps_are_the_middle_of_the_exposure(drawn, recorded):
    np.testing.assert_allclose(read_tracks(recorded).t_s, drawn[1] - 1e-3, atol=1.1e-6)


def test_a_recording_holds_every_frame_bit_for_bit_and_its_stamps(drawn, recorded):
    told = program(
        """
frames, shots = list(read_video(Path(sys.argv[1]), load_depthai(quiet))), np.load(sys.argv[2])
off = [abs(f.end_s - t) for f, t in zip(frames, shots["time_s"])]
same = len(frames) == len(shots["frames"]) and all((f.image == i).all() for f, i in zip(frames, shots["frames"]))
in_order = [f.sequence for f in frames] == list(range(len(off)))
print(json.dumps({"same": bool(same), "off_s": max(off), "in_order": in_order}))
""",
        recorded,
        drawn[0],
    )
    assert told == {"same": True, "off_s": pytest.approx(0.0, abs=1e-6), "in_order": True}


def test_a_video_is_written_by_one_thread_and_none_waits_busily_beside_a_hand(tmp_path):
    told = program(
        """
names = []
def looked_at():
    for k in range(20):
        names[:] = [path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")]
        yield Frame(k, k / 60.0, np.zeros((400, 640), dtype=np.uint8))
watch(Stored("drawn", Lens(60.0, 2.0, 10.0, "trial"), looked_at()), Path(sys.argv[1]), say=quiet)
print(json.dumps({"writers": sum(name.startswith("RecordVideo") for name in names)}))
""",
        tmp_path,
    )
    assert told == {"writers": 1}


def test_a_video_is_read_and_counted_without_being_held_in_memory(recorded):
    told = program(
        """
import tracemalloc
dai = load_depthai(quiet)
tracemalloc.start()
frames = list(read_video(Path(sys.argv[1]), dai, images=False))
held = tracemalloc.get_traced_memory()[0]
tracemalloc.reset_peak()
for frame in read_video(Path(sys.argv[1]), dai):
    one = frame.image.nbytes
most = tracemalloc.get_traced_memory()[1]
print(json.dumps({"frames": len(frames), "held": held, "one": one, "most": most}))
""",
        recorded,
    )
    assert told["frames"] == N_FRAMES
    assert told["held"] < told["one"]
    assert told["most"] < 15 * told["one"]


def test_a_video_that_is_read_slowly_or_left_early_loses_no_frame_and_hangs_nobody(recorded):
    told = program(
        """
import faulthandler, time
faulthandler.dump_traceback_later(60, exit=True)
dai, folder = load_depthai(quiet), Path(sys.argv[1])
def busy(for_s):
    until_s = time.monotonic() + for_s
    while time.monotonic() < until_s:
        pass
for taken in range(1, 11):
    frames = read_video(folder, dai)
    early = [next(frames).sequence for _ in range(taken)]
    busy(0.1)
    frames.close()
    assert early == list(range(taken))
slowly = []
for frame in read_video(folder, dai):
    slowly.append(frame.sequence)
    busy(0.02)
print(json.dumps({"slowly": slowly}))
""",
        recorded,
    )
    assert told["slowly"] == list(range(N_FRAMES))


def test_a_recorded_folder_through_the_graph_gives_the_same_tracks_to_the_last_digit(recorded, tmp_path):
    done = command("watch", "--camera", recorded, "--out", tmp_path / "again")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "again/tags.csv").read_bytes() == (recorded / "tags.csv").read_bytes()


def test_what_was_recorded_is_told_beside_it(recorded):
    about = read_about(recorded)
    numbers = {"fps": FPS, "exposure_ms": 2.0, "tag_mm": 10.0, "quad_decimate": 2, "frames": N_FRAMES}
    assert about.items() >= (numbers | {"in_video": N_FRAMES, "lost": 0, "void": None, "clock": "trial"}).items()


def test_nothing_recorded_is_written_over(drawn, recorded):
    before = {path.name: path.read_bytes() for path in recorded.iterdir()}
    done = command("watch", "--camera", drawn[0], "--out", recorded)
    assert (done.returncode, "holds camera.mkv already" in done.stderr) == (5, True)
    assert {path.name: path.read_bytes() for path in recorded.iterdir()} == before


def test_a_tag_smeared_over_one_cell_is_seen_and_over_two_is_lost(tmp_path):
    told = program(
        """
from simulation.camera.frames import CAMERA, Camera
one = Camera(**{name: told.default for name, told in CAMERA.items()} | {"width_px": 240.0, "height_px": 160.0})
seen = []
for smear_mm in (1.25, 2.5):
    at = [np.array([0.1 * k, smear_mm * s]) for k in range(9) for s in np.arange(0.0, 1.0, 0.05)]
    drawn = [one.draw(one_mm, np.zeros(2)) for one_mm in at]
    images = np.rint(np.reshape(drawn, (9, 20, 160, 240)).mean(axis=1)).astype(np.uint8)
    out = Path(sys.argv[1]) / str(smear_mm)
    frames = [Frame(k, k / 60, image) for k, image in enumerate(images)]
    watch(Stored("smeared", Lens(60.0, 2.0, 10.0, "trial"), frames), out, say=quiet)
    seen.append(int(np.isfinite(read_tracks(out).of(0)[:, 0, 0]).sum()))
print(json.dumps({"seen": seen}))
""",
        tmp_path,
    )
    assert told == {"seen": [9, 0]}


def test_frames_that_never_came_are_counted(drawn, tmp_path):
    told = program(
        """
source = read_frames(Path(sys.argv[1]))
kept = [f for f in source.frames if f.sequence not in (10, 11, 40)][:60]
print(json.dumps(vars(watch(Stored("some", source.lens, kept), Path(sys.argv[2]), say=quiet))))
""",
        drawn[0],
        tmp_path / "out",
    )
    assert told == {"frames": 60, "lost": 3, "backwards": 0, "in_video": 60}


# -- onset, from frames to the label


def test_the_fitted_onset_of_author_pulls_is_within_ten_ms_of_the_first_sliding():
    told = program("from benchmarks.onset import pulls; print(json.dumps(pulls(6, [60.0])[0]))")
    assert told["n"] == told["found"] + told["hidden"] == 6
    assert told["found"] >= 5, "one of them is out of the picture two frames after it begins to slide"
    assert told["start_worst_ms"] < 10.0
    assert abs(told["gross_p50_ms"]) < 3.0


def test_onset_writes_a_label_of_the_camera_s_beside_the_trial_and_leaves_its_truth_alone(filmed):
    trial = filmed / "soft-ball/pull/trial_1.csv"
    truth = trial.with_suffix(".truth.json").read_bytes()
    done = command("onset", trial)
    assert done.returncode == 0, done.stderr
    assert trial.with_suffix(".truth.json").read_bytes() == truth
    (phase,) = json.loads(trial.with_suffix(".onset.json").read_text("utf-8"))["phases"]
    assert (phase["label"], phase["provenance"], phase["by"]) == ("risky_slip", "camera", "holdfast onset")
    assert phase["t0_s"] == phase["onset_s"] < phase["gross_s"] < phase["t1_s"]
    assert phase["onset_s"] == pytest.approx(json.loads(truth)["incipient_slip_s"], abs=0.025)
    t_s = np.loadtxt(trial, delimiter=",", skiprows=1, usecols=0)
    (read,) = read_truth(trial.with_suffix(".onset.json"), t_s)
    assert t_s[read.first - 1] < phase["t0_s"] <= t_s[read.first]


def test_a_loaded_hold_has_no_onset_and_sets_the_gross_distance_above_its_shear(filmed):
    held, pull = filmed / "basket-ball/hold/trial_1.csv", filmed / "soft-ball/pull/trial_1.csv"
    opens_s = json.loads(held.with_suffix(".truth.json").read_text("utf-8"))["phases"][-2]["t0_s"]
    done = command("onset", held, "--until", opens_s)
    assert done.returncode == 0, done.stderr
    assert "no onset: nothing moved by 2.00 mm" in done.stdout
    told = json.loads(held.with_suffix(".onset.json").read_text("utf-8"))
    assert (told["phases"], told["pad_shear"]) == ([], "not measured")
    assert command("onset", pull, "--no-slip", held).returncode == 0
    assert json.loads(pull.with_suffix(".onset.json").read_text("utf-8"))["pad_shear"] == "measured"


def two_sizes(path: Path, n: int = 30) -> Path:
    """Frames of the object's tag at 10 mm and the hand's at 8, both said to be 10."""
    stamps_s = np.arange(1, n + 1) / FPS
    away = np.array([1e4, 0.0])
    both = camera().draw(np.zeros(2), away) + camera(tag_mm=8.0).draw(away, np.zeros(2)) - GREY
    frames = np.repeat(np.rint(both).astype(np.uint8)[None], len(stamps_s), axis=0)
    return write_frames(path, stamps_s, frames)


def test_a_tag_printed_in_another_size_is_refused_by_its_size(tmp_path):
    path = two_sizes(tmp_path / "trial_1.frames.npz")
    done = command("onset", path, "--action", "pull")
    assert done.returncode == 3
    assert "TagError" in done.stderr
    assert "if the hand's tag is 10 mm, the object's is 12.5" in done.stderr
    assert not (tmp_path / "trial_1.onset.json").exists()


def test_tags_of_two_sizes_are_told_as_soon_as_they_were_watched_and_what_was_watched_is_kept(tmp_path):
    done = command("watch", "--camera", two_sizes(tmp_path / "some.frames.npz"), "--out", tmp_path / "out")
    assert done.returncode == 3
    assert [line for line in done.stderr.splitlines() if "TagError" in line and "12.5" in line]
    assert read_about(tmp_path / "out")["void"] is None
    assert len(read_tracks(tmp_path / "out").t_s) == 30
    assert (tmp_path / "out/camera.mkv").stat().st_size > 0


def test_a_measured_distance_finds_two_tags_that_a_printer_scaled_alike_and_stays_with_the_recording(drawn, tmp_path):
    apart_mm = 2.0 * AWAY_SIDES * 10.0
    for name, factor, code in (("right", 1.0, 0), ("wrong", 0.92, 3)):
        out = tmp_path / name
        done = command("watch", "--camera", drawn[0], "--out", out, "--apart-mm", f"{factor * apart_mm:g}")
        assert done.returncode == code, done.stderr
        assert read_about(out)["apart_mm"] == pytest.approx(factor * apart_mm)
        again = command("onset", out, "--action", "pull")
        assert ("TagError" in done.stderr, "TagError" in again.stderr) == (code == 3, code == 3)
    assert "printed at 92 % of that size" in done.stderr


@pytest.mark.parametrize("side", ["0.00996", "0.996", "996", "0", "nan", "one"])
def test_a_printed_side_that_is_no_millimetre_is_a_usage_error(tmp_path, capsys, side):
    for words in (("watch", "--camera", "oak"), ("record", "--source", "x", "--person", "p01"), ("onset",)):
        out = ("--out", str(tmp_path / "new")) if words != ("onset",) else (str(tmp_path),)
        assert main([*words, *out, "--tag-mm", side]) == 2
        err = capsys.readouterr().err
        assert "--tag-mm" in err
        assert err.count("\n") == 1
    assert not (tmp_path / "new").exists()


# -- what goes wrong


def test_without_a_camera_there_is_one_error_and_nothing_is_left(tmp_path):
    done = command("watch", "--camera", "oak", "--tag-mm", "10", "--out", tmp_path / "out")
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert (done.returncode, len(errors)) == (6, 1), done.stderr
    assert all(word in errors[0] for word in ("CameraUnavailable", "oak", "likely cause", "next:"))
    assert not (tmp_path / "out").exists()


def test_the_search_for_a_camera_is_short_and_every_setting_is_in_force_before_the_import():
    told = program("""
lines = []
load_depthai(lines.append)
load_depthai(lines.append)
from drivers.camera.library import QUIET
print(json.dumps({"set": {name: os.environ[name] for name in QUIET}, "lines": lines}))
""")
    assert told["set"] == QUIET
    assert QUIET["DEPTHAI_SEARCH_TIMEOUT"] == "1500"
    assert QUIET["DEPTHAI_PROTOCOL"] == "usb"
    (line,) = told["lines"]
    assert "usage data" in line


def test_what_the_user_has_set_stays_and_is_told(tmp_path):
    words = ("watch", "--camera", "oak", "--tag-mm", "10", "--out", tmp_path / "out")
    done = command(*words, DEPTHAI_SEARCH_TIMEOUT="100")
    assert "left as you set it: DEPTHAI_SEARCH_TIMEOUT=100" in done.stderr


def test_without_depthai_the_error_names_the_extra(tmp_path):
    code = f"import sys; sys.modules['depthai'] = None; from holdfast.cli import main; sys.exit(main({WORDS!r}))"
    done = process("-c", code.replace("OUT", str(tmp_path / "out")))
    assert (done.returncode, "LibraryMissing" in done.stderr, "holdfast[camera]" in done.stderr) == (6, True, True)


WORDS = ["watch", "--camera", "oak", "--tag-mm", "10", "--out", "OUT"]


@pytest.fixture
def collector() -> Iterator[tuple[str, list[str]]]:
    """The address of a server on this machine, and what was sent to it."""
    heard: list[str] = []

    class Collector(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            heard.append(self.rfile.read(int(self.headers.get("content-length", 0))).decode("utf-8", "replace"))
            self.send_response(200)
            self.end_headers()

        do_GET = do_POST  # noqa: N815

        def log_message(self, *args: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Collector) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/", heard
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("telemetry", [{}, {"DEPTHAI_TELEMETRY": "1"}])
def test_nothing_is_sent_unless_the_user_asked_for_it(drawn, collector, tmp_path, telemetry):
    address, heard = collector
    words = ("watch", "--camera", drawn[0], "--out", tmp_path / "out")
    done = command(*words, DEPTHAI_TELEMETRY_URL=address, HOME=str(tmp_path), **telemetry)
    assert done.returncode == 0, done.stderr
    assert bool(heard) == bool(telemetry)
    assert telemetry or not [path for path in (tmp_path / ".cache").rglob("*") if path.is_file()]


def test_a_source_that_ends_early_keeps_what_was_recorded_and_says_so(drawn, tmp_path):
    told = program(
        """
source = read_frames(Path(sys.argv[1]))
def unplugged():
    for frame in source.frames:
        if frame.sequence == 50:
            raise DeviceLost("no longer on USB", where="oak")
        yield frame
try:
    watch(Stored("oak", source.lens, unplugged()), Path(sys.argv[2]), say=quiet)
except HoldfastError as error:
    video = list(read_video(Path(sys.argv[2]), load_depthai(quiet)))
    print(json.dumps({"error": type(error).__name__, "video": len(video)}))
""",
        drawn[0],
        tmp_path / "out",
    )
    assert told == {"error": "DeviceLost", "video": 50}
    assert len(read_tracks(tmp_path / "out").t_s) == 50
    assert "no longer on USB" in read_about(tmp_path / "out")["void"]


def test_a_void_trial_gets_no_label(recorded, tmp_path, capsys):
    for path in recorded.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    write_about(tmp_path, read_about(recorded) | {"void": "no longer on USB"})
    assert main(["onset", str(tmp_path), "--action", "pull"]) == 3
    assert "void" in capsys.readouterr().err
    assert not (tmp_path / "events.jsonl").exists()


def test_a_killed_recording_keeps_its_tracks_and_is_void(drawn, tmp_path):
    done = process(
        "-c",
        PRELUDE
        + """
source = read_frames(Path(sys.argv[1]))
def killed():
    for frame in source.frames:
        if frame.sequence == 60:
            os.kill(os.getpid(), signal.SIGKILL)
        yield frame
watch(Stored("drawn", source.lens, killed()), Path(sys.argv[2]), say=quiet)
""",
        str(drawn[0]),
        str(tmp_path),
    )
    assert done.returncode == -signal.SIGKILL
    assert 40 <= len(read_tracks(tmp_path).t_s) <= 60
    assert read_about(tmp_path)["void"] == "interrupted"


@pytest.mark.parametrize("limit", [60_000, 4_000])
def test_a_full_disk_is_an_error_though_depthai_says_nothing(drawn, tmp_path, limit):
    done = process("-m", "holdfast", "watch", "--camera", str(drawn[0]), "--out", str(tmp_path), file_limit=limit)
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert (done.returncode, len(errors)) == (5, 1), done.stderr
    assert "OutputError" in errors[0]
    assert "full disk" in errors[0]
    assert read_about(tmp_path)["void"]
    assert len(read_tracks(tmp_path).t_s) > 10


READ = """
try:
    print(json.dumps({"frames": len(list(read_recorded(Path(sys.argv[1]), load_depthai(quiet)).frames))}))
except HoldfastError as error:
    print(json.dumps({"error": type(error).__name__, "what": error.what}))
"""


def cut(recorded: Path, folder: Path, name: str, share: float) -> None:
    """A copy of a recording, one file of it cut off."""
    for path in recorded.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    (folder / name).write_bytes((folder / name).read_bytes()[: int(share * (folder / name).stat().st_size)])


@pytest.mark.parametrize(("name", "share"), [("camera.mkv", 0.0), ("camera.mcap", 0.0), ("tags.csv", 0.5)])
def test_a_recording_cut_off_is_refused(recorded, tmp_path, name, share):
    cut(recorded, tmp_path, name, share)
    assert program(READ, tmp_path)["error"] == ("ColumnError" if name == "camera.mcap" else "EmptyRecording")


def test_half_a_video_is_refused_where_it_was_whole_once_and_read_as_far_as_it_goes_where_a_kill_ended_it(
    recorded, tmp_path
):
    cut(recorded, tmp_path, "camera.mkv", 0.5)
    told = program(READ, tmp_path)
    assert told["error"] == "EmptyRecording"
    assert f"of its {N_FRAMES} frames" in told["what"]
    write_about(tmp_path, read_about(tmp_path) | {"frames": 0, "in_video": 0})
    assert 30 < program(READ, tmp_path)["frames"] < N_FRAMES


def test_half_the_tracks_are_no_whole_trial_in_which_nothing_slips(recorded, tmp_path, capsys):
    cut(recorded, tmp_path, "tags.csv", 0.4)
    assert main(["onset", str(tmp_path), "--action", "pull"]) == 3
    assert f"of its {N_FRAMES} frames" in capsys.readouterr().err
    assert not (tmp_path / "events.jsonl").exists()


def test_a_video_of_another_time_gives_a_trial_no_onset(tmp_path, capsys):
    hand_made(tmp_path, at_s=4000.0, slides_at_s=0.8)
    (tmp_path / "tactile.csv").write_text("Time,X1,Y1,Z1,host_ns\n0.0,0,0,0,5000250000000\n")
    assert main(["onset", str(tmp_path), "--action", "pull"]) == 3
    assert "another time" in capsys.readouterr().err
    assert not (tmp_path / "events.jsonl").exists()


@pytest.mark.parametrize("size", [(159, 240), (160, 239)])
def test_frames_that_no_video_holds_without_loss_are_refused(tmp_path, size):
    path = write_frames(tmp_path / "odd.frames.npz", np.arange(3) / FPS, np.zeros((3, *size), dtype=np.uint8))
    done = command("watch", "--camera", path, "--out", tmp_path / "out")
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert (done.returncode, len(errors)) == (3, 1), done.stderr
    assert f"{size[1]} x {size[0]} pixels" in errors[0]
    assert read_about(tmp_path / "out")["void"]


@pytest.mark.parametrize(
    ("name", "number"), [("fps", np.nan), ("fps", -60.0), ("fps", 0.3), ("tag_mm", 0.0), ("exposure_ms", -2.0)]
)
def test_a_lens_that_cannot_be_is_refused_in_frames_and_in_folders(tmp_path, name, number):
    said = {name: number}
    path = write_frames(tmp_path / "some.frames.npz", np.arange(3) / FPS, np.zeros((3, 8, 8), dtype=np.uint8), **said)
    with pytest.raises(EmptyRecording, match=r"some\.frames\.npz"):
        read_frames(path)
    write_about(tmp_path, {"fps": FPS, "exposure_ms": 2.0, "tag_mm": 10.0, "clock": "trial"} | said)
    with pytest.raises(NotANumber, match=r"camera\.json"):
        read_about(tmp_path)


def test_stamps_may_begin_before_zero(tmp_path):
    stamps_s = np.arange(5) / FPS - 30.0
    path = write_frames(tmp_path / "early.frames.npz", stamps_s, np.zeros((5, 64, 64), dtype=np.uint8))
    done = command("watch", "--camera", path, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(read_tracks(tmp_path / "out").t_s, stamps_s - 1e-3, atol=1.1e-6)


# -- the rest needs no depthai


def spoil(path: Path, how: str) -> None:
    stamps_s, frames = np.arange(1, 4) / FPS, np.zeros((3, 8, 8), dtype=np.uint8)
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
    "absent": DataNotFound, "garbage": EmptyRecording, "a number missing": ColumnError,
    "other lengths": EmptyRecording, "not grey": EmptyRecording, "backwards": TimeError, "cut": EmptyRecording,
}  # fmt: skip


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
        ("HEAD", EmptyRecording),
        ("HEAD0,0.1,0,1,2,3,4,5,6,7,x\n", NotANumber),
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


def hand_made(folder: Path, *, at_s: float, slides_at_s: float | None) -> Tracks:
    """Tracks on the machine's clock, with an object that slides 300 mm/s^2; no video."""
    t_s = np.arange(0, 90) / FPS
    with TagFile(folder) as file:
        for k, now_s in enumerate(t_s):
            down_px = 0.0 if slides_at_s is None else 600.0 * max(0.0, now_s - slides_at_s) ** 2
            places = {0: (180.0, 100.0 + down_px), 1: (100.0, 100.0)}
            square = {tag: [x + dx for x, dx in zip(at * 4, SIDES, strict=True)] for tag, at in places.items()}
            file.write(k, at_s + float(now_s), square)
    about: dict[str, object] = dict(zip(LENS, (FPS, 2.0, 10.0), strict=True))
    write_about(folder, about | {"clock": "monotonic", "void": None})
    return read_tracks(folder)


SIDES = [-20.0, -20.0, 20.0, -20.0, 20.0, 20.0, -20.0, 20.0]


def test_onset_counts_from_the_first_tactile_sample_and_leaves_other_events_alone(tmp_path, capsys):
    hand_made(tmp_path, at_s=5000.0, slides_at_s=0.8)
    (tmp_path / "tactile.csv").write_text("Time,X1,Y1,Z1,host_ns\n0.0,0,0,0,5000250000000\n")
    other = json.dumps({"t0_s": 0.1, "t1_s": 0.2, "label": "grasp", "provenance": "person"})
    (tmp_path / "events.jsonl").write_text(other + "\n")
    for _ in range(2):
        assert main(["onset", str(tmp_path), "--action", "pass"]) == 0
    first, mine = map(json.loads, (tmp_path / "events.jsonl").read_text().splitlines())
    assert first == json.loads(other)
    assert mine["t0_s"] == pytest.approx(0.55, abs=0.003)
    assert (mine["label"], mine["provenance"], mine["by"]) == ("safe_slip", "camera", "holdfast onset")


def test_without_tactile_samples_onset_counts_from_the_first_frame(tmp_path, capsys):
    hand_made(tmp_path, at_s=5000.0, slides_at_s=0.8)
    assert main(["onset", str(tmp_path), "--action", "pull"]) == 0
    assert json.loads((tmp_path / "events.jsonl").read_text())["t0_s"] == pytest.approx(0.8, abs=0.003)


@pytest.mark.parametrize(
    ("words", "spoils", "code", "says"),
    [
        ((), "", 2, "--action pull|fall"),
        (("--action", "fly"), "", 2, "fly"),
        (("--gross-mm", "0"), "", 2, "not a number above 0"),
        (("--apart-mm", "30"), "", 3, "tags are 30 mm apart, and 20.00 mm"),
        (("--from", "0.9"), "", 3, "never rest"),
        (("--action", "pull"), "tactile.csv", 3, "host_ns"),
        (("--action", "pull"), "events.jsonl", 3, "no JSON object"),
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
    words = ("onset", str(tmp_path / "slid"), "--action", "pull", "--no-slip", str(tmp_path / "held"))
    assert main([*words, "--gross-mm", "3"]) == 2
    assert "within the elastic shear" in capsys.readouterr().err
    assert main(words) == 0
    assert json.loads((tmp_path / "slid" / "events.jsonl").read_text())["gross_mm"] > 4.0


def test_an_object_that_stays_gets_no_line_and_needs_no_action(tmp_path, capsys):
    hand_made(tmp_path, at_s=0.0, slides_at_s=None)
    assert main(["onset", str(tmp_path)]) == 0
    assert "no onset" in capsys.readouterr().out
    assert (tmp_path / "events.jsonl").read_text() == ""


def test_an_oak_needs_the_printed_side(tmp_path, capsys):
    assert main(["watch", "--camera", "oak", "--out", str(tmp_path)]) == 2
    assert "--tag-mm" in capsys.readouterr().err


def test_the_camera_s_clock_is_the_machine_s_and_its_calls_are_in_the_library():
    told = program("""
import time
dai = load_depthai(quiet)
before, middle, after = time.monotonic(), dai.Clock.now().total_seconds(), time.monotonic()
names = [(dai.Device, "setMaxReconnectionAttempts"), (dai.Device, "close"), (dai.Pipeline, "setStopOnDeviceLoss"),
         (dai.node.Camera, "build"), (dai.node.Camera, "requestOutput"), (dai.node.Camera, "initialControl"),
         (dai.CameraControl, "setManualExposure"), (dai.Node.Output, "link")]
between = before - 2e-6 <= middle <= after + 2e-6
print(json.dumps({"between": between, "lacks": [name for one, name in names if not hasattr(one, name)]}))
""")
    assert told == {"between": True, "lacks": []}


def test_the_printed_sheet_holds_both_tags_at_their_size():
    sheet = ElementTree.fromstring(camera_page.sheet())
    assert (sheet.get("width"), sheet.get("viewBox")) == ("120mm", "0 0 120 50")
    black = [{key: float(shape.get(key, 0)) for key in ("x", "y", "width", "height")} for shape in sheet][1:]
    left = [shape for shape in black if shape["width"] == 1.25]
    assert len(left) == sum(int((cells(tag) == 0).sum()) for tag in (OBJECT_TAG, HAND_TAG))
    assert max(shape["x"] for shape in left if shape["x"] < 30) + 1.25 - min(shape["x"] for shape in left) == 10.0


def test_the_page_of_the_camera_is_made_of_what_was_measured():
    numbers = {f"{name}_p{q}_ms": 1.25 for name in ("start", "seen", "gross") for q in (5, 50, 95)}
    row = {"fps": 60.0, "mm_per_s2": 42.0, "n": 3, "found": 2, "hidden": 1, "start_worst_ms": 7.7, "within_10_ms": 1.0}
    page = camera_page.page({"ramps": [row | numbers], "pulls": [row | numbers], "held": [{"n": 5, "onsets": 0}]})
    assert "| 60 | 42 | 3 | 2 | 1 | 1.2 / 1.2 / 1.2 |" in page
    assert "simulated" in page


def test_depthai_is_imported_in_one_file_and_by_no_help():
    files = {file for room in MAY_IMPORT for file, names in imports_by_file(room).items() if "depthai" in names}
    assert files == {"drivers/camera/library.py"}
    code = "import sys; from holdfast import onset, watch; import drivers.camera.graph; print('depthai' in sys.modules)"
    assert process("-c", code).stdout == "False\n"


def test_the_longest_wait_is_longer_than_the_search():
    assert float(QUIET["DEPTHAI_SEARCH_TIMEOUT"]) < 1e3 * sources.LONGEST_WAIT_S
