"""How all programs of Holdfast report errors and end: one line for each error, and an exit code.

Exit codes: 0 done, 1 failed, 2 usage, 3 data, 4 model, 5 output, 6 device, 130 interrupted.

`--json [FILE]`: what a command found as one JSON object, with its words or instead of them.
"""

from __future__ import annotations

import argparse
import errno
import io
import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NoReturn, TextIO

from holdfast.core.errors import (
    DataError,
    HoldfastError,
    OutputError,
    UsageError,
    one_line,
    visible_lines,
)
from holdfast.core.lines import stream_sink

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)
"""Errors of writing alone."""
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
    _show_every_name()
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
        # UnicodeError: a name that is not UTF-8, in a library that takes only such.
        except (
            HoldfastError,
            ModuleNotFoundError,
            OSError,
            UnicodeError,
        ) as error:
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


def _show_every_name() -> None:
    """Print what the locale cannot show as its escape: names of files may be any bytes."""
    for stream in (sys.stdout, sys.stderr):
        # a test's stream, such as StringIO, takes every text
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


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
    if isinstance(error, UnicodeError):
        return UsageError(
            "a name or a text is not UTF-8",
            cause=one_line(str(error)),
            next_step="rename the file or folder; --debug shows the whole error",
        )
    if isinstance(error, OSError):
        # What is written to a file is an OutputError already.
        if error.filename is None or error.errno in FULL:
            step = "choose another place to write to; --debug shows the whole error"
            return OutputError(str(error), next_step=step)
        return DataError(
            f"cannot be read ({error.strerror})",
            where=os.fsdecode(error.filename),
            cause="no permission, a damaged disk, or no path of a file",
            next_step="check the path; --debug shows the whole error",
        )
    # the modules of other extras name these themselves (core/errors.py: needs_extra)
    missing = error.name if isinstance(error, ModuleNotFoundError) else error
    extra = "dask" if missing == "distributed" else "train,viz"
    return UsageError(
        f"this needs the package {missing}",
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
CARD_SUFFIX = ".json"
"""As holdfast.edge_runtime has it; repeated here so that --help need not import it."""
RESULTS = ("json", "report")
"""Options whose value is a file to write."""


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
    # Some verbs replace more with it, and say so.
    if "--force" not in parser._option_string_actions:
        parser.add_argument(
            "--force", action="store_true", help="replace files that exist"
        )


def require_outputs(
    args: argparse.Namespace,
    *files: Path,
    replaced: Iterable[Path] = (),
    folder: Path | None = None,
) -> None:
    """Raise OutputError where a file of --json, --report or files may not be written.

    Before the work begins: a run of hours must not end with a file that cannot be written, and a
    verb that is refused leaves nothing behind. replaced: files which each run writes anew. folder:
    a new one that the verb fills.
    """
    from holdfast.core import writing

    named = [getattr(args, name, None) for name in RESULTS]
    # A study's --report is no file, and --json alone is stdout.
    results = [path for path in named if isinstance(path, Path) and path != STDOUT]
    writing.require_outputs(
        [*files, *results],
        inputs_of(args),
        force=getattr(args, "force", False),
        replaced=replaced,
        folder=folder,
    )


def inputs_of(args: argparse.Namespace) -> list[Path]:
    """What exists of the files that the options name, but for those that are written."""
    words: list[object] = []
    for name, value in vars(args).items():
        if name not in (*RESULTS, "out"):
            words += value if isinstance(value, list) else [value]
    inputs = []
    for word in words:
        # A URL may name several files: sim://CARD, FILE.csv, virtual://ft232h?scene=CARD.
        parts = re.split(r"://|[?&=]", word) if isinstance(word, str) else [word]
        paths = [Path(part) for part in parts if isinstance(part, (str, Path))]
        inputs += paths
        # The card of a model is read with it.
        inputs += [
            path.with_suffix(CARD_SUFFIX) for path in paths if path.suffix == ".onnx"
        ]
    # Not by Path.exists, which raises for words that are too long for a name.
    return [path for path in inputs if os.path.exists(path)]


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
    from holdfast.core.writing import require_free, write_whole

    # What is there now and was not before the work is a result of this very command.
    require_free(args.json, force=args.force)
    write_whole(args.json, text)
