"""`holdfast selftest MODEL`: short checks of the deployed model file, on this machine."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict

from holdfast.cli.command import STDOUT, add_json_option, show, write_found
from holdfast.live.running import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Print every check when it is done; returns 1 where one failed."""
    from holdfast.live.selftest import self_checks

    say(f"checking {args.model}, about 5 s")
    checks = []
    for one in self_checks(args.model):
        checks.append(one)
        if args.json != STDOUT:
            # At once and not at the end: a check that hangs is then the next one.
            show(f"{'ok' if one.ok else 'failed':<8}{one.what:<28}{one.figure}")
            sys.stdout.flush()

    ok = all(one.ok for one in checks)
    write_found(
        args, {"model": args.model, "ok": ok, "checks": [asdict(one) for one in checks]}
    )
    return int(not ok)
