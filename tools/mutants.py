"""Mutation tests: a sample of small changes to the code, each to be noticed by its tests.

    make mutants ARGS="--sample 150 --seed 0"

Cosmic Ray finds and makes the changes, in a copy of the tree. For each, only the test files that
name the changed module are run, with the packages of .venv. mutants.jsonl gets a line a mutant as
it ends, so what was done before an interruption is kept.

A test that fails without a change would make every mutant die, so such tests end the program.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

from cosmic_ray.commands import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_db import WorkDB
from cosmic_ray.work_item import MutationSpec, TestOutcome

ROOT = Path(__file__).resolve().parents[1]
PYTHON = ROOT / ".venv/bin/python"
PACKAGES = ("core", "edge_runtime", "drivers")
TESTS = ("edge_runtime", "drivers", "training")
"""Folders of tests/ that test these packages, without the long ones of whole programs."""
TYPES_ALONE = "ReplaceBinaryOperator_BitOr"
"""Of these nearly all are `X | None` in an annotation, which nothing evaluates."""
LONGEST_S = 300.0
"""A mutant that lasts so long hangs, and is noticed."""


def main() -> int:
    """Copy the tree, change it, run tests; prints the survivors and the share that died."""
    args = options()
    tree = args.out / "tree"
    copy_tree(tree)
    specs = sampled(tree, args.sample, args.seed)
    killed = 0
    with (args.out / "mutants.jsonl").open("w", encoding="utf-8") as lines:
        for number, spec in enumerate(specs, 1):
            tests = tests_of(tree, spec.module_path)
            require_passing(tree, tests)
            found = tested(tree, spec, tests)
            killed += found["killed"]
            lines.write(json.dumps(found) + "\n")
            lines.flush()
            print(
                f"{number} of {len(specs)}: {'killed' if found['killed'] else 'LIVES'}"
            )
            if not found["killed"]:
                print(found["diff"], flush=True)

    print(f"killed: {killed} of {len(specs)} ({killed / max(1, len(specs)):.2f})")
    return 0


def options() -> argparse.Namespace:
    """What the user gave."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--sample", type=int, default=150, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    out = ROOT / "build/mutants"
    parser.add_argument("--out", type=Path, default=out, metavar="DIR")
    return parser.parse_args()


def copy_tree(tree: Path) -> None:
    """The files of the repository, so that an interruption leaves no mutant in it."""
    shutil.rmtree(tree, ignore_errors=True)
    words = ["git", "ls-files", "-z"]
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    for name in filter(None, listed.stdout.split("\0")):
        path = tree / name
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, path, follow_symlinks=False)


def sampled(tree: Path, n_mutants: int, seed: int) -> list[MutationSpec]:
    """The same mutants for the same seed and the same code."""
    modules: list[Path] = []
    for package in PACKAGES:
        modules += sorted((tree / "holdfast" / package).rglob("*.py"))
    every = WorkDB(tree.with_name("every.sqlite"), WorkDB.Mode.create)
    init(modules, every, {})
    specs = [item.mutations[0] for item in every.work_items]
    every.close()
    telling = [one for one in specs if TYPES_ALONE not in one.operator_name]
    # The order of a database says nothing, so the sample is drawn from a sorted list.
    telling.sort(key=lambda one: (one.module_path, one.operator_name, one.occurrence))
    return random.Random(seed).sample(telling, min(n_mutants, len(telling)))


def tests_of(tree: Path, module: Path) -> tuple[str, ...]:
    """The test files that name a module; all of the live path's where none does."""
    dotted = ".".join(module.relative_to(tree).with_suffix("").parts)
    folders = [tree / "tests" / name for name in TESTS]
    files = [path for one in folders for path in sorted(one.glob("test_*.py"))]
    naming = [path for path in files if dotted in path.read_text("utf-8")]
    chosen = naming or sorted(folders[0].glob("test_*.py"))
    return tuple(str(path.relative_to(tree)) for path in chosen)


def words_of(tests: tuple[str, ...]) -> list[str]:
    """The command that runs test files, until one fails."""
    return [str(PYTHON), "-m", "pytest", "-p", "no:xdist", "-q", "-x", *tests]


@cache
def require_passing(tree: Path, tests: tuple[str, ...]) -> None:
    """End the program where tests fail without a change."""
    done = subprocess.run(words_of(tests), cwd=tree, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"tests fail without a change:\n{done.stdout[-3000:]}")


def tested(tree: Path, spec: MutationSpec, tests: tuple[str, ...]) -> dict[str, object]:
    """A mutant and whether a test noticed it. Cosmic Ray runs the command where this runs."""
    command = f"cd {tree} && {' '.join(words_of(tests))}"
    result = mutate_and_test([spec], f"sh -c '{command}'", LONGEST_S)
    return {
        "module": str(spec.module_path.relative_to(tree)),
        "operator": spec.operator_name,
        "line": spec.start_pos[0],
        "killed": result.test_outcome != TestOutcome.SURVIVED,
        "outcome": str(result.test_outcome),
        "diff": result.diff,
        "tests": list(tests),
    }


if __name__ == "__main__":
    raise SystemExit(main())
