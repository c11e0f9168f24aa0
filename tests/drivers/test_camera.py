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

from holdfast.drivers.camera.recording import read_tracks

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
folder, shots = Path(sys.argv[1]), np.load(sys.argv[2])
dai = load_depthai()
numbers = frames_of_video(folder, dai)
replay = (pipeline := dai.Pipeline(createImplicitDevice=False)).create(dai.node.ReplayVideo)
replay.setReplayVideoFile(folder / "camera.mkv")
replay.setReplayMetadataFile(folder / "camera.mcap")
replay.setOutFrameType(dai.ImgFrame.Type.GRAY8)
replay.setLoop(False)
images, stamps = {}, {}
def take(message):
    images[message.getSequenceNum()] = np.array(message.getCvFrame())
    stamps[message.getSequenceNum()] = message.getTimestamp().total_seconds()
replay.out.createOutputQueue(maxSize=1, blocking=False).addCallback(take)
pipeline.start()
pipeline.wait()
off = [abs(stamps[k] - t) for k, t in enumerate(shots["time_s"])]
same = [bool((images[k] == one).all()) for k, one in enumerate(shots["frames"])]
print(json.dumps({"same": all(same), "off_s": max(off), "frames": [len(numbers), len(same)]}))
""",
        recorded,
        drawn[0],
    )
    assert output == {
        "same": True,
        "off_s": pytest.approx(0.0, abs=1e-6),
        "frames": [N_FRAMES, N_FRAMES],
    }


def test_a_video_is_written_by_one_thread_and_none_waits_busily_beside_a_hand(tmp_path):
    output = program(
        """
names = []
def looked_at():
    for k in range(20):
        names[:] = [path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")]
        yield Frame(k, k / 60.0, np.zeros((400, 640), dtype=np.uint8))
watch(StoredFrames("drawn", Lens(60.0, 2.0, 10.0, "trial"), looked_at()), Path(sys.argv[1]))
print(json.dumps({"writers": sum(name.startswith("RecordVideo") for name in names)}))
""",
        tmp_path,
    )
    assert output == {"writers": 1}


def test_nothing_recorded_is_written_over(drawn, recorded):
    before = {path.name: path.read_bytes() for path in recorded.iterdir()}
    done = command("watch", "--camera", drawn[0], "--out", recorded)
    assert (done.returncode, "holds camera.json already" in done.stderr) == (5, True)
    assert {path.name: path.read_bytes() for path in recorded.iterdir()} == before


def test_a_tag_smeared_over_one_cell_is_seen_and_over_two_is_lost(tmp_path):
    output = program(
        """
from camera_frames import Camera
one = Camera(width_px=240.0, height_px=160.0)
seen = []
for smear_mm in (1.25, 2.5):
    at = [np.array([0.1 * k, smear_mm * s]) for k in range(5) for s in np.arange(0.0, 1.0, 0.05)]
    drawn = [one.draw(one_mm, np.zeros(2)) for one_mm in at]
    images = np.rint(np.reshape(drawn, (5, 20, 160, 240)).mean(axis=1)).astype(np.uint8)
    out = Path(sys.argv[1]) / str(smear_mm)
    frames = [Frame(k, k / 60, image) for k, image in enumerate(images)]
    watch(StoredFrames("smeared", Lens(60.0, 2.0, 10.0, "trial"), frames), out)
    seen.append(int(np.isfinite(read_tracks(out).of(0)[:, 0, 0]).sum()))
print(json.dumps({"seen": seen}))
""",
        tmp_path,
    )
    assert output == {"seen": [5, 0]}


def test_frames_that_never_came_are_counted(drawn, tmp_path):
    output = program(
        """
source = StoredFrames(*read_frames(Path(sys.argv[1])))
kept = [f for f in source.frames if f.sequence not in (10, 11, 40)][:60]
found = watch(StoredFrames("some", source.lens, kept), Path(sys.argv[2]))
print(json.dumps({"frames": found.frames, "lost": found.lost, "in_video": found.in_video}))
""",
        drawn[0],
        tmp_path / "out",
    )
    assert output == {"frames": 60, "lost": 3, "in_video": 60}
