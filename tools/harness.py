"""What all studies and benchmarks share: how one is started by its name, the scenes that it
simulates first, and how its figures are written.

    python -m studies adapt
    python -m benchmarks cost

A program is a module with `add_arguments(parser)`, for options of its own, and `run(args) -> int`.
`--out` and `--seed` are options of every program.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from importlib import import_module
from pathlib import Path

from holdfast.cli.command import Parser, finish, path_argument, seed
from holdfast.cli.main import main
from holdfast.cli.options import add_engine_option
from holdfast.core.contract import Json
from holdfast.core.errors import HoldfastError, UsageError
from holdfast.core.writing import write_whole
from holdfast.evaluation.style import dark_rules

AT_ONCE = 2


def run_script(
    prog: str,
    about: str,
    add_arguments: Callable[[argparse.ArgumentParser], None],
    run: Callable[[argparse.Namespace], int],
    argv: Sequence[str] | None = None,
) -> int:
    """Start a program that is no verb: parse, run, and end like every program of Holdfast.

    argv: None for the words that it was started with.
    """

    def main(argv: Sequence[str]) -> int:
        parser = Parser(
            prog=prog,
            description=about,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_arguments(parser)
        return run(parser.parse_args(argv))

    return finish(main, sys.argv[1:] if argv is None else argv)


@dataclass(frozen=True)
class Program:
    """A program by its module, what it does in one line, and where its results go by default."""

    module: str
    about: str
    out: str


@dataclass(frozen=True)
class SimulatedSet:
    """A set that `holdfast simulate` writes. folder: below the program's own; scene: a name or a
    file. trials, rate_hz: None for those of the scene."""

    folder: str
    scene: str
    trials: int | None = None
    seed: int = 0
    rate_hz: float | None = None

    def command(self, out: Path) -> list[str]:
        """The words behind `holdfast` that write this set into the folder `out`."""
        words = ["simulate", self.scene]
        if self.trials is not None:
            words += ["--trials", str(self.trials)]
        if self.rate_hz is not None:
            words += ["--rate", f"{self.rate_hz:g}"]
        return [*words, "--seed", str(self.seed), "--out", str(out / self.folder)]


def simulate_sets(sets: Sequence[SimulatedSet], out: Path) -> None:
    """Simulate the sets into folders of `out`, two at a time. Earlier sets of that name go."""
    for one in sets:
        shutil.rmtree(out / one.folder, ignore_errors=True)
    run_holdfast([one.command(out) for one in sets])


def run_holdfast(commands: Sequence[Sequence[str]]) -> None:
    """Run `holdfast` with each of these words, two at a time. Raises HoldfastError."""
    from holdfast.evaluation.jobs import Workers

    # as workers, which end with this program however it ends
    codes = Workers(AT_ONCE).run([partial(main, one) for one in commands])
    for words, code in zip(commands, codes, strict=True):
        if code:
            failed = f"`holdfast {shlex.join(words)}` ended with exit code {code}"
            raise HoldfastError(failed, cause="its own error stands above")


def write_figures(path: Path, figures: Json) -> Path:
    """Write figures as JSON together with the machine that they were measured on.

    A figure that is not a number is an error, for such a file is read by nothing else.
    """
    from holdfast.evaluation.formats import host

    content = {"host": asdict(host()), **figures}
    return write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def measured_now() -> Json:
    """The command that is running, the day, and the commit: what a kept figure is dated with."""
    words = ["git", "rev-parse", "--short=12", "HEAD"]
    found = subprocess.run(words, capture_output=True, text=True, check=False)
    program = Path(sys.argv[0]).parent.name
    return {
        "command": f"python -m {program} {shlex.join(sys.argv[1:])}",
        "measured_on": datetime.now(UTC).date().isoformat(),
        # a copy without its history has no commit to name
        "commit": found.stdout.strip() or None,
    }


def start(folder: str, programs: Mapping[str, Program], argv: Sequence[str]) -> int:
    """Run the program that the first word names, or list all of them."""
    if not argv or argv[0] in ("-h", "--help", "list"):
        width = max(map(len, programs)) + 2
        for name, program in programs.items():
            print(f"  {name:<{width}}{program.about}")
        return 0
    if argv[0] not in programs:
        return finish(lambda words: _unknown(folder, programs, words[0]), argv)
    return _start_program(folder, argv[0], programs[argv[0]], argv[1:])


def _unknown(folder: str, programs: Mapping[str, Program], word: str) -> int:
    raise UsageError(
        f"unknown name {word!r}; choose from {', '.join(programs)}",
        next_step=f"python -m {folder}",
    )


def _start_program(
    folder: str, name: str, program: Program, words: Sequence[str]
) -> int:
    # loaded only now: the list and a wrong name need no library
    module = import_module(program.module)

    def add_arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--out",
            type=path_argument,
            default=Path(program.out),
            metavar="DIR",
            help=f"folder of the results (default {program.out})",
        )
        parser.add_argument(
            "--seed",
            type=seed,
            default=0,
            metavar="S",
            help="seed of every random choice (default 0, or that of the study)",
        )
        module.add_arguments(parser)

    name_of_program = f"python -m {folder} {name}"
    return run_script(name_of_program, program.about, add_arguments, module.run, words)


def add_engine_options(parser: argparse.ArgumentParser) -> None:
    """The options of the engine, of a study."""
    add_engine_option(parser)
    library = "the library of --engine c (default MODEL-c/libholdfast.so)"
    parser.add_argument("--library", type=path_argument, metavar="FILE", help=library)


def for_any_page(svg: str) -> str:
    """A file of its own: with other ink and paper where the reader prefers dark."""
    end = svg.index(">", svg.index("<svg")) + 1
    return f"{svg[:end]}<style>{dark_rules()}</style>{svg[end:]}"
