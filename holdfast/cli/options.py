"""Options that several verbs share: each is declared here once.

What their values mean stands below, in the packages that use them; here words become values.

Settings of a hand may stand in a file, holdfast.toml, so that they need not be typed again:

    source = "usb://ft232h"
    calibration = "hand.calibration.json"
    bias = "hand.bias.json"
    model = "holdfast-150hz"          # a shipped one, or a file

    grip = "unix:///run/hand/grip"    # from here on of holdfast run alone
    ceiling_n = 40.0
    to = ["udp://127.0.0.1:9000"]

live/run.py has all keys. Files are looked for next to the settings. A value on the command line
wins.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.cli.command import Parser, number, path_argument, positive, whole
from holdfast.core.errors import DataNotFound
from holdfast.core.schema import DEFAULT_MODEL, read, shipped
from holdfast.edge_runtime.engine import ENGINES, ONNXRUNTIME, ModelChoice

if TYPE_CHECKING:
    from holdfast.evaluation.jobs import Workers
    from holdfast.live.sources import SetReader

RATE_HZ = 150.0
CORES = len(os.sched_getaffinity(0))
"""That this process may use."""
SIDE_MM = (1.0, 200.0)
"""Plausible sides of a tag; a number outside is probably not in millimetres."""


def add_hand_options(
    parser: argparse.ArgumentParser,
    *,
    required: bool = True,
    default: str | None = None,
) -> None:
    """--source and --calibration. required: the verb does nothing without a source."""
    parser.add_argument(
        "--source",
        required=required,
        default=default,
        metavar="URL",
        help="usb://ft232h, i2c://1, virtual://ft232h?scene=.., sim://CARD, lsl://NAME, or lines: "
        "- (stdin), unix:///PATH, serial:///dev/ttyACM0 (docs/on-a-hand.md)",
    )
    parser.add_argument(
        "--calibration",
        type=path_argument,
        metavar="FILE",
        help="map from field to force, made by holdfast calibrate",
    )


def set_reader(source: str) -> SetReader | None:
    """What reads a source such as SET#N; its packages are loaded only where they are needed."""
    # Only a source with a number sign is a trial of a set.
    if "#" not in source:
        return None
    from holdfast.sessions.set_source import read_set_trial

    return read_set_trial


def add_model_argument(parser: argparse.ArgumentParser) -> None:
    """MODEL, the shipped one where none is named."""
    parser.add_argument(
        "model",
        nargs="?",
        default=DEFAULT_MODEL,
        metavar="MODEL",
        help=f"a sealed model file (default: the shipped {DEFAULT_MODEL})",
    )


def add_seconds_option(
    parser: argparse.ArgumentParser, about: str, default: float | None = None
) -> None:
    """--seconds. about: what they limit."""
    parser.add_argument(
        "--seconds", type=positive, default=default, metavar="S", help=about
    )


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """The options that `record` and `study` share."""
    option = parser.add_argument
    option(
        "--rate",
        type=positive,
        default=RATE_HZ,
        metavar="HZ",
        help=f"sampling rate of a hand (default {RATE_HZ:g})",
    )
    option("--anyway", action="store_true", help="record even if the bias is not good")
    add_seconds_option(parser, "end and keep a trial after S seconds")
    option(
        "--hand",
        metavar="CARD",
        help="hand card, by name or path (docs/scenes.md#hands); the recordings keep a copy",
    )
    option("--camera", metavar="oak|FILE", help="film every trial (docs/camera.md)")
    add_camera_options(parser)
    add_wearer_option(parser)


def add_camera_options(parser: argparse.ArgumentParser) -> None:
    """--tag-mm, --fps and --exposure-ms, which an OAK camera needs."""
    option = parser.add_argument
    option(
        "--tag-mm",
        type=number(*SIDE_MM),
        metavar="MM",
        help="oak: measured side of the printed tags",
    )
    option(
        "--fps",
        type=number(1.0, 1000.0),
        metavar="HZ",
        help="oak: frames a second (default 60)",
    )
    option(
        "--exposure-ms",
        type=number(1e-3, 1000.0),
        metavar="MS",
        help="oak: exposure (default 2)",
    )


def add_wearer_option(parser: argparse.ArgumentParser) -> None:
    """--wearer, where the wearer's intent comes from."""
    urls = "unix:///PATH, serial:///dev/ttyX, lsl://NAME, - or replay://FILE"
    parser.add_argument(
        "--wearer",
        metavar="URL",
        help=f"the stream of what the wearer wants: open, close, stop; {urls}",
    )


def add_job_options(parser: argparse.ArgumentParser, processes: int) -> None:
    """The options that `evaluate`, `make loop`, the cost benchmark and `make real` share.

    processes: the default.
    """
    option = parser.add_argument
    option(
        "--jobs",
        type=whole(1),
        default=processes,
        metavar="N",
        help=f"processes (default {processes})",
    )
    option(
        "--dask",
        metavar="ADDRESS",
        help="run on a Dask cluster instead: the address of its scheduler (docs/formats.md)",
    )


def chosen_workers(args: argparse.Namespace) -> Workers:
    """Where the user wants jobs to run."""
    from holdfast.evaluation.jobs import Workers

    return Workers(args.jobs, args.dask)


def add_engine_option(
    parser: argparse.ArgumentParser, default: str = ONNXRUNTIME
) -> None:
    """--engine, what computes a step."""
    parser.add_argument(
        "--engine",
        choices=ENGINES,
        default=default,
        help="what computes a step: onnxruntime, c (a library by holdfast export --to c), "
        f"or auto: c where it is (default {default})",
    )


def chosen_model(args: argparse.Namespace) -> ModelChoice:
    """The file of args.model with the engine that the user chose."""
    # Some commands look for the library beside the model alone.
    given = getattr(args, "library", None)
    # As text: the choice is sent to other processes and written into results.
    library = None if given is None else str(given)
    return ModelChoice(str(args.model), args.engine, library)


# -- settings of a hand

DEFAULT = Path("holdfast.toml")
FILES = ("calibration", "bias", "model", "library", "cues")
"""Whose values are names of files."""


def settings_file(argv: Sequence[str]) -> Path | None:
    """The file that --config names, or holdfast.toml if it is here, or None."""
    # A parser of its own: --config must be known before the command's parser is made.
    finder = argparse.ArgumentParser(
        add_help=False, allow_abbrev=False, exit_on_error=False
    )
    add_config_option(finder)
    try:
        named: Path | None = finder.parse_known_args(list(argv))[0].config
    except argparse.ArgumentError:
        named = None  # the command's parser reports what is wrong
    return named or (DEFAULT if DEFAULT.is_file() else None)


def read_settings(path: Path | None) -> dict[str, Any]:
    """The values in a file of settings, by name; none without one.

    Raises DataNotFound, CardError.
    """
    if path is None:
        return {}
    # only where there is a file: a run loads more than other commands need
    from holdfast.live.run import RunOptions

    try:
        settings = read(path, RunOptions)
    except FileNotFoundError:
        raise DataNotFound(
            "no such file of settings",
            where=path,
            next_step="check the path after --config",
        ) from None

    given = {}
    usual = RunOptions()
    for name in RunOptions.__struct_fields__:
        value = getattr(settings, name)
        # a shipped model is found by its name, in any folder
        if name in FILES and value and value not in shipped():
            value = str(path.parent / value)
        # a shipped card comes after a file beside the settings, as for a scene's hand
        if name == "hand" and value and (path.parent / value).is_file():
            value = str(path.parent / value)
        if value != getattr(usual, name):
            given[name] = value

    if settings.rules:
        from holdfast.live.grip import checked_rules

        given["rules"] = checked_rules(settings.rules, f"{path} [rules]")
    return given


def add_config_option(parser: argparse.ArgumentParser) -> None:
    """--config, which is read before the other options are."""
    parser.add_argument(
        "--config",
        type=path_argument,
        metavar="FILE",
        help="settings of the hand (default: holdfast.toml, if it is here)",
    )


class SettingsParser(Parser):
    """A parser whose options have their defaults from settings; all of them are args.settings.

    An option, or an argument such as MODEL, that settings give is no longer required.
    """

    def __init__(self, *, settings: Mapping[str, Any], **options: Any) -> None:
        self._given = dict(settings)
        # an option that may be repeated would add to its default
        self._given.pop("to", None)
        super().__init__(**options)
        add_config_option(self)
        self.set_defaults(settings=settings)

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """As argparse's, with the default from the settings."""
        name = names[-1].lstrip("-")
        if name in self._given:
            options["default"] = self._given[name]
            # An option with a default must not be required; a positional argument becomes optional.
            if names[0].startswith("-"):
                options.pop("required", None)
            else:
                options["nargs"] = "?"

        return super().add_argument(*names, **options)
