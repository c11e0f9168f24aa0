"""`holdfast VERB ..`: one parser; the module of a verb is imported only for its verb.

Exit codes: 0 done, 1 failed, 2 usage, 3 data, 4 model, 5 output, 6 device, 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import version

from holdfast.cli.command import WITH_SETTINGS, Parser, finish, require_outputs
from holdfast.core.errors import UsageError

GROUPS = {
    "every day": {
        "run": ("run", "read a hand live and answer every sample"),
        "record": ("people", "record trials by keys and a protocol"),
        "replay": ("run", "a model's answers on a recorded trial, as JSON lines"),
        "check": (
            "check",
            "say what a folder of recordings holds and lacks; repair it",
        ),
        "import": ("importing", "turn logs of other programs into trials"),
        "train": ("model", "train on recordings; writes a verified model file"),
        "export": ("model", "export again: elsewhere, to C, for another hand or rule"),
        "evaluate": ("evaluate", "score a model file on labelled sets or folders"),
        "simulate": ("simulate", "simulate the trials of a scene, with their truth"),
    },
    "set up a hand": {
        "doctor": ("doctor", "what is installed and missing here; or check a MODEL"),
        "scan": ("hand", "list the sensors on a bus, their faults and the rate"),
        "bias": ("hand", "measure the bias of the open, untouched hand"),
        "calibrate": ("hand", "fit the map from field to force, from known loads"),
        "bench": ("hand", "say whether this machine is fast enough"),
        "board": ("hand", "print udev rules or a systemd unit for the board"),
    },
    "with people": {
        "study": ("people", "run a study with a person: steps, trials, report"),
        "adapt": ("adapt", "adapt a model file to one person, from two minutes"),
        "watch": ("people", "film two printed tags; label the onset of slip"),
    },
    "other formats": {
        "convert": ("convert", "write recordings in the formats of other tools"),
    },
}
"""What one wants to do -> verb -> its module in holdfast.cli, and what it does."""
VERBS = {
    verb: (f"holdfast.cli.{name}", about)
    for group in GROUPS.values()
    for verb, (name, about) in group.items()
}
"""Verb -> its module, and what it does."""
OLD = {
    "loop": "python -m studies loop SCENE.., or make loop, in a checkout",
    "onset": "holdfast watch --onset TRIAL",
    "repair": "holdfast check --repair DIR",
    "selftest": "holdfast doctor MODEL",
    "completion": "holdfast doctor --completion SHELL",
}
"""A word that was a command -> what does it now."""

START = """\
Know a grip is about to fail before it does: holdfast reads the magnetic fingertips of a
prosthetic hand, and tells at every sample whether the object is held, handed over or slipping.

Try first:
  holdfast run --source virtual://ft232h --to view            a simulated hand, answered live
  holdfast simulate thesis --trials 60 --out trials           recordings to train on
  holdfast train --data trials --out model --report r.html    a model, and a page about it

All commands: holdfast help. One command: holdfast help VERB.
"""
HELP = """usage: holdfast VERB [options]    (holdfast help VERB for one verb)
{verbs}
options everywhere: --help, --version, --debug (show the traceback of an error)
exit codes: 0 done, 1 failed, 2 usage, 3 data, 4 model, 5 output, 6 device, 130 interrupted
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the `holdfast` command; returns the exit code."""
    return finish(_main, sys.argv[1:] if argv is None else argv)


def _main(argv: Sequence[str]) -> int:
    # `holdfast help VERB` is the help of that verb's parser.
    if len(argv) > 1 and argv[0] == "help":
        argv = [argv[1], "--help"]
    if not argv:
        print(START, end="")
        return 0

    if argv[0] in ("-h", "--help", "help"):
        print(HELP.format(verbs=_listed()), end="")
        return 0

    if argv[0] == "--version":
        print(f"holdfast {version('holdfast')}")
        return 0

    if argv[0] in OLD:
        what = f"{argv[0]!r} is no command of holdfast any more"
        raise UsageError(what, next_step=OLD[argv[0]])

    if argv[0] not in VERBS:
        what = f"unknown command {argv[0]!r}; choose from {', '.join(VERBS)}"
        raise UsageError(what, next_step="holdfast --help")

    return _run(argv[0], argv[1:])


def _listed() -> str:
    """The verbs by what one wants to do."""
    width = max(map(len, VERBS)) + 2
    lines = []
    for title, verbs in GROUPS.items():
        lines += ["", f"{title}:"]
        lines += [f"  {verb:<{width}}{about}" for verb, (_, about) in verbs.items()]
    return "\n".join([*lines, ""])


def _run(verb: str, argv: Sequence[str]) -> int:
    # Only the verb's module: `holdfast run` must start without the packages of training.
    add_arguments, run = functions_of(verb)
    parser = _parser(verb, argv, VERBS[verb][1])
    add_arguments(parser)
    args = parser.parse_args(list(map(_stdin_url, argv)))
    # For every verb; those that write more files ask again with these.
    require_outputs(args)
    return run(args)


def functions_of(verb: str) -> tuple[Callable[..., None], Callable[..., int]]:
    """What declares the options of a verb, and what runs it.

    The first takes a parser; the second takes its namespace and returns the exit code.
    """
    module = import_module(VERBS[verb][0])
    add_arguments = getattr(module, f"add_{verb}_arguments")
    return add_arguments, getattr(module, f"run_{verb}")


def _stdin_url(word: str) -> str:
    """`-?map=FILE` as a URL: argparse takes it for an option."""
    return f"stdin://{word[1:]}" if word.startswith("-?") else word


def _parser(verb: str, argv: Sequence[str], about: str) -> Parser:
    prog = f"holdfast {verb}"
    if verb not in WITH_SETTINGS:
        return Parser(prog=prog, description=about)

    # only these commands read files of settings
    from holdfast.cli.options import SettingsParser, read_settings, settings_file

    # Before the parser exists, because they become its defaults.
    settings = read_settings(settings_file(argv))
    return SettingsParser(settings=settings, prog=prog, description=about)
