"""The options that every verb that reads a hand shares, and the meaning of their values.

The camera options of every verb that films, and stored frames as a source.

The options of a run that moves a hand or gives cues, and where they lead.

--grip udp://HOST:PORT | serial:///dev/ttyX?baud=115200 | virtual?lag_ms=50&ceiling_n=70

The options of the wearer's own command: --intent and --obey-intent.

Where jobs run: the options --jobs and --dask.

Which model file, and what steps it: the options --engine and --library.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from holdfast.cli.command import path_argument, positive
from holdfast.core.errors import UnitError, UsageError
from holdfast.edge_runtime.engine import ENGINES, ONNXRUNTIME, ModelChoice

if TYPE_CHECKING:
    from holdfast.core.contract import FloatArray
    from holdfast.core.source import Source
    from holdfast.drivers.camera.sources import FrameSource
    from holdfast.evaluation.jobs import Workers
    from holdfast.simulation.closed_loop.drive import Drive


def add_live_options(parser: argparse.ArgumentParser) -> None:
    """--source and --calibration."""
    urls = "usb://ft232h, i2c://1, virtual://ft232h?scene=.., sim://CARD, lsl://NAME"
    parser.add_argument("--source", required=True, metavar="URL", help=urls)
    made = "map from field to force, made by holdfast calibrate"
    parser.add_argument("--calibration", type=path_argument, metavar="FILE", help=made)


def add_web_option(parser: argparse.ArgumentParser) -> None:
    """--web."""
    web = (
        "show it on a page in the browser (default host: 127.0.0.1; docs/live-page.md)"
    )
    parser.add_argument("--web", metavar="[HOST:]PORT", help=web)


def force_of(path: Path | None) -> Callable[[FloatArray], FloatArray] | None:
    """The map from field to force in a calibration file, or None. Raises a DataError."""
    if path is None:
        return None
    from holdfast.drivers.calibration import read_calibration

    return read_calibration(path).apply


def resting_of(path: Path | None, source: Source) -> FloatArray | None:
    """A bias file [C] that fits the source, or None. Raises a DataError."""
    if path is None:
        return None
    from holdfast.drivers.calibration import read_bias

    bias = read_bias(path)
    if bias.unit != source.unit or len(bias.values) != source.n_channels:
        raise UnitError(
            f"{len(bias.values)} channels in {bias.unit}, "
            f"the source has {source.n_channels} in {source.unit}",
            where=path,
            cause="measured with another calibration or hand",
            next_step="run holdfast bias again",
        )
    return bias.values


FPS, EXPOSURE_MS = 60.0, 2.0
OF_OAK = ("tag_mm", "fps", "exposure_ms")
"""What only a camera on USB uses: stored frames and scenes bring their own."""
SIDE_MM = (1.0, 200.0)
"""Plausible sides of a tag; a number outside is probably not in millimetres."""


def add_camera_options(parser: argparse.ArgumentParser) -> None:
    """--tag-mm, --fps and --exposure-ms, which an OAK camera needs."""
    option = parser.add_argument
    side = "oak: measured side of the printed tags"
    option("--tag-mm", type=printed_mm, metavar="MM", help=side)
    fps = f"oak: frames a second (default {FPS:g})"
    option("--fps", type=positive, metavar="HZ", help=fps)
    exposure = f"oak: exposure (default {EXPOSURE_MS:g})"
    option("--exposure-ms", type=positive, metavar="MS", help=exposure)


def require_camera_options(args: argparse.Namespace, *more: str) -> None:
    """Raise UsageError for an OAK without the side of its tags, and for options that are ignored.

    more: names of further options that only an OAK uses.
    """
    from holdfast.drivers.camera.sources import OAK

    if args.camera == OAK:
        if args.tag_mm is None:
            raise UsageError(
                "--tag-mm is missing",
                cause="millimetres are derived from the printed side",
                next_step="measure a tag's black square with a calliper and give --tag-mm 9.96",
            )
        return
    given = [name for name in (*OF_OAK, *more) if getattr(args, name) is not None]
    if given:
        words = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        corrects = (
            "; holdfast onset --tag-mm corrects the side" if "tag_mm" in given else ""
        )
        raise UsageError(
            f"{words} would be ignored",
            cause=f"only --camera {OAK} uses it; other frames bring their own",
            next_step=f"omit it{corrects}",
        )


def shooting(args: argparse.Namespace) -> dict[str, float]:
    """Frames a second, exposure and side of an OAK camera."""
    return {
        "fps": args.fps or FPS,
        "exposure_ms": args.exposure_ms or EXPOSURE_MS,
        "tag_mm": args.tag_mm,
    }


def printed_mm(word: str) -> float:
    """A tag's printed side from the command line, mm."""
    side_mm = positive(word)
    if not SIDE_MM[0] <= side_mm <= SIDE_MM[1]:
        allowed = f"{SIDE_MM[0]:g} to {SIDE_MM[1]:g}"
        raise argparse.ArgumentTypeError(
            f"{word!r} mm is not the side of a tag: {allowed}"
        )
    return side_mm


def stored(path: Path, say: Callable[[str], None]) -> FrameSource:
    """Frames on disk or a recorded folder as a source. Raises a DataError or LibraryMissing."""
    from holdfast.drivers.camera.library import load_depthai
    from holdfast.drivers.camera.recording import read_recorded
    from holdfast.drivers.camera.sources import read_frames

    return (
        read_recorded(path, load_depthai(say)) if path.is_dir() else read_frames(path)
    )


VIRTUAL = "virtual"
DEFAULT_CONTROLLER = "holdfast"
LARGEST = 1e4
"""Of a figure of the virtual drive."""


def add_grip_options(parser: argparse.ArgumentParser) -> None:
    """--grip, --controller, --ceiling, --feedback, --cues."""
    option = parser.add_argument
    grip = "send a grip command at every sample: udp://HOST:PORT, serial:///dev/ttyX?baud=115200, "
    option(
        "--grip",
        metavar="URL",
        help=f"{grip}or virtual: to the hand in the scene of the source",
    )
    names = "none, pd-shear, sliding-mode, smsp, ismsp or holdfast (the default)"
    option("--controller", metavar="NAME", help=f"grip controller: {names}")
    ceiling = "largest grip of the hand, N of either side (default: 70)"
    option("--ceiling", type=positive, metavar="N", help=ceiling)
    cue = "send vibration cues for the wearer: udp://HOST:PORT or serial:///dev/ttyX?baud=115200"
    option("--feedback", metavar="URL", help=cue)
    cues = "patterns of the cues (TOML; default: the shipped card, docs/feedback.md)"
    option("--cues", type=path_argument, metavar="FILE", help=cues)


def require_grip(args: argparse.Namespace) -> None:
    """Raise UsageError where an option stands without the one that it belongs to."""
    if args.cues and not args.feedback:
        raise UsageError(
            "--cues needs --feedback, which sends the cues",
            next_step="--feedback udp://127.0.0.1:9002",
        )
    for option in ("controller", "ceiling"):
        if getattr(args, option) and not args.grip:
            raise UsageError(
                f"--{option} needs --grip, which runs the controller",
                next_step="--grip udp://127.0.0.1:9000",
            )


def is_virtual(url: str | None) -> bool:
    """Whether commands go to the hand in the scene of the source."""
    return url is not None and url.partition("?")[0] == VIRTUAL


def drive_of(url: str) -> Drive:
    """The drive of virtual?lag_ms=..&ceiling_n=... Raises UsageError."""
    from holdfast.simulation.closed_loop.drive import Drive

    known = [one.name for one in fields(Drive)]
    figures = {}
    for key, values in parse_qs(url.partition("?")[2], keep_blank_values=True).items():
        if key not in known:
            raise UsageError(
                f"--grip virtual: {key[:40]!r} is not known",
                next_step=f"allowed: {', '.join(known)}",
            )
        figures[key] = _figure(
            key, values[-1], may_be_zero=key in ("lag_ms", "backlash_mm")
        )
    return Drive(**figures)


def _figure(key: str, text: str, *, may_be_zero: bool) -> float:
    try:
        figure = float(text)
    except ValueError:
        figure = -1.0
    if not 0.0 <= figure <= LARGEST or (not figure and not may_be_zero):
        bound = "from 0" if may_be_zero else "above 0"
        what = f"--grip virtual: {key}={text[:40]!r} is not a number {bound} to {LARGEST:g}"
        raise UsageError(what, next_step=f"{key}=50")
    return figure


DEFAULT_LEVEL = 0.5
ADDRESSES = "udp://127.0.0.1:9003?envelopes=2 or lsl://NAME"


def add_intent_option(parser: argparse.ArgumentParser) -> None:
    """--intent."""
    intent = "show and record the wearer's own command: udp://HOST:PORT?envelopes=2 or lsl://NAME"
    parser.add_argument("--intent", metavar="URL", help=intent)


def add_obey_option(parser: argparse.ArgumentParser) -> None:
    """--obey-intent."""
    obey = "let it open the hand, as --commands does: by its words, or from LEVEL of the first "
    parser.add_argument(
        "--obey-intent",
        nargs="?",
        type=_level,
        const=DEFAULT_LEVEL,
        metavar="LEVEL",
        help=f"{obey}envelope (default {DEFAULT_LEVEL:g})",
    )


def require_intent(args: argparse.Namespace) -> None:
    """Raise UsageError for --obey-intent without --intent."""
    if args.obey_intent is not None and not args.intent:
        raise UsageError(
            "--obey-intent needs --intent", next_step=f"--intent {ADDRESSES}"
        )


def _level(text: str) -> float:
    level = float(text)
    if not 0.0 < level <= 1.0:
        raise ValueError
    return level


CORES = len(os.sched_getaffinity(0))
"""That this process may use."""


def add_job_options(parser: argparse.ArgumentParser, processes: int) -> None:
    """The options that `evaluate`, `loop`, `bench cost`, `make real` and `make real-more` share.

    processes: the default.
    """
    option = parser.add_argument
    jobs = f"processes (default {processes})"
    option("--jobs", type=_count, default=processes, metavar="N", help=jobs)
    dask = (
        "run on a Dask cluster instead: the address of its scheduler (docs/cluster.md)"
    )
    option("--dask", metavar="ADDRESS", help=dask)


def chosen_workers(args: argparse.Namespace) -> Workers:
    """Where the user wants jobs to run."""
    from holdfast.evaluation.jobs import Workers

    return Workers(args.jobs, args.dask)


def _count(word: str) -> int:
    if not word.isdecimal() or int(word) < 1:
        raise argparse.ArgumentTypeError(
            f"{word!r} is not a number of processes from 1 on"
        )
    return int(word)


def add_engine_options(parser: argparse.ArgumentParser) -> None:
    """The options that `run`, `evaluate`, `loop` and `make loop` share."""
    option = parser.add_argument
    engine = "what computes a step: onnxruntime (default), or a library by holdfast export --to c"
    option("--engine", choices=ENGINES, default=ONNXRUNTIME, help=engine)
    library = "the library of --engine c (default MODEL-c/libholdfast.so)"
    option("--library", type=path_argument, metavar="FILE", help=library)


def chosen_model(args: argparse.Namespace) -> ModelChoice:
    """The file of args.model with the engine that the user chose."""
    library = None if args.library is None else str(args.library)
    return ModelChoice(str(args.model), args.engine, library)
