"""`holdfast selftest MODEL`: short checks of the deployed model file, on this machine."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict

from holdfast.messages import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    parser.add_argument("--json", action="store_true", help="one JSON object for each check")


def run(args: argparse.Namespace) -> int:
    """Print every check when it is done; returns 1 where one failed."""
    say(f"checking {args.model}, about 5 s")
    from holdfast.edge_runtime.self_checks import self_checks

    failed = 0
    for one in self_checks(args.model):
        failed += not one.ok
        words = f"{'ok' if one.ok else 'failed':<8}{one.what:<28}{one.figure}"
        print(json.dumps(asdict(one)) if args.json else words, flush=True)
    return int(failed > 0)
