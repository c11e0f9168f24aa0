"""`holdfast VERB ..`: one parser, one module a verb, imported only when its verb is asked for.

Exit codes: 0 done, 1 failed, 2 usage, 3 data, 4 model, 5 output, 6 device, 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version

from edge_runtime.command import Parser, finish
from edge_runtime.errors import UsageError

VERBS = {
    "simulate": (
        "holdfast.simulate",
        "a scene card -> trials with their truth, no hardware needed",
    ),
    "board": ("holdfast.board", "udev rules and a systemd unit for the board"),
    "doctor": ("holdfast.doctor", "say what is here, what is missing, and how to get it"),
    "train": (
        "training.train",
        "recordings -> an artifact folder (forests, spec, held-out figures)",
    ),
    "export": ("export.export", "artifact folder -> one verified, sealed holdfast.onnx"),
    "evaluate": ("holdfast.evaluate", "score a model file on a labelled set or folder"),
    "bench": ("holdfast.bench", "what accuracy costs in time, as JSON and tables"),
    "scan": ("holdfast.scan", "bridges, sensors, addresses, and what is wrong with them"),
    "calibrate": (
        "holdfast.calibrate",
        "known loads -> field to force, judged on probings it never saw",
    ),
    "bias": ("holdfast.bias", "what the unloaded hand reads, with a look at how good that is"),
    "run": ("holdfast.run", "read a hand live and answer every sample"),
    "selftest": (
        "holdfast.selftest",
        "the hard cases in short, with the very file that is deployed",
    ),
    "record": (
        "holdfast.record",
        "trials on disk that survive whatever happens, by keys and a protocol card",
    ),
    "repair": (
        "holdfast.repair",
        "mend trials that a kill or a power cut broke off, and say what was done",
    ),
    "watch": (
        "holdfast.watch",
        "a camera beside the hand: lossless video and the tracks of two printed tags",
    ),
    "onset": (
        "holdfast.onset",
        "when the object began to slip, as the camera saw it: a label with its uncertainty",
    ),
    "replay": ("holdfast.replay", "a model's answers on a recorded trial, one JSON line a sample"),
}

HELP = """usage: holdfast VERB [options]    (holdfast VERB --help for one verb)

Know a grip is about to fail before it does.

{verbs}

options everywhere: --help, --version, --debug (show the traceback of an error)
exit codes: 0 done, 1 failed, 2 usage, 3 data, 4 model, 5 output, 6 device, 130 interrupted
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the `holdfast` command; returns the exit code."""
    return finish(_main, sys.argv[1:] if argv is None else argv)


def _main(argv: Sequence[str]) -> int:
    if not argv or argv[0] in ("-h", "--help"):
        width = max(map(len, VERBS)) + 2
        print(
            HELP.format(
                verbs="\n".join(f"  {name:<{width}}{about}" for name, (_, about) in VERBS.items())
            ),
            end="",
        )
        return 0
    if argv[0] == "--version":
        print(f"holdfast {version('holdfast')}")
        return 0
    if argv[0] not in VERBS:
        raise UsageError(
            f"{argv[0]!r} is no verb",
            cause=f"choose from {', '.join(VERBS)}",
            next_step="holdfast --help",
        )
    return _run(argv[0], argv[1:])


def _run(verb: str, argv: Sequence[str]) -> int:
    module_name, about = VERBS[verb]
    module = import_module(module_name)
    parser = Parser(prog=f"holdfast {verb}", description=about)
    module.add_arguments(parser)
    code: int = module.run(parser.parse_args(argv))
    return code
