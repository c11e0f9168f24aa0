"""Turn an artifact folder into one verified, sealed file: `python export/export.py DIR --out FILE`.

Without arguments it exports build/default. Nothing is written unless file and reference agree.
"""

from __future__ import annotations

import sys
from pathlib import Path

if not __package__:  # run as a script: the folder of the script is first on sys.path, where we shadow our own room
    sys.path[0] = str(Path(__file__).resolve().parent.parent)

import argparse

from edge_runtime.command import place, run_script


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this command, also of `holdfast export`."""
    parser.add_argument("artifact", nargs="?", type=place, default=Path("build/default"), metavar="DIR")
    parser.add_argument("--out", type=place, metavar="FILE", help="default: DIR/holdfast.onnx")


def run(args: argparse.Namespace) -> int:
    """Export; prints what was verified."""
    from export.exporting import export_artifact

    path, report = export_artifact(args.artifact, args.out)
    for name, head in report["heads"].items():
        plain = head["predict_disagreement"]
        print(
            f"{name}: {head['rows']} rows, {head['label_mismatches']} label mismatches against the reference; "
            f"plain predict differs on {plain['share_off_ties']:.4%} off ties ({plain['ties']} ties)"
        )
    print(f"alone equals batch on {report['single_rows']} rows and {report['stream_samples']} samples, bit for bit")
    print(f"model: {path} ({report['bytes'] / 1e6:.1f} MB)")
    return 0


if __name__ == "__main__":
    sys.exit(run_script("export.py", str(__doc__), add_arguments, run))
