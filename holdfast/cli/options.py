"""Options that several verbs share: each is declared here once.

What their values mean stands below, in the packages that use them; here words become values.
"""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

from holdfast.cli.command import path_argument, positive
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


def add_page_option(parser: argparse.ArgumentParser) -> None:
    """--to, of a verb that shows a page and nothing else."""
    web = "web[:[HOST:]PORT]: show it on a page in the browser (docs/live-page.md)"
    parser.add_argument("--to", type=_page, metavar="web[:PORT]", help=web)


def _page(word: str) -> str:
    """[HOST:]PORT of web[:[HOST:]PORT]."""
    from holdfast.live.outputs import output_url

    output = output_url(word)
    if output.kind != "web":
        raise argparse.ArgumentTypeError(f"{word!r} is not web or web:PORT")
    return output.place


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
    add_wearer_option(parser)


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


def add_wearer_option(parser: argparse.ArgumentParser) -> None:
    """--wearer."""
    urls = "unix:///PATH, serial:///dev/ttyX, lsl://NAME, - or replay://FILE"
    wearer = f"the stream of what the wearer wants: open, close, stop; {urls}"
    parser.add_argument("--wearer", metavar="URL", help=wearer)


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


def add_engine_option(
    parser: argparse.ArgumentParser, default: str = ONNXRUNTIME
) -> None:
    """--engine."""
    engine = (
        "what computes a step: onnxruntime, c (a library by holdfast export --to c), "
        f"or auto: c where it is (default {default})"
    )
    parser.add_argument("--engine", choices=ENGINES, default=default, help=engine)


def chosen_model(args: argparse.Namespace) -> ModelChoice:
    """The file of args.model with the engine that the user chose."""
    # Some commands look for the library beside the model alone.
    given = getattr(args, "library", None)
    # As text: the choice is sent to other processes and written into results.
    library = None if given is None else str(given)
    return ModelChoice(str(args.model), args.engine, library)
