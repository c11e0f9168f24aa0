"""`holdfast VERB ..`: one parser, one module a verb, imported only for its verb.

Exit codes: 0 done, 1 failed, 2 usage, 3 data, 4 model, 5 output, 6 device, 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import version

from holdfast.cli.command import WITH_SETTINGS, Parser, finish
from holdfast.core.errors import UsageError

VERBS = {
    "simulate": (
        "holdfast.cli.simulate",
        "simulate the trials of a scene card, with their truth",
    ),
    "check": (
        "holdfast.cli.check",
        "say what a folder of recordings holds and what is missing",
    ),
    "import": (
        "holdfast.cli.importing",
        "turn logs of other programs into trials, by a column map",
    ),
    "convert": (
        "holdfast.cli.convert",
        "write recordings in the formats of other tools",
    ),
    "train": (
        "holdfast.cli.train",
        "train on recordings; writes an artifact folder",
    ),
    "export": (
        "holdfast.cli.export",
        "turn an artifact folder into one verified, sealed model file",
    ),
    "adapt": (
        "holdfast.cli.adapt",
        "adapt a model file to one person, from two minutes of recording",
    ),
    "evaluate": (
        "holdfast.cli.evaluate",
        "score a model file on labelled sets or folders",
    ),
    "replay": (
        "holdfast.cli.replay",
        "a model's answers on a recorded trial, as JSON lines",
    ),
    "run": ("holdfast.cli.run", "read a hand live and answer every sample"),
    "scan": (
        "holdfast.cli.scan",
        "list the sensors on a bus, their faults and the rate",
    ),
    "calibrate": (
        "holdfast.cli.calibrate",
        "fit the map from field to force, from known loads",
    ),
    "bias": ("holdfast.cli.bias", "measure the bias of the open, untouched hand"),
    "record": ("holdfast.cli.record", "record trials by keys and a protocol"),
    "study": (
        "holdfast.cli.study",
        "run a study with a person: steps, trials, report",
    ),
    "repair": ("holdfast.cli.repair", "repair trials after a kill or a power cut"),
    "watch": (
        "holdfast.cli.watch",
        "record a camera: lossless video and tracks of two printed tags",
    ),
    "onset": (
        "holdfast.cli.onset",
        "find the onset of slip in a camera recording; writes a label",
    ),
    "bench": ("holdfast.cli.bench", "say whether this machine is fast enough"),
    "doctor": (
        "holdfast.cli.doctor",
        "list what is installed, and what is missing; doctor MODEL checks a file",
    ),
    "board": ("holdfast.cli.board", "print udev rules or a systemd unit for the board"),
    "completion": (
        "holdfast.cli.completion",
        "print what makes bash, zsh or fish complete commands",
    ),
}

MOVED = {
    "loop": "python -m studies loop SCENE.., or make loop, in a checkout",
    "selftest": "holdfast doctor MODEL",
}
"""A word that was a command -> what does it now."""

HELP = """usage: holdfast VERB [options]    (holdfast help VERB for one verb)

Know a grip is about to fail before it does.

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
    if not argv or argv[0] in ("-h", "--help", "help"):
        width = max(map(len, VERBS)) + 2
        verbs = "\n".join(
            f"  {name:<{width}}{about}" for name, (_, about) in VERBS.items()
        )
        print(HELP.format(verbs=verbs), end="")
        return 0

    if argv[0] == "--version":
        print(f"holdfast {version('holdfast')}")
        return 0

    if argv[0] in MOVED:
        what = f"{argv[0]!r} is no command of holdfast any more"
        raise UsageError(what, next_step=MOVED[argv[0]])

    if argv[0] not in VERBS:
        what = f"unknown command {argv[0]!r}; choose from {', '.join(VERBS)}"
        raise UsageError(what, next_step="holdfast --help")

    return _run(argv[0], argv[1:])


def _run(verb: str, argv: Sequence[str]) -> int:
    module_name, about = VERBS[verb]
    # Only the verb's module: `holdfast run` must start without the packages of training.
    module = import_module(module_name)
    _refuse_old(verb, argv, getattr(module, "OLD_OPTIONS", {}))
    parser = _parser(verb, argv, about)
    module.add_arguments(parser)
    code: int = module.run(parser.parse_args([_stdin_url(word) for word in argv]))
    return code


def _refuse_old(verb: str, argv: Sequence[str], old: Mapping[str, str]) -> None:
    """Raise UsageError for an option of earlier versions. old: each, and what to write instead."""
    for word in argv:
        name = word.partition("=")[0]
        if name in old:
            what = f"{name} is no option of holdfast {verb} any more"
            raise UsageError(what, next_step=f"write {old[name]}")


def _stdin_url(word: str) -> str:
    """`-?map=FILE` as a URL: argparse takes it for an option."""
    return f"stdin://{word[1:]}" if word.startswith("-?") else word


def _parser(verb: str, argv: Sequence[str], about: str) -> Parser:
    prog = f"holdfast {verb}"
    if verb not in WITH_SETTINGS:
        return Parser(prog=prog, description=about)

    # only these commands read files of settings
    from holdfast.cli.settings import SettingsParser, read_settings

    # Before the parser exists, because they become its defaults.
    settings = read_settings(argv).settings
    return SettingsParser(settings=settings, prog=prog, description=about)
