"""`python training/train.py`, or `python -m holdfast.training.train`: `holdfast train` as a script.

The bare script trains the thesis' learner, a forest, where the verb trains a committee.
"""

import sys
from pathlib import Path

# Run as a script, its folder is first on sys.path, where the package cannot be found.
if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[2])

from holdfast.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["train", "--learner", "forest", *sys.argv[1:]]))
