"""A camera beside the hand, through depthai itself: its own pipeline without a device, only the
frames are drawn.

depthai runs outside the process of the tests: what crashes it fails one test, not the run.
"""

from __future__ import annotations

import numpy as np
import pytest
from camera_frames import HAND_TAG, OBJECT_TAG
from drawn_frames import (
    COVERED,
    FPS,
    N_FRAMES,
    TWICE,
    camera,
    command,
    motion_m,
    program,
)
from scipy.interpolate import CubicSpline

from holdfast.drivers.camera.recording import read_about, read_tracks

# -- tracks and video


def test_drawn_tags_of_known_motion_are_tracked_to_a_twentieth_of_a_pixel(recorded):
    tracks = read_tracks(recorded)
    fine_s = np.arange(N_FRAMES + 1) / FPS
    thing, hand = (
        CubicSpline(fine_s, 1e3 * path)(tracks.t_s) for path in motion_m(fine_s)
    )
    for tag, moved_mm in ((OBJECT_TAG, thing + hand), (HAND_TAG, hand)):
        true_px = np.array([camera().centre_px(tag, at[[0, 2]]) for at in moved_mm])
        error_px = tracks.of(tag).mean(axis=1) - true_px
        error_px = error_px[np.isfinite(error_px[:, 0])]
        assert len(error_px) > 80
        assert np.sqrt((error_px**2).mean()) < 0.05


def test_a_covered_tag_and_one_seen_twice_are_gaps(recorded):
    tracks = read_tracks(recorded)
    hidden = {
        tag: np.flatnonzero(np.isnan(tracks.of(tag)[:, 0, 0])).tolist()
        for tag in (OBJECT_TAG, HAND_TAG)
    }
    assert hidden == {OBJECT_TAG: list(TWICE), HAND_TAG: list(COVERED)}


def test_stamps_are_the_middle_of_the_exposure(drawn, recorded):
    np.testing.assert_allclose(read_tracks(recorded).t_s, drawn[1] - 1e-3, atol=1.1e-6)


def test_a_recording_holds_every_frame_bit_for_bit_and_its_stamps(drawn, recorded):
    output = program(
        """
frames, shots = list(read_video(Path(sys.argv[1]), load_depthai(quiet))), np.load(sys.argv[2])
off = [abs(f.end_s - t) for f, t in zip(frames, shots["time_s"])]
images = shots["frames"]
same = len(frames) == len(images) and all((f.image == i).all() for f, i in zip(frames, images))
in_order = [f.sequence for f in frames] == list(range(len(off)))
print(json.dumps({"same": bool(same), "off_s": max(off), "in_order": in_order}))
""",
        recorded,
        drawn[0],
    )
    assert output == {
        "same": True,
        "off_s": pytest.approx(0.0, abs=1e-6),
        "in_order": True,
    }


def test_a_video_is_written_by_one_thread_and_none_waits_busily_beside_a_hand(tmp_path):
    output = program(
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
    assert output == {"writers": 1}


def test_a_video_is_read_and_counted_without_being_held_in_memory(recorded):
    output = program(
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
tracemalloc.stop()
print(json.dumps({"frames": len(frames), "held": held, "one": one, "most": most}))
""",
        recorded,
    )
    assert output["frames"] == N_FRAMES
    assert output["held"] < output["one"]
    assert output["most"] < 15 * output["one"]


def test_a_video_that_is_read_slowly_or_left_early_loses_no_frame_and_never_hangs(
    recorded,
):
    output = program(
        """
from threading import Event
dai, folder = load_depthai(quiet), Path(sys.argv[1])
busy = Event().wait
for taken in range(1, 11):
    frames = read_video(folder, dai)
    early = [next(frames).sequence for _ in range(taken)]
    busy(0.05)
    frames.close()
    assert early == list(range(taken))
slowly = []
for frame in read_video(folder, dai):
    slowly.append(frame.sequence)
    busy(0.01)
print(json.dumps({"slowly": slowly}))
""",
        recorded,
    )
    assert output["slowly"] == list(range(N_FRAMES))


def test_a_recording_is_described_in_a_file_beside_it(recorded):
    about = read_about(recorded)
    numbers = {
        "fps": FPS,
        "exposure_ms": 2.0,
        "tag_mm": 10.0,
        "quad_decimate": 2,
        "frames": N_FRAMES,
    }
    assert (
        about.items()
        >= (
            numbers | {"in_video": N_FRAMES, "lost": 0, "void": None, "clock": "trial"}
        ).items()
    )


def test_nothing_recorded_is_written_over(drawn, recorded):
    before = {path.name: path.read_bytes() for path in recorded.iterdir()}
    done = command("watch", "--camera", drawn[0], "--out", recorded)
    assert (done.returncode, "holds camera.mkv already" in done.stderr) == (5, True)
    assert {path.name: path.read_bytes() for path in recorded.iterdir()} == before


def test_a_tag_smeared_over_one_cell_is_seen_and_over_two_is_lost(tmp_path):
    output = program(
        """
from camera_frames import CAMERA, Camera
defaults = {name: parameter.default for name, parameter in CAMERA.items()}
one = Camera(**defaults | {"width_px": 240.0, "height_px": 160.0})
seen = []
for smear_mm in (1.25, 2.5):
    at = [np.array([0.1 * k, smear_mm * s]) for k in range(5) for s in np.arange(0.0, 1.0, 0.05)]
    drawn = [one.draw(one_mm, np.zeros(2)) for one_mm in at]
    images = np.rint(np.reshape(drawn, (5, 20, 160, 240)).mean(axis=1)).astype(np.uint8)
    out = Path(sys.argv[1]) / str(smear_mm)
    frames = [Frame(k, k / 60, image) for k, image in enumerate(images)]
    watch(Stored("smeared", Lens(60.0, 2.0, 10.0, "trial"), frames), out, say=quiet)
    seen.append(int(np.isfinite(read_tracks(out).of(0)[:, 0, 0]).sum()))
print(json.dumps({"seen": seen}))
""",
        tmp_path,
    )
    assert output == {"seen": [5, 0]}


def test_frames_that_never_came_are_counted(drawn, tmp_path):
    output = program(
        """
source = read_frames(Path(sys.argv[1]))
kept = [f for f in source.frames if f.sequence not in (10, 11, 40)][:60]
print(json.dumps(vars(watch(Stored("some", source.lens, kept), Path(sys.argv[2]), say=quiet))))
""",
        drawn[0],
        tmp_path / "out",
    )
    assert output == {"frames": 60, "lost": 3, "backwards": 0, "in_video": 60}
