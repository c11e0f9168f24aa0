"""Which model file, and what steps it: the options --engine and --library."""

from __future__ import annotations

import argparse

from holdfast.edge_runtime.command import path_argument
from holdfast.edge_runtime.engine import ENGINES, ONNXRUNTIME, ModelChoice


def add_engine_options(parser: argparse.ArgumentParser) -> None:
    """The options that `run`, `evaluate`, `loop` and `make loop` share."""
    option = parser.add_argument
    engine = "what computes a step: onnxruntime (default), or a library by holdfast export --to c"
    option("--engine", choices=ENGINES, default=ONNXRUNTIME, help=engine)
    library = "the library of --engine c (default MODEL-c/libholdfast.so)"
    option("--library", type=path_argument, metavar="FILE", help=library)


def chosen_model(args: argparse.Namespace) -> ModelChoice:
    """The file of args.model with the engine that the user chose."""
    library = None if args.library is None else str(args.library)
    return ModelChoice(str(args.model), args.engine, library)
