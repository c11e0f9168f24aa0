"""`holdfast export` as a script: `python export/export.py`, `python -m holdfast.export.export`."""

from __future__ import annotations

import sys
from pathlib import Path

# The folder of a script is first on sys.path, where this file would shadow the package `export`.
if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[2])

from holdfast.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["export", *sys.argv[1:]]))
