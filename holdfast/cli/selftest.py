"""`holdfast selftest MODEL`: short checks of the deployed model file, on this machine."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

from holdfast.cli.command import STDOUT, add_json_option, show, write_found
from holdfast.core.errors import needs_extra
from holdfast.live.running import say

if TYPE_CHECKING:
    from holdfast.core.contract import CheckResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    parser.add_argument(
        "--deep",
        action="store_true",
        help="check shapes, constants and trees with the onnx package too (extra train)",
    )
    add_json_option(parser)


def _checks(path: str, deep: bool) -> Iterator[CheckResult]:
    from holdfast.live.selftest import self_checks

    yield from self_checks(path)
    if deep:
        with needs_extra("train"):
            from holdfast.export.deep_check import deep_checks
        yield from deep_checks(path)


def run(args: argparse.Namespace) -> int:
    """Print every check when it is done; returns 1 where one failed."""
    say(f"checking {args.model}, about 5 s")
    checks = []
    for one in _checks(args.model, args.deep):
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
