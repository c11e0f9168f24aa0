"""Settings of a hand in a file, so that they need not be typed again: holdfast.toml.

    source = "usb://ft232h"
    calibration = "hand.calibration.json"
    bias = "hand.bias.json"
    model = "holdfast-150hz"          # a shipped one, or a file

    [sinks]                           # of holdfast run
    udp = "127.0.0.1:9000"

Files are looked for next to the settings. A value on the command line wins.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from holdfast.cli.command import WITH_SETTINGS, Parser, path_argument
from holdfast.core.errors import CardError, DataNotFound
from holdfast.core.reading import CardReader, read_toml
from holdfast.core.schema import shipped

DEFAULT = Path("holdfast.toml")
HAND = ("source", "calibration", "bias", "model", "intent")
SINKS = ("out", "udp", "lsl", "grip", "feedback", "cues", "web")
FILES = ("calibration", "bias", "model", "out", "cues")
"""Whose values are names of files."""


@dataclass(frozen=True)
class Settings:
    """Values by option as they would be typed, and the file that they stand in."""

    path: Path | None = None
    values: dict[str, str] = field(default_factory=dict)

    def of(self, verb: str) -> dict[str, str]:
        """Those that hold for a command: sinks are of `run` alone."""
        allowed = (
            (*HAND, *SINKS) if verb == "run" else HAND if verb in WITH_SETTINGS else ()
        )
        return {name: value for name, value in self.values.items() if name in allowed}


def read_settings(argv: Sequence[str]) -> Settings:
    """The settings that --config names, or those of holdfast.toml here, or none.

    Raises DataNotFound for a file that --config names and that is missing, and CardError.
    """
    # A parser of its own: --config must be known before the command's parser is made.
    finder = argparse.ArgumentParser(
        add_help=False, allow_abbrev=False, exit_on_error=False
    )
    finder.add_argument("--config", type=path_argument)
    try:
        named = finder.parse_known_args(list(argv))[0].config
    except argparse.ArgumentError:
        named = None  # the command's parser reports what is wrong

    if named is None and not DEFAULT.is_file():
        return Settings()
    return _read(named or DEFAULT)


def _read(path: Path) -> Settings:
    try:
        _, raw = read_toml(path)
    except FileNotFoundError:
        raise DataNotFound(
            "no such file of settings",
            where=path,
            next_step="check the path after --config",
        ) from None

    card = CardReader(path)
    card.require_known(raw, (*HAND, "sinks"), "settings")
    sinks = card.table(raw, "sinks")
    card.require_known(sinks, SINKS, "[sinks]")
    # Sinks stand in a table of their own in the file, and among the others on the command line.
    given = {name: value for name, value in raw.items() if name != "sinks"} | sinks
    return Settings(
        path, {name: _value(path, name, value) for name, value in given.items()}
    )


def _value(path: Path, name: str, value: object) -> str:
    # Values stand as they would be typed, so all of them are texts.
    if not isinstance(value, str) or not value.strip():
        raise CardError(
            f"{name} = {value!r:.80} is no text",
            where=path,
            next_step=f'write it as on the command line, in quotes: {name} = ".."',
        )

    # A shipped model is found by its name, in any folder.
    is_file = name in FILES and not (name == "model" and value in shipped())
    return str(path.parent / value) if is_file else value


def add_config_option(parser: argparse.ArgumentParser) -> None:
    """--config, which `read_settings` reads before the parser does."""
    config = "settings of the hand (default: holdfast.toml, if it is here)"
    parser.add_argument("--config", type=path_argument, metavar="FILE", help=config)


class SettingsParser(Parser):
    """A parser whose options have their defaults from settings.

    An option, or an argument such as MODEL, that settings give is no longer required.
    """

    def __init__(self, *, settings: dict[str, str], **options: Any) -> None:
        self._settings = settings
        super().__init__(**options)
        add_config_option(self)

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """As argparse's, with the default from the settings."""
        name = names[-1].lstrip("-")
        if name in self._settings:
            options["default"] = self._settings[name]
            # An option with a default must not be required; a positional argument becomes
            # optional.
            if names[0].startswith("-"):
                options.pop("required", None)
            else:
                options["nargs"] = "?"

        return super().add_argument(*names, **options)
