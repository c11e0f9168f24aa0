"""`python -m studies.real --out DIR`: see studies/real/study.py."""

from __future__ import annotations

import sys

from holdfast.cli.command import finish
from studies.real.study import main

if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
