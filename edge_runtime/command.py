"""How our programs speak and end: one line an error, an exit code with a meaning, no traceback.

Exit codes: 0 done, 1 failed, 2 usage, 3 data, 4 model, 5 output, 6 device, 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import NoReturn, TextIO

from edge_runtime.errors import HoldfastError, OutputError, UsageError
from edge_runtime.log_sink import stream_sink
from edge_runtime.visible import one_line, visible_lines


class Parser(argparse.ArgumentParser):
    """argparse, with a usage error that is one line: what is wrong, what is allowed, the next
    command."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError instead of printing the whole usage."""
        raise UsageError(message, next_step=f"{self.prog} --help")


def seed(word: str) -> int:
    """A seed from the command line: 0 .. 2^32 - 1, what every generator of ours takes."""
    number = int(word) if word.isdecimal() else -1
    if not 0 <= number < 2**32:
        raise argparse.ArgumentTypeError(f"{word!r} is not a whole number from 0 to {2**32 - 1}")
    return number


def path_argument(word: str) -> Path:
    """A path from the command line; an empty one is a variable somebody forgot to set, not the
    folder we are in."""
    if not word.strip():
        raise argparse.ArgumentTypeError("an empty path")
    return Path(word)


def positive(word: str) -> float:
    """A number above zero from the command line."""
    number = float(word)
    if not 0.0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"{word!r} is not a number above 0")
    return number


def show(text: str) -> None:
    """Print lines that may hold names from outside: a file's, a column's, a device's."""
    sys.stdout.write(f"{visible_lines(text)}\n")


def run_script(
    prog: str,
    about: str,
    add_arguments: Callable[[argparse.ArgumentParser], None],
    run: Callable[[argparse.Namespace], int],
) -> int:
    """A verb run as a script of its own: parse sys.argv, run, end as every program of ours ends."""

    def main(argv: Sequence[str]) -> int:
        parser = Parser(
            prog=prog, description=about, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        add_arguments(parser)
        return run(parser.parse_args(argv))

    return finish(main, sys.argv[1:])


def finish(main: Callable[[Sequence[str]], int], argv: Sequence[str]) -> int:
    """Run a program's main; errors and warnings become one line each on stderr, unless --debug is
    given.

    A stderr that takes nothing neither stops the program nor keeps it from ending.
    """
    hold_standard_descriptors()
    with closing(stream_sink(sys.stderr)) as beside:
        if "--debug" not in argv:
            warnings.showwarning = _one_line_to(beside)
        try:
            code = main([word for word in argv if word != "--debug"])
            sys.stdout.flush()
            return code
        except (HoldfastError, ModuleNotFoundError) as error:
            if "--debug" in argv:
                raise
            told = error if isinstance(error, HoldfastError) else _not_installed(error)
            beside(f"error: {type(told).__name__}: {told}")
            return told.exit_code
        except KeyboardInterrupt:
            beside("interrupted")
            return 130
        except BrokenPipeError:
            return 0
        except OSError as error:
            if "--debug" in argv:
                raise
            what = one_line(str(error))
            beside(
                f"error: OutputError: {what}; next: choose another place, or see the whole with --debug"
            )
            return OutputError.exit_code
        finally:
            _forget_what_cannot_be_written(sys.stdout)


def hold_standard_descriptors() -> None:
    """Lead standard descriptors that are closed to /dev/null, before a file of ours gets such a
    number.

    With the number it would get all that a library prints. /dev/null is only readable as stdout: a
    result that is written there is an error, as it was before.
    """
    for number, mode in ((0, os.O_RDONLY), (1, os.O_RDONLY), (2, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, mode)  # takes the lowest free number
    sys.stdout = sys.stdout or os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", encoding="utf-8", closefd=False, buffering=1)


def _forget_what_cannot_be_written(stream: TextIO) -> None:
    """Python writes the rest of a stream when it ends, and would tell of the same error once
    more."""
    try:
        stream.flush()
    except OSError:
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stream.fileno())
        os.close(nothing)


def _not_installed(error: ModuleNotFoundError) -> UsageError:
    return UsageError(
        f"this needs the package {error.name}",
        cause="only the live path is installed",
        next_step="pip install 'holdfast[train,viz]'; holdfast doctor says what is missing",
    )


def _one_line_to(beside: Callable[[str], object]) -> Callable[..., None]:
    def tell(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        beside(f"warning: {category.__name__}: {one_line(str(message))}")

    return tell
