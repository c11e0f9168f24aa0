"""A camera when something fails: none there, a stream or a video that ends early, a full disk, a
bad lens."""

from __future__ import annotations

import http.server
import json
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from drawn_frames import FPS, N_FRAMES, PRELUDE, fresh_command, process, program
from hand_made_tracks import hand_made

from holdfast.cli.main import main
from holdfast.core.errors import NotANumber
from holdfast.drivers.camera.graph import QUIET
from holdfast.drivers.camera.recording import read_about, read_tracks, write_about


def test_every_setting_of_depthai_is_made_before_its_import_but_for_those_of_the_user():
    text = """
load_depthai()
from holdfast.drivers.camera.graph import QUIET
print(json.dumps({name: os.environ[name] for name in QUIET}))
"""
    done = process("-c", PRELUDE + text, environment={"DEPTHAI_SEARCH_TIMEOUT": "100"})
    assert json.loads(done.stdout) == QUIET | {"DEPTHAI_SEARCH_TIMEOUT": "100"}


def test_without_depthai_the_error_names_the_extra(tmp_path):
    code = (
        "import sys; sys.modules['depthai'] = None; from holdfast.cli.main import main; "
        f"sys.exit(main({WORDS!r}))"
    )
    done = process("-c", code.replace("OUT", str(tmp_path / "out")))
    assert (
        done.returncode,
        "LibraryMissing" in done.stderr,
        "holdfast[camera]" in done.stderr,
    ) == (6, True, True)


WORDS = ["watch", "--camera", "oak", "--tag-mm", "10", "--out", "OUT"]


@pytest.fixture
def collector() -> Iterator[tuple[str, list[str]]]:
    """The address of a server on this machine, and what was sent to it."""
    requests: list[str] = []

    class Collector(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            requests.append(
                self.rfile.read(int(self.headers.get("content-length", 0))).decode(
                    "utf-8", "replace"
                )
            )
            self.send_response(200)
            self.end_headers()

        do_GET = do_POST  # noqa: N815

        def log_message(self, *args: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Collector) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/", requests
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("telemetry", [{}, {"DEPTHAI_TELEMETRY": "1"}])
def test_nothing_is_sent_unless_the_user_turned_it_on(
    drawn, collector, tmp_path, telemetry
):
    address, requests = collector
    words = ("watch", "--camera", drawn[0], "--out", tmp_path / "out")
    done = fresh_command(
        *words, DEPTHAI_TELEMETRY_URL=address, HOME=str(tmp_path), **telemetry
    )
    assert done.returncode == 0, done.stderr
    assert bool(requests) == bool(telemetry)
    assert telemetry or not [
        path for path in (tmp_path / ".cache").rglob("*") if path.is_file()
    ]


def test_a_source_that_ends_early_keeps_what_was_recorded_and_says_so(drawn, tmp_path):
    output = program(
        """
source = StoredFrames(*read_frames(Path(sys.argv[1])))
def unplugged():
    for frame in source.frames:
        if frame.sequence == 50:
            raise DeviceLost("no longer on USB", where="oak")
        yield frame
try:
    watch(StoredFrames("oak", source.lens, unplugged()), Path(sys.argv[2]))
except HoldfastError as error:
    video = frames_of_video(Path(sys.argv[2]), load_depthai())
    print(json.dumps({"error": type(error).__name__, "video": len(video)}))
""",
        drawn[0],
        tmp_path / "out",
    )
    assert output == {"error": "DeviceLost", "video": 50}
    assert len(read_tracks(tmp_path / "out").t_s) == 50
    assert "no longer on USB" in read_about(tmp_path / "out").void


def test_a_void_trial_gets_no_label(recorded, tmp_path, capsys):
    for path in recorded.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    write_about(
        tmp_path, msgspec.structs.replace(read_about(recorded), void="no longer on USB")
    )
    assert main(["watch", "--onset", str(tmp_path), "--action", "pull"]) == 3
    assert "void" in capsys.readouterr().err
    assert not (tmp_path / "events.jsonl").exists()


def test_a_killed_recording_keeps_its_tracks_and_is_void(drawn, tmp_path):
    done = process(
        "-c",
        PRELUDE
        + """
source = StoredFrames(*read_frames(Path(sys.argv[1])))
def killed():
    for frame in source.frames:
        if frame.sequence == 60:
            os.kill(os.getpid(), signal.SIGKILL)
        yield frame
watch(StoredFrames("drawn", source.lens, killed()), Path(sys.argv[2]))
""",
        str(drawn[0]),
        str(tmp_path),
    )
    assert done.returncode == -signal.SIGKILL
    assert 40 <= len(read_tracks(tmp_path).t_s) <= 60
    assert read_about(tmp_path).void == "interrupted"


@pytest.mark.parametrize("limit", [60_000, 4_000])
def test_a_full_disk_is_an_error_though_depthai_says_nothing(drawn, tmp_path, limit):
    done = process(
        "-m",
        "holdfast",
        "watch",
        "--camera",
        str(drawn[0]),
        "--out",
        str(tmp_path),
        file_limit=limit,
    )
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert (done.returncode, len(errors)) == (5, 1), done.stderr
    assert "OutputError" in errors[0]
    assert "full disk" in errors[0]
    assert read_about(tmp_path).void
    assert len(read_tracks(tmp_path).t_s) > 10


def cut(recorded: Path, folder: Path, name: str, share: float) -> None:
    """A copy of a recording, one file of it cut off."""
    for path in recorded.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    (folder / name).write_bytes(
        (folder / name).read_bytes()[: int(share * (folder / name).stat().st_size)]
    )


def test_half_the_tracks_are_no_whole_trial_in_which_nothing_slips(
    recorded, tmp_path, capsys
):
    cut(recorded, tmp_path, "tags.csv", 0.4)
    assert main(["watch", "--onset", str(tmp_path), "--action", "pull"]) == 3
    assert f"of its {N_FRAMES} frames" in capsys.readouterr().err
    assert not (tmp_path / "events.jsonl").exists()


def test_a_video_of_another_time_gives_a_trial_no_onset(tmp_path, capsys):
    hand_made(tmp_path, at_s=4000.0, slides_at_s=0.8)
    (tmp_path / "tactile.csv").write_text(
        "Time,X1,Y1,Z1,host_ns\n0.0,0,0,0,5000250000000\n"
    )
    assert main(["watch", "--onset", str(tmp_path), "--action", "pull"]) == 3
    assert "another time" in capsys.readouterr().err
    assert not (tmp_path / "events.jsonl").exists()


@pytest.mark.parametrize(
    ("name", "number"),
    [("fps", np.nan), ("fps", 0.3), ("tag_mm", 0.0), ("exposure_ms", -2.0)],
)
def test_a_lens_that_cannot_be_is_refused_in_a_folder(tmp_path, name, number):
    numbers = {"fps": FPS, "exposure_ms": 2.0, "tag_mm": 10.0} | {name: number}
    (tmp_path / "camera.json").write_text(json.dumps(numbers | {"clock": "trial"}))
    with pytest.raises(NotANumber, match=r"camera\.json"):
        read_about(tmp_path)
