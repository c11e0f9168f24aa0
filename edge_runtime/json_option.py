"""`--json [FILE]`: what a command found as one JSON object, beside its words or instead of them."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from holdfast.edge_runtime.command import path_argument, show
from holdfast.edge_runtime.writing import require_writable, write_whole

STDOUT = Path("-")


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """--json, which means the same in every command."""
    text = "what was found as one JSON object, to FILE; without FILE to stdout, instead of words"
    parser.add_argument(
        "--json", nargs="?", const=STDOUT, type=path_argument, metavar="FILE", help=text
    )


def require_json_writable(args: argparse.Namespace) -> None:
    """Raise OutputError where the file of --json cannot be written, before the work begins."""
    if args.json not in (None, STDOUT):
        require_writable(args.json.parent)


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
    text = json.dumps(found, indent=1, allow_nan=False, default=str) + "\n"
    if args.json == STDOUT:
        sys.stdout.write(text)
    else:
        write_whole(args.json, text)
