"""Options that several verbs share: each is declared here once.

What their values mean stands below, in the packages that use them; here words become values.
"""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

from holdfast.cli.command import path_argument, positive
from holdfast.core.errors import UsageError
from holdfast.edge_runtime.engine import ENGINES, ONNXRUNTIME, ModelChoice

if TYPE_CHECKING:
    from holdfast.evaluation.jobs import Workers
    from holdfast.live.sources import SetReader

RATE_HZ = 150.0
CORES = len(os.sched_getaffinity(0))
"""That this process may use."""
SIDE_MM = (1.0, 200.0)
"""Plausible sides of a tag; a number outside is probably not in millimetres."""


def add_source_option(parser: argparse.ArgumentParser) -> None:
    """--source."""
    urls = (
        "usb://ft232h, i2c://1, virtual://ft232h?scene=.., sim://CARD, lsl://NAME, or lines: "
        "- (stdin), unix:///PATH, serial:///dev/ttyACM0 (docs/live-sources.md)"
    )
    parser.add_argument("--source", required=True, metavar="URL", help=urls)


def set_reader(source: str) -> SetReader | None:
    """What reads a source such as SET#N; its packages are loaded only where they are needed."""
    # Only a source with a number sign is a trial of a set.
    if "#" not in source:
        return None
    from holdfast.sessions.set_source import read_set_trial

    return read_set_trial


def add_calibration_option(parser: argparse.ArgumentParser) -> None:
    """--calibration."""
    made = "map from field to force, made by holdfast calibrate"
    parser.add_argument("--calibration", type=path_argument, metavar="FILE", help=made)


def add_web_option(parser: argparse.ArgumentParser) -> None:
    """--web."""
    web = (
        "show it on a page in the browser, and no JSON lines in the terminal "
        "(default host: 127.0.0.1; docs/live-page.md)"
    )
    parser.add_argument("--web", metavar="[HOST:]PORT", help=web)


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """The options that `record` and `study` share."""
    option = parser.add_argument
    rate = f"sampling rate of a hand (default {RATE_HZ:g})"
    option("--rate", type=positive, default=RATE_HZ, metavar="HZ", help=rate)
    option("--anyway", action="store_true", help="record even if the bias is not good")
    seconds = "end and keep a trial after S seconds"
    option("--seconds", type=positive, metavar="S", help=seconds)
    card = (
        "hand card, by name or path (docs/scenes.md#hands); the recordings keep a copy"
    )
    option("--hand", metavar="CARD", help=card)
    option("--camera", metavar="oak|FILE", help="film every trial (docs/camera.md)")
    add_camera_options(parser)
    add_intent_option(parser)


def add_camera_options(parser: argparse.ArgumentParser) -> None:
    """--tag-mm, --fps and --exposure-ms, which an OAK camera needs."""
    option = parser.add_argument
    side = "oak: measured side of the printed tags"
    option("--tag-mm", type=printed_mm, metavar="MM", help=side)
    fps = "oak: frames a second (default 60)"
    option("--fps", type=positive, metavar="HZ", help=fps)
    exposure = "oak: exposure (default 2)"
    option("--exposure-ms", type=positive, metavar="MS", help=exposure)


def add_apart_option(parser: argparse.ArgumentParser) -> None:
    """--apart-mm."""
    apart = "distance between the tags' centres at the start, as a check"
    parser.add_argument("--apart-mm", type=positive, metavar="MM", help=apart)


def printed_mm(word: str) -> float:
    """A tag's printed side from the command line, mm."""
    side_mm = positive(word)
    if not SIDE_MM[0] <= side_mm <= SIDE_MM[1]:
        allowed = f"{SIDE_MM[0]:g} to {SIDE_MM[1]:g}"
        raise argparse.ArgumentTypeError(
            f"{word!r} mm is not the side of a tag: {allowed}"
        )
    return side_mm


def add_grip_options(parser: argparse.ArgumentParser) -> None:
    """--grip, --controller, --ceiling, --feedback, --cues."""
    option = parser.add_argument
    wires = "unix:///PATH, serial:///dev/ttyX?baud=115200"
    scene = (
        "or the word virtual for the hand in a scene (--source virtual://..?scene=..)"
    )
    grip = f"send a grip command at every sample to {wires}, {scene}"
    option("--grip", metavar="URL", help=grip)
    names = "none, pd-shear, sliding-mode, smsp, ismsp or holdfast (the default)"
    option("--controller", metavar="NAME", help=f"grip controller: {names}")
    ceiling = "largest grip of the hand, N of either side (default: 70)"
    option("--ceiling", type=positive, metavar="N", help=ceiling)
    feedback = f"send vibration cues for the wearer: {wires}"
    option("--feedback", metavar="URL", help=feedback)
    cues = "patterns of the cues (TOML; default: the shipped table, docs/feedback.md)"
    option("--cues", type=path_argument, metavar="FILE", help=cues)


def require_grip(args: argparse.Namespace) -> None:
    """Raise UsageError where an option stands without the one that it belongs to."""
    if args.cues and not args.feedback:
        raise UsageError(
            "--cues needs --feedback, which sends the cues",
            next_step="--feedback unix:///run/hand/cues",
        )

    # Silently ignored, these options would look as if they worked.
    given = {"controller": args.controller, "ceiling": args.ceiling}
    for option, value in given.items():
        if value and not args.grip:
            raise UsageError(
                f"--{option} needs --grip, which runs the controller",
                next_step="--grip unix:///run/hand/grip",
            )


def add_intent_option(parser: argparse.ArgumentParser) -> None:
    """--intent."""
    ports = "unix:///PATH or lsl://NAME"
    intent = f"show and record the wearer's command: {ports}"
    parser.add_argument("--intent", metavar="URL", help=intent)


def add_obey_option(parser: argparse.ArgumentParser) -> None:
    """--obey-intent."""
    obey = "let it open the hand, as --commands does"
    parser.add_argument("--obey-intent", action="store_true", help=obey)


def require_intent(args: argparse.Namespace) -> None:
    """Raise UsageError for --obey-intent without --intent."""
    if args.obey_intent and not args.intent:
        from holdfast.live.intent import ADDRESSES

        raise UsageError(
            "--obey-intent needs --intent", next_step=f"--intent {ADDRESSES}"
        )


def add_job_options(parser: argparse.ArgumentParser, processes: int) -> None:
    """The options that `evaluate`, `make loop`, the cost benchmark and `make real` share.

    processes: the default.
    """
    option = parser.add_argument
    jobs = f"processes (default {processes})"
    option("--jobs", type=_process_count, default=processes, metavar="N", help=jobs)
    dask = (
        "run on a Dask cluster instead: the address of its scheduler (docs/cluster.md)"
    )
    option("--dask", metavar="ADDRESS", help=dask)


def chosen_workers(args: argparse.Namespace) -> Workers:
    """Where the user wants jobs to run."""
    from holdfast.evaluation.jobs import Workers

    return Workers(args.jobs, args.dask)


def _process_count(word: str) -> int:
    if not word.isdecimal() or int(word) < 1:
        raise argparse.ArgumentTypeError(
            f"{word!r} is not a number of processes from 1 on"
        )
    return int(word)


def add_engine_option(parser: argparse.ArgumentParser) -> None:
    """--engine."""
    engine = "what computes a step: onnxruntime (default), or a library by holdfast export --to c"
    parser.add_argument("--engine", choices=ENGINES, default=ONNXRUNTIME, help=engine)


def add_engine_options(parser: argparse.ArgumentParser) -> None:
    """The options that `run` and `make loop` share."""
    add_engine_option(parser)
    option = parser.add_argument
    library = "the library of --engine c (default MODEL-c/libholdfast.so)"
    option("--library", type=path_argument, metavar="FILE", help=library)


def chosen_model(args: argparse.Namespace) -> ModelChoice:
    """The file of args.model with the engine that the user chose."""
    # Some commands look for the library beside the model alone.
    given = getattr(args, "library", None)
    # As text: the choice is sent to other processes and written into results.
    library = None if given is None else str(given)
    return ModelChoice(str(args.model), args.engine, library)
