"""Settings of a hand in a file, so that they need not be typed again: holdfast.toml.

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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from holdfast.cli.command import Parser, path_argument
from holdfast.core.errors import DataNotFound
from holdfast.core.schema import read, shipped

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
    for name in RunOptions.__struct_fields__:
        value = getattr(settings, name)
        # a shipped model is found by its name, in any folder
        if name in FILES and value and value not in shipped():
            value = str(path.parent / value)
        if value != getattr(RunOptions(), name):
            given[name] = value
    return given


def add_config_option(parser: argparse.ArgumentParser) -> None:
    """--config, which is read before the other options are."""
    config = "settings of the hand (default: holdfast.toml, if it is here)"
    parser.add_argument("--config", type=path_argument, metavar="FILE", help=config)


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
            # An option with a default must not be required; a positional argument becomes
            # optional.
            if names[0].startswith("-"):
                options.pop("required", None)
            else:
                options["nargs"] = "?"

        return super().add_argument(*names, **options)
