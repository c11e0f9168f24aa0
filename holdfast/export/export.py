"""Turn an artifact folder into one verified, sealed file: `python export/export.py DIR --out FILE`.

Without arguments it exports build/default. Nothing is written unless file and reference agree. A
file in the artifact's own folder is derived from it and replaced; a file elsewhere is replaced only
with --force. `--to c` turns a sealed file into C99 instead (export/c).
"""

from __future__ import annotations

import sys
from pathlib import Path

# run as a script: its folder is first on sys.path, where this file would shadow the package
if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[2])

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    add_json_option,
    path_argument,
    require_json_writable,
    run_script,
    show_found,
)
from holdfast.core.errors import OutputError, UsageError, visible

if TYPE_CHECKING:
    from holdfast.export.verify import HeadVerification


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this command, also of `holdfast export`."""
    option, default = parser.add_argument, Path("build/default")
    folder = "artifact folder of holdfast train (default build/default); a model file with --to c"
    option(
        "artifact",
        nargs="?",
        type=path_argument,
        default=default,
        metavar="DIR",
        help=folder,
    )
    option(
        "--to",
        choices=("onnx", "c"),
        default="onnx",
        help="the form to write (default onnx)",
    )
    out = "model file to write (default DIR/holdfast.onnx); with --to c a folder (default MODEL-c)"
    option("--out", type=path_argument, metavar="FILE", help=out)
    option("--force", action="store_true", help="replace FILE if it exists")
    option(
        "--build", action="store_true", help="with --to c: compile libholdfast.so too"
    )
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Export; prints what was verified."""
    require_json_writable(args)
    sys.stderr.write(f"exporting {visible(str(args.artifact))}\n")
    if args.to == "c":
        return _export_c(args)
    if args.build:
        raise UsageError("--build compiles C", next_step="add --to c")
    from holdfast.export.exporting import MODEL_NAME, export_artifact

    require_replaceable(
        args.artifact, args.out or args.artifact / MODEL_NAME, force=args.force
    )
    path, report = export_artifact(args.artifact, args.out, say=_say_stage)
    rows, samples = report.single_rows, report.stream_samples
    words = [
        *(f"{name}: {_agreement(head)}" for name, head in report.heads.items()),
        f"one at a time equals a batch, bit for bit: {rows} rows and {samples} samples",
        f"model: {path} ({report.bytes / 1e6:.1f} MB)",
    ]
    show_found(args, "\n".join(words), {"model": path, **asdict(report)})
    return 0


def _export_c(args: argparse.Namespace) -> int:
    """Export a sealed file as C; prints its memory and what the self-test found."""
    from holdfast.edge_runtime.c_engine import LIBRARY, default_folder
    from holdfast.export.c.exporting import export_c

    model = args.artifact / "holdfast.onnx" if args.artifact.is_dir() else args.artifact
    folder = args.out or default_folder(model)
    done = export_c(model, folder, build=args.build, force=args.force)
    source = done.source
    files = [*source.files, *([LIBRARY] if args.build else [])]
    words = [
        f"state {source.state_bytes} bytes, tables {source.table_bytes} bytes, "
        f"stack of a step about {source.stack_bytes} bytes",
        *done.selftest,
        f"C: {folder} ({', '.join(files)})",
    ]
    found = {
        "folder": folder,
        "files": files,
        "state_bytes": source.state_bytes,
        "table_bytes": source.table_bytes,
        "stack_bytes": source.stack_bytes,
        "selftest": list(done.selftest),
    }
    show_found(args, "\n".join(words), found)
    return 0


def _say_stage(line: str) -> None:
    sys.stderr.write(f"  {line}\n")


def _agreement(head: HeadVerification) -> str:
    """How a head of the file compares with the reference; a forest, with scikit-learn's predict."""
    plain = head.predict_disagreement
    labels = f"{head.label_mismatches} labels differ from the reference"
    if plain is None:
        return f"{head.rows} rows, {labels}"
    share = f"{1.0 - plain.share_off_ties:.4%}".replace("100.0000%", "100 %")
    agreement = f"agreement with scikit-learn predict: {share} ({plain.ties} ties)"
    return f"{head.rows} rows, {labels}; {agreement}"


def require_replaceable(artifact: Path, model: Path, *, force: bool) -> None:
    """Raise OutputError where model or card would replace part of the artifact, or another file."""
    from holdfast.export.artifact import INDEX, ROWS

    for path in (model, model.with_suffix(".json")):
        own = path.resolve().parent == artifact.resolve()
        if own and (path.name in (INDEX, ROWS) or path.suffix in (".skops", ".npz")):
            raise OutputError(
                "is part of the artifact",
                where=path,
                cause="the card beside a model is MODEL.json",
                next_step="name another file, such as --out holdfast.onnx",
            )
        if not own and not force and path.exists():
            raise OutputError(
                "exists already",
                where=path,
                cause="an earlier export",
                next_step="name a new file with --out, or add --force to replace it",
            )


if __name__ == "__main__":
    sys.exit(run_script("export.py", str(__doc__), add_arguments, run))
