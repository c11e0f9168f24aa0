"""The options of studies that read simulated sets from a folder and write JSON into another."""

from __future__ import annotations

import argparse
from pathlib import Path

from holdfast.cli.command import path_argument, seed


def add_folder_arguments(parser: argparse.ArgumentParser, target: str) -> None:
    """FOLDER, --out and --seed. target: of the Makefile, which simulates the sets."""
    parser.add_argument(
        "folder",
        type=Path,
        metavar="FOLDER",
        help=f"holds the sets that `make {target}` simulates",
    )
    parser.add_argument(
        "--out",
        type=path_argument,
        required=True,
        metavar="DIR",
        help="where the JSON goes",
    )
    parser.add_argument(
        "--seed",
        type=seed,
        default=0,
        metavar="S",
        help="seed of every random choice (default 0)",
    )
