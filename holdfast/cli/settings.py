"""Settings of a hand in a file, so that they need not be typed again: holdfast.toml.

    source = "usb://ft232h"
    calibration = "hand.calibration.json"
    bias = "hand.bias.json"
    model = "holdfast-150hz"          # a shipped one, or a file

    grip = "unix:///run/hand/grip"    # from here on of holdfast run alone
    ceiling_n = 40.0
    to = ["udp://127.0.0.1:9000"]

Files are looked for next to the settings. A value on the command line wins.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec

from holdfast.cli.command import Parser, path_argument
from holdfast.core.errors import DataNotFound
from holdfast.core.schema import read, shipped

DEFAULT = Path("holdfast.toml")
FILES = ("calibration", "bias", "model", "library", "cues")
"""Whose values are names of files."""
Text = Annotated[str, msgspec.Meta(min_length=1)]


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What may stand in the file: values as they would be typed, None where they do not.

    hand: the hand card of recordings; engine: as --engine; library: the C form; ceiling_n: largest
    grip of the hand, N of either side; feedback: where cues go, and cues: their table.
    """

    source: Text | None = None
    model: Text | None = None
    calibration: Text | None = None
    bias: Text | None = None
    wearer: Text | None = None
    hand: Text | None = None
    grip: Text | None = None
    to: tuple[Text, ...] = ()
    engine: Literal["auto", "onnxruntime", "c"] | None = None
    library: Text | None = None
    controller: Text | None = None
    ceiling_n: Annotated[float, msgspec.Meta(gt=0.0, le=1e4)] | None = None
    feedback: Text | None = None
    cues: Text | None = None

    def given(self) -> dict[str, Any]:
        """The values that the file gives, by name."""
        return {
            key: value for key, value in msgspec.structs.asdict(self).items() if value
        }


class SettingsFile(NamedTuple):
    """Settings, and the file that they stand in; None without one."""

    path: Path | None
    settings: Settings


def read_settings(argv: Sequence[str]) -> SettingsFile:
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

    path = named or DEFAULT
    if named is None and not path.is_file():
        return SettingsFile(None, Settings())
    try:
        settings = read(path, Settings)
    except FileNotFoundError:
        raise DataNotFound(
            "no such file of settings",
            where=path,
            next_step="check the path after --config",
        ) from None

    placed = {}
    for name, value in settings.given().items():
        # a shipped model is found by its name, in any folder
        if name in FILES and not (name == "model" and value in shipped()):
            placed[name] = str(path.parent / value)
    return SettingsFile(path, msgspec.structs.replace(settings, **placed))


def add_config_option(parser: argparse.ArgumentParser) -> None:
    """--config, which `read_settings` reads before the parser does."""
    config = "settings of the hand (default: holdfast.toml, if it is here)"
    parser.add_argument("--config", type=path_argument, metavar="FILE", help=config)


class SettingsParser(Parser):
    """A parser whose options have their defaults from settings; the others are args.settings.

    An option, or an argument such as MODEL, that settings give is no longer required.
    """

    def __init__(self, *, settings: Settings, **options: Any) -> None:
        self._given = settings.given()
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
