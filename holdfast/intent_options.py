"""The options of the wearer's own command: --intent and --obey-intent."""

from __future__ import annotations

import argparse

from holdfast.edge_runtime.errors import UsageError

DEFAULT_LEVEL = 0.5
ADDRESSES = "udp://127.0.0.1:9003?envelopes=2 or lsl://NAME"


def add_intent_option(parser: argparse.ArgumentParser) -> None:
    """--intent."""
    intent = "show and record the wearer's own command: udp://HOST:PORT?envelopes=2 or lsl://NAME"
    parser.add_argument("--intent", metavar="URL", help=intent)


def add_obey_option(parser: argparse.ArgumentParser) -> None:
    """--obey-intent."""
    obey = "let it open the hand, as --commands does: by its words, or from LEVEL of the first "
    parser.add_argument(
        "--obey-intent",
        nargs="?",
        type=_level,
        const=DEFAULT_LEVEL,
        metavar="LEVEL",
        help=f"{obey}envelope (default {DEFAULT_LEVEL:g})",
    )


def require_intent(args: argparse.Namespace) -> None:
    """Raise UsageError for --obey-intent without --intent."""
    if args.obey_intent is not None and not args.intent:
        raise UsageError("--obey-intent needs --intent", next_step=f"--intent {ADDRESSES}")


def _level(text: str) -> float:
    level = float(text)
    if not 0.0 < level <= 1.0:
        raise ValueError
    return level
