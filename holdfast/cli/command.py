"""How all programs of Holdfast report errors and end: one line for each error, and an exit code.

Exit codes: 0 done, 1 failed, 2 usage, 3 data, 4 model, 5 output, 6 device, 130 interrupted.

`--json [FILE]`: what a command found as one JSON object, with its words or instead of them.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NoReturn, TextIO

from holdfast.core.errors import (
    HoldfastError,
    OutputError,
    UsageError,
    one_line,
    visible_lines,
)
from holdfast.core.lines import stream_sink

WITH_SETTINGS = ("run", "record", "bias", "study", "replay")
"""Commands whose options may stand in holdfast.toml."""


class Parser(argparse.ArgumentParser):
    """argparse with usage errors of one line: what is wrong, what is allowed, the next command."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError instead of printing the whole usage."""
        raise UsageError(message, next_step=f"{self.prog} --help")


def whole(least: int, most: int = 2**32 - 1) -> Callable[[str], int]:
    """What reads a whole number from the command line, within bounds."""

    def read(word: str) -> int:
        # isdecimal refuses signs, points and spaces, which int() would take
        number = int(word) if word.isdecimal() else -1
        if not least <= number <= most:
            raise argparse.ArgumentTypeError(
                f"{word!r} is not a whole number from {least} to {most}"
            )
        return number

    return read


seed = whole(0)
"""A seed: all that generators take."""


def path_argument(word: str) -> Path:
    """A path from the command line. An empty one (a shell variable that is not set) is an error."""
    # Path("") would be the current folder, which an unset variable does not mean
    if not word.strip():
        raise argparse.ArgumentTypeError("the path is empty")
    return Path(word)


def number(least: float, most: float) -> Callable[[str], float]:
    """What reads a number from the command line, within bounds."""

    def read(word: str) -> float:
        value = float(word)
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f"{word!r} is not a number from {least:g} to {most:g}"
            )
        return value

    return read


positive = number(1e-6, 1e9)
"""A time, a rate, a size or a force: their quotients are times and counts."""


def show(text: str) -> None:
    """Print lines that may hold names from outside, such as those of files, columns or devices."""
    sys.stdout.write(f"{visible_lines(text)}\n")


def finish(main: Callable[[Sequence[str]], int], argv: Sequence[str]) -> int:
    """Run a program's main.

    Errors and warnings become one line each on stderr, except with --debug.

    A stderr that takes no data neither blocks the program nor keeps it from ending.
    """
    # First: the next file that is opened would get the number of a closed stream.
    hold_standard_descriptors()
    with closing(stream_sink(sys.stderr)) as on_stderr:
        if "--debug" not in argv:
            warnings.showwarning = _one_line_to(on_stderr)
        try:
            # --debug is an option of every program, so no parser needs to know it.
            code = main([word for word in argv if word != "--debug"])
            # Flushed here, so that an error of the last lines still becomes an exit code.
            sys.stdout.flush()
            return code
        # 130 is 128 + SIGINT, as shells report it.
        except KeyboardInterrupt:
            on_stderr("interrupted")
            return 130
        # The reader of a pipe has seen enough (`| head`): that is no failure.
        except BrokenPipeError:
            return 0
        except (HoldfastError, ModuleNotFoundError, OSError) as error:
            if "--debug" in argv:
                raise
            shown = _as_ours(error)
            on_stderr(f"error: {type(shown).__name__}: {shown}")
            return shown.exit_code
        finally:
            _forget_what_cannot_be_written(sys.stdout)


def hold_standard_descriptors() -> None:
    """Open closed standard descriptors on /dev/null, before another file gets their numbers.

    Such a file would receive all that a library prints. As stdout, /dev/null is opened read-only:
    writing a result to a closed stdout stays an error.
    """
    for number, mode in ((0, os.O_RDONLY), (1, os.O_RDONLY), (2, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, mode)  # takes the lowest free number

    sys.stdout = sys.stdout or os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(
        2, "w", encoding="utf-8", closefd=False, buffering=1
    )


def _forget_what_cannot_be_written(stream: TextIO) -> None:
    """Drop what stdout cannot take.

    Python flushes it at the end and would report the same error again.
    """
    try:
        stream.flush()
    except OSError:
        # The stream keeps its number, and what is left in it goes nowhere.
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stream.fileno())
        os.close(nothing)


def _as_ours(error: Exception) -> HoldfastError:
    """The error with an exit code of ours."""
    if isinstance(error, HoldfastError):
        return error
    if not isinstance(error, ModuleNotFoundError):
        step = "choose another place to write to; --debug shows the whole error"
        return OutputError(str(error), next_step=step)
    # the modules of other extras name these themselves (core/errors.py: needs_extra)
    extra = "dask" if error.name == "distributed" else "train,viz"
    return UsageError(
        f"this needs the package {error.name}",
        cause="only an extra installs it",
        next_step=f"pip install 'holdfast[{extra}]'",
    )


def _one_line_to(on_stderr: Callable[[str], object]) -> Callable[..., None]:
    # file, line and the like are not shown
    def show_warning(
        message: Warning | str, category: type[Warning], *_: object, **__: object
    ) -> None:
        on_stderr(f"warning: {category.__name__}: {one_line(str(message))}")

    return show_warning


STDOUT = Path("-")


def add_seed_option(
    parser: argparse.ArgumentParser, of: str = "every random choice"
) -> None:
    """--seed, 0 where none is given. of: what it is the seed of."""
    parser.add_argument(
        "--seed", type=seed, default=0, metavar="S", help=f"seed of {of} (default 0)"
    )


def add_out_option(
    parser: argparse.ArgumentParser, written: str = "a new folder", metavar: str = "DIR"
) -> None:
    """--out, without which a verb has nowhere to write. written: what it will be."""
    parser.add_argument(
        "--out", type=path_argument, required=True, metavar=metavar, help=written
    )


def add_report_option(parser: argparse.ArgumentParser, shows: str) -> None:
    """--report. shows: what stands on the page."""
    parser.add_argument(
        "--report",
        type=path_argument,
        metavar="OUT",
        help=f"write a report (HTML): {shows}",
    )


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """--json, which means the same in every command."""
    parser.add_argument(
        "--json",
        nargs="?",
        const=STDOUT,
        type=path_argument,
        metavar="FILE",
        help="what was found as one JSON object, to FILE; without FILE to stdout, instead of words",
    )


def require_results_writable(args: argparse.Namespace) -> None:
    """Raise OutputError where a file of --json or --report cannot be written.

    Before the work begins: a run of hours must not end with a folder that cannot be written to.
    """
    from holdfast.core.writing import require_writable

    for path in (args.json, getattr(args, "report", None)):
        if path not in (None, STDOUT):
            require_writable(path.parent)


def show_found(args: argparse.Namespace, words: str, found: Mapping[str, Any]) -> None:
    """Print the words, or the JSON object instead; write the object where --json names a file.

    found: no NaN and no infinity in it.
    """
    if args.json != STDOUT:
        show(words)
    write_found(args, found)


def write_found(args: argparse.Namespace, found: Mapping[str, Any]) -> None:
    """Only the JSON object, where --json wants it."""
    if args.json is None:
        return
    # No NaN: other languages cannot read it.
    text = json.dumps(found, indent=1, allow_nan=False, default=str) + "\n"
    if args.json == STDOUT:
        sys.stdout.write(text)
        return
    from holdfast.core.writing import write_whole

    write_whole(args.json, text)
