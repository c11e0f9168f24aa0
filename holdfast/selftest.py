"""`holdfast selftest MODEL`: the hard cases in short, on this machine and with the very file that
is deployed."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    parser.add_argument("--json", action="store_true", help="one JSON object a check")


def run(args: argparse.Namespace) -> int:
    """Print every check as it is done; 1 where one failed."""
    from edge_runtime.self_checks import self_checks

    failed = 0
    for one in self_checks(args.model):
        failed += not one.ok
        told = (
            json.dumps(asdict(one))
            if args.json
            else f"{'ok' if one.ok else 'failed':<8}{one.what:<28}{one.figure}"
        )
        print(told, flush=True)
    return int(failed > 0)
