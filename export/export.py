"""Turn an artifact folder into one verified, sealed file: `python export/export.py DIR --out FILE`.

Without arguments it exports build/default. Nothing is written unless file and reference agree. A
file in the artifact's own folder is derived from it and replaced; a file elsewhere is replaced only
with --force.
"""

from __future__ import annotations

import sys
from pathlib import Path

# run as a script: the folder of the script is first on sys.path, where we shadow our own room
if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parent.parent)

import argparse

from edge_runtime.command import path_argument, run_script, show
from edge_runtime.errors import OutputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this command, also of `holdfast export`."""
    parser.add_argument(
        "artifact", nargs="?", type=path_argument, default=Path("build/default"), metavar="DIR"
    )
    parser.add_argument(
        "--out", type=path_argument, metavar="FILE", help="default: DIR/holdfast.onnx"
    )
    parser.add_argument("--force", action="store_true", help="replace FILE, if it is there already")


def run(args: argparse.Namespace) -> int:
    """Export; prints what was verified."""
    from export.exporting import MODEL_NAME, export_artifact

    require_replaceable(args.artifact, args.out or args.artifact / MODEL_NAME, force=args.force)
    path, report = export_artifact(args.artifact, args.out)
    for name, head in report["heads"].items():
        plain = head["predict_disagreement"]
        show(
            f"{name}: {head['rows']} rows, {head['label_mismatches']} label mismatches against the reference; "
            f"plain predict differs on {plain['share_off_ties']:.4%} off ties ({plain['ties']} ties)"
        )
    print(
        f"alone equals batch on {report['single_rows']} rows and {report['stream_samples']} samples, bit for bit"
    )
    show(f"model: {path} ({report['bytes'] / 1e6:.1f} MB)")
    return 0


def require_replaceable(artifact: Path, model: Path, *, force: bool) -> None:
    """Raise OutputError where the model or its card would replace the artifact itself, or a file of
    another place."""
    from export.artifact import INDEX, ROWS

    for path in (model, model.with_suffix(".json")):
        own = path.resolve().parent == artifact.resolve()
        if own and (path.name in (INDEX, ROWS) or path.suffix == ".skops"):
            raise OutputError(
                "is a part of the artifact itself",
                where=path,
                cause="the card beside a model is MODEL.json",
                next_step="name another file, such as --out holdfast.onnx",
            )
        if not own and not force and path.exists():
            raise OutputError(
                "is there already",
                where=path,
                cause="an earlier export",
                next_step="name a new file with --out, or add --force to replace it",
            )


if __name__ == "__main__":
    sys.exit(run_script("export.py", str(__doc__), add_arguments, run))
