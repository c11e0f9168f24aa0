"""`holdfast onset TRIAL`: when the object began to slip, as a camera saw it; an interval label with
its uncertainty.

    holdfast onset trials/7 --action pull                a folder that holdfast watch made: a line in its events.jsonl
    holdfast onset trials/p01/my-cup/pull/trial_1        one of holdfast record: its phases are made anew too
    holdfast onset scenes/soft-ball/pull/trial_1.csv     frames beside it: trial_1.onset.json, phases as in truth.json

The action says what a slip is here: pull, fall and hold make it risky, pass and put-down safe.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edge_runtime.command import path_argument, positive, show
from edge_runtime.errors import DataError, LabelError, NotANumber, TimeError, UsageError
from edge_runtime.reading import require_lines
from edge_runtime.trial_layout import (
    EVENTS,
    FRAMES_SUFFIX,
    ONSET_SUFFIX,
    RISKY_ACTIONS,
    TACTILE,
    TRUTH,
    VOLUNTARY_ACTIONS,
    read_events,
)
from holdfast.camera_options import printed_mm

if TYPE_CHECKING:
    from drivers.camera.onset import Motion, Slip

OBJECT_TAG, HAND_TAG = 0, 1
RISKY = (*RISKY_ACTIONS, "hold")
PROVENANCE, BY = "camera", "holdfast onset"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "trial",
        type=path_argument,
        metavar="TRIAL",
        help="a watched folder, or trial_n.csv with its frames",
    )
    actions = (*RISKY, *VOLUNTARY_ACTIONS)
    parser.add_argument("--action", choices=actions, help="default: the name of the trial's folder")
    held = "trials that were loaded and held: gross slip begins above their elastic shear"
    parser.add_argument(
        "--no-slip", type=path_argument, nargs="+", default=[], metavar="TRIAL", help=held
    )
    number, ever = positive, float("inf")
    parser.add_argument(
        "--gross-mm", type=number, metavar="MM", help="gross slip is so far (default 2)"
    )
    parser.add_argument(
        "--tag-mm", type=printed_mm, metavar="MM", help="the printed side, if not as recorded"
    )
    parser.add_argument(
        "--apart-mm", type=number, metavar="MM", help="between the tags' centres at first: a check"
    )
    parser.add_argument(
        "--from", type=float, default=-ever, dest="from_s", metavar="S", help="look only from here"
    )
    parser.add_argument(
        "--until", type=float, default=ever, dest="until_s", metavar="S", help="and to here"
    )


@dataclass(frozen=True)
class WatchedTrial:
    """Where a trial lies, what the camera saw of it, and how far its clock is before the
    frames'."""

    path: Path
    moved: Motion
    starts_s: float


def run(args: argparse.Namespace) -> int:
    """Find the onset, write it beside the trial, say it."""
    from drivers.camera.onset import GROSS_MM, gross_distance_mm

    held = [read(path, args.tag_mm) for path in args.no_slip]
    gross_mm = args.gross_mm or (
        gross_distance_mm([trial.moved for trial in held]) if held else GROSS_MM
    )
    trial = read(args.trial, args.tag_mm, args.apart_mm)
    trial = replace(
        trial,
        moved=trial.moved.between(args.from_s + trial.starts_s, args.until_s + trial.starts_s),
    )
    require_above_shear(held, gross_mm)
    show(str(write(trial, args.action, gross_mm, shear_known=bool(held))))
    return 0


def require_above_shear(held: list[WatchedTrial], gross_mm: float) -> None:
    """Raise UsageError where the distance asked for lies within what the pads give without
    slipping."""
    from drivers.camera.onset import largest_move_mm

    shear_mm = max((largest_move_mm(trial.moved) for trial in held), default=0.0)
    if gross_mm <= shear_mm:
        raise UsageError(
            f"--gross-mm {gross_mm:g} is within the elastic shear",
            cause=f"the held trials move by {shear_mm:.2f} mm",
            next_step="leave --gross-mm out, or give more",
        )


def read(path: Path, tag_mm: float | None = None, apart_mm: float | None = None) -> WatchedTrial:
    """The object's motion in the hand, from a watched folder or from frames beside a trial. Raises
    a DataError."""
    if path.is_dir():
        return watched(path, path, tag_mm, apart_mm)
    from drivers.camera.graph import watch
    from drivers.camera.sources import read_frames
    from holdfast.messages import say

    frames = path if path.name.endswith(FRAMES_SUFFIX) else path.with_suffix(FRAMES_SUFFIX)
    with tempfile.TemporaryDirectory() as folder:
        watch(read_frames(frames), Path(folder), say=say)
        trial = frames.with_name(frames.name.removesuffix(FRAMES_SUFFIX) + ".csv")
        return watched(Path(folder), trial, tag_mm, apart_mm)


def watched(
    folder: Path, trial: Path, tag_mm: float | None, apart_mm: float | None
) -> WatchedTrial:
    """A watched folder read; `trial` is what its label belongs to. Raises LabelError where the
    trial is void."""
    from drivers.camera.onset import motion
    from drivers.camera.recording import TAGS, read_about, read_tracks, require_whole

    about = read_about(folder)
    if about.get("void"):
        raise LabelError(
            "a void trial gets no label",
            where=folder,
            cause=str(about["void"]),
            next_step="record it again",
        )
    tracks = read_tracks(folder)
    require_whole(len(tracks.t_s), about.get("frames"), folder / TAGS)
    try:
        moved = motion(
            tracks.t_s,
            tracks.of(OBJECT_TAG),
            tracks.of(HAND_TAG),
            tag_mm or float(about["tag_mm"]),
            apart_mm or about.get("apart_mm"),
        )
    except LabelError as error:
        raise type(error)(
            error.what, where=trial, cause=error.cause, next_step=error.next_step
        ) from None
    return WatchedTrial(
        trial, moved, 0.0 if about.get("clock") == "trial" else _starts_s(trial, moved)
    )


def doubt(folder: Path) -> LabelError | None:
    """What is wrong with the tags of a folder just watched: sizes, squareness, distance, or never
    seen together."""
    try:
        watched(folder, folder, None, None)
    except LabelError as error:
        return error
    except DataError:
        return None
    return None


def _starts_s(folder: Path, moved: Motion) -> float:
    """The monotonic time of the trial's first tactile sample, s; of the first frame where nothing
    tactile is there."""
    try:
        require_lines(folder / TACTILE)
        with (folder / TACTILE).open(newline="", encoding="utf-8-sig") as lines:
            starts_s = 1e-9 * int(next(csv.DictReader(lines))["host_ns"])
    except FileNotFoundError:
        return float(moved.t_s[0])
    except (OSError, StopIteration, KeyError, ValueError, TypeError, csv.Error):
        raise NotANumber(
            "its first row has no host_ns, so nobody knows when it was in the camera's time",
            where=folder / TACTILE,
            cause="recorded on another machine, or without host stamps",
            next_step="record both on one machine",
        ) from None
    if moved.t_s[-1] < starts_s:
        raise TimeError(
            f"the camera's last frame is {starts_s - moved.t_s[-1]:.0f} s before the trial",
            where=folder,
            cause="a video of another time was given as its camera",
            next_step="film the trial itself",
        )
    return starts_s


def write(trial: WatchedTrial, action: str | None, gross_mm: float, *, shear_known: bool) -> str:
    """Look for the slip, write what was found beside the trial; returns the sentence about it."""
    from drivers.camera.onset import Slip, find_slip

    try:
        found = find_slip(trial.moved, gross_mm)
    except LabelError as error:
        raise LabelError(
            error.what, where=trial.path, cause=error.cause, next_step=error.next_step
        ) from None
    label = _label(action, trial.path) if isinstance(found, Slip) else ""
    intervals = [_interval(found, label, trial.starts_s)] if isinstance(found, Slip) else []
    hidden = (
        None
        if found is None or isinstance(found, Slip)
        else _shifted(asdict(found), trial.starts_s)
    )
    how = {
        "gross_mm": gross_mm,
        "pad_shear": "measured" if shear_known else "not measured",
        "hidden": hidden,
        "threshold_mm": round(trial.moved.threshold_mm, 4),
        "sigma_mm": round(trial.moved.sigma_mm, 5),
        "mm_per_px": round(trial.moved.mm_per_px, 5),
        "frames": len(trial.moved.t_s),
        "frames_seen": trial.moved.seen,
    }
    write_labels = _write_events if trial.path.is_dir() else _write_beside
    where = write_labels(trial.path, intervals, how)
    if isinstance(found, Slip):
        return _sentence(intervals[0], where)
    if hidden:
        gap = f"{hidden['from_s']:.3f} to {hidden['to_s']:.3f} s"
        return f"no onset: a tag was hidden from {gap} while the object moved; {where}"
    return f"no onset: nothing moved by {gross_mm:.2f} mm; {where}"


def _label(action: str | None, path: Path) -> str:
    action = action or path.parent.name
    if action not in (*RISKY, *VOLUNTARY_ACTIONS):
        raise UsageError(
            f"{path}: nobody knows what a slip means in {action!r}",
            cause="the folder is not named after an action",
            next_step=f"--action {'|'.join((*RISKY, *VOLUNTARY_ACTIONS))}",
        )
    return "risky_slip" if action in RISKY else "safe_slip"


def _interval(slip: Slip, label: str, starts_s: float) -> dict[str, Any]:
    """As truth.json has its phases, and what else the camera knows; times from the trial's first
    sample."""
    at = _shifted(
        {"t0_s": slip.start_s, "t1_s": slip.end_s, "seen_s": slip.seen_s, "gross_s": slip.gross_s},
        starts_s,
    )
    spread = {
        "start_sd_s": slip.start_sd_s,
        "frame_s": slip.frame_s,
        "uncertainty_s": slip.uncertainty_s,
    }
    return {
        "t0_s": at.pop("t0_s"),
        "t1_s": at.pop("t1_s"),
        "onset_s": round(slip.start_s - starts_s, 6),
        "duration_s": round(slip.end_s - slip.start_s, 6),
        "label": label,
        "provenance": PROVENANCE,
        "by": BY,
        **at,
        **{name: round(value, 6) for name, value in spread.items()},
    }


def _shifted(times: dict[str, float], starts_s: float) -> dict[str, float]:
    return {name: round(value - starts_s, 6) for name, value in times.items()}


def _write_beside(trial: Path, intervals: list[dict[str, Any]], how: dict[str, Any]) -> Path:
    """trial_n.onset.json: phases as in trial_n.truth.json, which is somebody else's and stays as it
    is."""
    from edge_runtime.writing import write_whole

    return write_whole(
        trial.with_suffix(ONSET_SUFFIX), json.dumps({"phases": intervals, **how}, indent=1) + "\n"
    )


def _write_events(folder: Path, intervals: list[dict[str, Any]], how: dict[str, Any]) -> Path:
    """events.jsonl: one line an interval. A camera's earlier lines go, everybody else's stay."""
    from edge_runtime.writing import write_whole

    path = folder / EVENTS
    kept = [
        json.dumps(event) for event in read_events(path) if event.get("provenance") != PROVENANCE
    ]
    lines = [*kept, *(json.dumps(one | how) for one in intervals)]
    written = write_whole(path, "".join(f"{line}\n" for line in lines))
    if (folder / TRUTH).exists():
        from holdfast.recorder.labels import relabel

        relabel(folder)
    return written


def _sentence(interval: dict[str, Any], where: Path) -> str:
    start, sd_ms = interval["t0_s"], 1e3 * interval["uncertainty_s"]
    seen_ms, gross_ms = (1e3 * (interval[name] - start) for name in ("seen_s", "gross_s"))
    return (
        f"{interval['label']} from {start:.4f} s (sd {sd_ms:.1f} ms); beyond noise {seen_ms:.0f} ms later, gross "
        f"{gross_ms:.0f} ms later; {where}"
    )
