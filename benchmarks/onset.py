"""How well a camera dates the begin of a slip: drawn tags through the camera's own pipeline.

Simulated. Perspective, tilt, fingers before the tag, defocus, uneven light and a rolling shutter
are not in it, so these errors are a lower bound.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from holdfast.core.contract import FloatArray
from holdfast.core.reading import Json
from holdfast.drivers.camera.graph import watch
from holdfast.drivers.camera.motion import Motion, motion
from holdfast.drivers.camera.onset import (
    GROSS_MM,
    HiddenMotion,
    Slip,
    find_slip,
    gross_distance_mm,
    largest_move_mm,
)
from holdfast.drivers.camera.recording import read_tracks
from holdfast.drivers.camera.sources import Frame, Lens, Stored
from holdfast.simulation.camera_frames import CAMERA, HAND_TAG, OBJECT_TAG, Camera
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file

ACCELERATIONS_MM_S2 = (10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0)
EACH = 10
REST_S = 0.7
SLIDES_MM = 25.0
"""A ramp begins after so long, within one frame, and runs over so far."""
FPS = (60.0, 120.0)
SMALL = {"width_px": 360.0, "height_px": 360.0, "noise_levels": 2.0}
FROM_S = 1.0
TO_S = 0.3
"""Of a simulated trial so much before the load and after the gross distance is filmed."""
CARD = """
[record]
rate_hz = 1000
[[trials]]
objects = ["soft-ball", "empty-bottle", "basket-ball"]
action = "pull"
style = "author"
count = 20
tail_s = 0.2
[effects.brush]
count = 5
"""
LOADED = """
[record]
rate_hz = 1000
[[trials]]
objects = ["soft-ball", "basket-ball", "hard-ball"]
action = "hold"
style = "author"
count = 4
load_n = { uniform = [0.5, 1.5] }
[effects.brush]
count = 5
"""


@dataclass(frozen=True)
class Case:
    """A path of the object in mm over t_s [T], with its true start and gross times, s."""

    t_s: FloatArray
    object_m: FloatArray
    start_s: float
    gross_s: float


def small_camera(fps: float) -> Camera:
    """The default camera with fewer pixels and a little noise."""
    usual = {name: parameter.default for name, parameter in CAMERA.items()}
    return Camera(**(usual | SMALL | {"fps": fps}))


def seen(case: Case, camera: Camera, seed: int) -> Motion:
    """What the camera's graph makes of a case."""
    stamps_s, images = camera.film(
        case.t_s, case.object_m, 0.0 * case.object_m, np.random.default_rng(seed)
    )
    frames = [
        Frame(k, end_s, image)
        for k, (end_s, image) in enumerate(zip(stamps_s.tolist(), images, strict=True))
    ]
    lens = Lens(camera.fps, camera.exposure_ms, camera.tag_mm, "trial")
    with tempfile.TemporaryDirectory() as folder:
        watch(Stored("drawn", lens, frames), Path(folder), say=lambda line: None)
        tracks = read_tracks(Path(folder))
    return motion(tracks.t_s, tracks.of(OBJECT_TAG), tracks.of(HAND_TAG), camera.tag_mm)


def ramp(acceleration_mm_s2: float, camera: Camera, rng: np.random.Generator) -> Case:
    """From rest into a constant acceleration, downwards, beginning anywhere between two frames."""
    start_s = REST_S + float(rng.uniform(0.0, 1.0 / camera.fps))
    lasts_s = float(np.sqrt(2.0 * SLIDES_MM / acceleration_mm_s2))
    t_s = np.arange(0.0, start_s + lasts_s, 1e-3)
    object_m = np.zeros((len(t_s), 3))
    object_m[:, 2] = -0.5e-3 * acceleration_mm_s2 * np.maximum(t_s - start_s, 0.0) ** 2
    return Case(
        t_s,
        object_m,
        start_s,
        start_s + float(np.sqrt(2.0 * GROSS_MM / acceleration_mm_s2)),
    )


def ramps(
    accelerations: Sequence[float] = ACCELERATIONS_MM_S2, each: int = EACH
) -> list[Json]:
    """A row for every acceleration and frame rate."""
    rows = []
    for camera in map(small_camera, FPS):
        for acceleration in accelerations:
            cases = [
                ramp(acceleration, camera, np.random.default_rng(k))
                for k in range(each)
            ]
            rows.append(_row(cases, camera) | {"mm_per_s2": acceleration})
    return rows


def pulls(total: int | None = None, rates: Sequence[float] = FPS) -> list[Json]:
    """Pulls of the style author, a row per frame rate; their start is the first sliding element."""
    cases = _simulated(CARD, total)
    return [_row(cases, small_camera(fps)) for fps in rates]


def held(total: int | None = None) -> list[Json]:
    """Holds under load: how far the pads yield, and how many false onsets are found."""
    camera = small_camera(FPS[0])
    moved = [seen(case, camera, k) for k, case in enumerate(_simulated(LOADED, total))]
    gross_mm = gross_distance_mm(moved)
    found = [find_slip(one, gross_mm) for one in moved]
    shear_mm = max(largest_move_mm(one) for one in moved)
    onsets = sum(isinstance(one, Slip) for one in found)
    row = {
        "n": len(moved),
        "elastic_shear_mm": round(shear_mm, 3),
        "gross_mm": round(gross_mm, 3),
        "onsets": onsets,
    }
    return [row]


def _simulated(card: str, total: int | None) -> list[Case]:
    """Trials of a card, cut: pulls to the time around the slip, holds to the loaded hold."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "camera.toml"
        path.write_text(card, encoding="utf-8")
        scene = Scene(read_scene_file(str(path)), 0)
    cases = []
    for simulated in scene.run_together(scene.trials(total)):
        t_s = simulated.motion.t_s
        place_m = simulated.motion.position_m
        truth = simulated.truth
        load_s = float(truth.load_onset_s or 0.0)
        fine_s = np.arange(load_s, t_s[-1], 1e-4)
        path_mm = 1e3 * CubicSpline(t_s, place_m[:, [0, 2]])(fine_s)
        far = np.flatnonzero(np.linalg.norm(path_mm - path_mm[0], axis=1) >= GROSS_MM)
        gross_s = float(fine_s[far[0]]) if far.size else load_s
        opens_s = float(truth.marks[-2][0])
        to_s = opens_s if simulated.trial.action == "hold" else gross_s + TO_S
        part = (t_s >= load_s - FROM_S) & (t_s <= to_s)
        first_s = float(t_s[part][0])
        start_s = float(truth.incipient_slip_s or load_s)
        cases.append(
            Case(
                t_s[part] - first_s, place_m[part], start_s - first_s, gross_s - first_s
            )
        )
    return cases


def _row(cases: Sequence[Case], camera: Camera) -> Json:
    """Cases at a frame rate, and the errors of the slips that were found, if any.

    hidden: the object was out of the picture, or blurred, before three frames had seen it leave.
    """
    found = [(case, find_slip(seen(case, camera, k))) for k, case in enumerate(cases)]
    slips = [(case, slip) for case, slip in found if isinstance(slip, Slip)]
    hidden = sum(isinstance(slip, HiddenMotion) for _, slip in found)
    row = {"fps": camera.fps, "n": len(cases), "found": len(slips), "hidden": hidden}
    return row | _errors(slips) if slips else row


def _errors(slips: Sequence[tuple[Case, Slip]]) -> Json:
    """5, 50 and 95 % of the errors in ms, of the fitted start, of the first frame beyond the
    threshold (seen) and of the gross distance.

    sd_p50_ms: median of the stated uncertainty. within_10_ms, within_two_sd: shares of the starts,
    0 to 1.
    """
    off_ms = {
        "start": np.array([1e3 * (s.start_s - c.start_s) for c, s in slips]),
        "seen": np.array([1e3 * (s.seen_s - c.start_s) for c, s in slips]),
        "gross": np.array([1e3 * (s.gross_s - c.gross_s) for c, s in slips]),
    }
    errors = {}
    for name, off in off_ms.items():
        for q in (5, 50, 95):
            errors[f"{name}_p{q}_ms"] = round(float(np.percentile(off, q)), 2)
    within = [abs(s.start_s - c.start_s) <= 2.0 * s.uncertainty_s for c, s in slips]
    sd_s = float(np.median([slip.uncertainty_s for _, slip in slips]))
    worst = np.abs(off_ms["start"])
    return errors | {
        "start_worst_ms": round(float(worst.max()), 2),
        "sd_p50_ms": round(1e3 * sd_s, 2),
        "within_10_ms": round(float(np.mean(worst < 10.0)), 3),
        "within_two_sd": round(float(np.mean(within)), 3),
    }
