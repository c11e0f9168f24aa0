"""Mutation tests: a sample of small changes to the code, each to be noticed by its tests.

    make mutants ARGS="--sample 60 --seed 1"

Cosmic Ray makes the changes, in two copies of the tree. A change is tried on the test files that
name its module best (`mutant_tests.py`), never on all: the share that died is a lower bound. The
test that notices a change must fail again alone, and pass without the change.
Changes that alter nothing are listed in `mutants_equivalent.toml`, each with its reason.

mutants.jsonl gets a line a mutant as it ends, so what was done before an interruption is kept;
`--again` tries only what lived, after a test was written. mutants.json is the whole
result.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import tomllib
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import Queue, get_context
from pathlib import Path
from typing import cast

from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_item import MutationSpec, TestOutcome
from mutant_sample import sampled
from mutant_tests import (
    PYTHON,
    TOGETHER,
    command_of,
    failures,
    naming_tests,
    noticing,
)

ROOT = Path(__file__).resolve().parents[1]
EQUIVALENT = ROOT / "tools/mutants_equivalent.toml"
AT_ONCE = 2
LONGEST_CPU_S, LONGEST_WALL_S = 120, 600
"""A mutant that lasts so long hangs, and is noticed. On a loaded machine only CPU time tells."""
MEMORY_BYTES = 8 << 30
"""A changed size must not take the memory of the machine."""

Row = dict[str, object]


def main() -> int:
    """Copy the tree, change it, run tests; prints the survivors and the share that died."""
    args = options()
    trees = [args.out / f"tree-{number}" for number in range(AT_ONCE)]
    for tree in trees:
        copy_tree(tree)
        copy_compiled(tree)
    os.chdir(trees[0])
    specs = sampled(args.sample, args.seed)
    lines = args.out / "mutants.jsonl"
    known = killed_before(lines) if args.again else {}
    rows = [known[key] for one in specs if (key := key_of(one)) in known]
    open_specs = [one for one in specs if key_of(one) not in known]
    with pool(trees) as workers, lines.open("w", encoding="utf-8") as out:
        out.writelines(json.dumps(row) + "\n" for row in rows)
        jobs = [workers.submit(tested, one) for one in open_specs]
        for row in (job.result() for job in as_completed(jobs)):
            rows.append(row)
            out.write(json.dumps(row) + "\n")
            out.flush()
            print(f"{len(rows)} of {len(specs)}: {row['outcome']}", flush=True)
            if row["outcome"] == "lived":
                print(row["diff"], flush=True)
    failing = without_change(rows, trees[0])
    for row in rows:
        died = row["outcome"] in ("killed", "timed out")
        if died and not (row["noticed_by"] or ends_well(row, trees[0])):
            row["outcome"] = "undecided"
        if died and row["noticed_by"] in failing:
            row["outcome"] = "undecided"
    result = summary(rows, args)
    text = json.dumps(result, indent=1, sort_keys=True) + "\n"
    (args.out / "mutants.json").write_text(text, "utf-8")
    print(result["says"])
    return 0


def options() -> argparse.Namespace:
    """What the user gave."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--sample", type=int, default=75, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    out = ROOT / "build/mutants"
    parser.add_argument("--out", type=Path, default=out, metavar="DIR")
    parser.add_argument(
        "--again", action="store_true", help="try only what lived before"
    )
    args = parser.parse_args()
    args.out = args.out.resolve()
    return args


def copy_tree(tree: Path) -> None:
    """The files of the repository, so that an interruption leaves no mutant in it."""
    shutil.rmtree(tree, ignore_errors=True)
    words = ["git", "ls-files", "-z"]
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    for name in filter(None, listed.stdout.split("\0")):
        path = tree / name
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, path, follow_symlinks=False)


def copy_compiled(tree: Path) -> None:
    """What is compiled already, because a run of a changed module writes nothing compiled."""
    words = [str(PYTHON), "-m", "compileall", "-q", "holdfast"]
    subprocess.run(words, cwd=ROOT, check=True)
    for folder in ("holdfast", "tests"):
        for path in (ROOT / folder).rglob("__pycache__/*.pyc"):
            copy = tree / path.relative_to(ROOT)
            if copy.parent.parent.is_dir():
                copy.parent.mkdir(exist_ok=True)
                shutil.copy2(path, copy)


def pool(trees: list[Path]) -> ProcessPoolExecutor:
    """Processes that work in a tree of their own each."""
    context = get_context("spawn")
    free: Queue[Path] = context.Queue()
    for tree in trees:
        free.put(tree)
    return ProcessPoolExecutor(len(trees), context, enter, (free,))


def enter(free: Queue[Path]) -> None:
    """Begin a process: its tree, whose package comes before the installed one."""
    tree = free.get()
    os.chdir(tree)
    os.environ |= {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    # a worker itself costs little; what it starts has the limit for itself
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_CPU_S, LONGEST_CPU_S))


def tested(spec: MutationSpec) -> Row:
    """A mutant and whether a test noticed it. Cosmic Ray runs the commands where this runs.

    The test files that name its module are tried a few at a time, the best first. A named test
    must fail once more alone: else the machine may be to blame, and nothing is decided.
    """
    tests = naming_tests(spec.module_path)
    for k in range(0, len(tests), TOGETHER):
        tried = tests[k : k + TOGETHER]
        result = mutate_and_test([spec], command_of(tried), LONGEST_WALL_S)
        if result.test_outcome != TestOutcome.SURVIVED:
            break
    lived = result.test_outcome == TestOutcome.SURVIVED
    outcome = "timed out" if result.output == "timeout" else "killed"
    noticed_by = noticing(result.output or "")
    if noticed_by and not lived:
        result = mutate_and_test([spec], command_of([noticed_by]), LONGEST_WALL_S)
    if not lived and result.test_outcome != TestOutcome.KILLED:
        outcome = "undecided"
    reason = equivalent(str(spec.module_path), result.diff or "")
    row: Row = {"why": reason} if lived and reason else {}
    return row | {
        "key": key_of(spec),
        "module": str(spec.module_path),
        "line": spec.start_pos[0],
        "outcome": ("equivalent" if reason else "lived") if lived else outcome,
        "diff": result.diff,
        "tests": tests if lived else tried,
        "noticed_by": noticed_by,
    }


def without_change(rows: list[Row], tree: Path) -> set[str]:
    """Which of the tests that noticed a change fail without one too, as on a broken machine."""
    names = sorted({str(row["noticed_by"]) for row in rows if row["noticed_by"]})
    if not names:
        return set()
    done = unchanged(names, tree)
    if done.returncode not in (0, 1):
        raise SystemExit(f"the tests cannot be run without a change:\n{done.stdout}")
    return failures(done.stdout)


def ends_well(row: Row, tree: Path) -> bool:
    """Whether the tests pass without the change in half the CPU time and half the time.

    Without a named test the change had no end, or the tests could not begin.
    """
    limits = f"ulimit -t {LONGEST_CPU_S // 2} && timeout {LONGEST_WALL_S // 2}"
    names = list(cast("list[str]", row["tests"]))
    return unchanged(names, tree, limits).returncode == 0


def unchanged(
    names: list[str], tree: Path, limits: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run all of these tests on an unchanged tree, in the memory that a change had.

    limits: words of the shell before.
    """
    command = command_of(names).replace(" -x ", " ")
    line = f"ulimit -v {MEMORY_BYTES >> 10}; {limits} {command}"
    path = os.environ | {"PYTHONPATH": str(tree)}
    return subprocess.run(
        line, cwd=tree, env=path, capture_output=True, text=True, shell=True
    )


def equivalent(module: str, diff: str) -> str:
    """Why a change alters nothing a caller sees, or an empty text."""
    changed = changed_lines(diff, "+")
    listed = tomllib.loads(EQUIVALENT.read_text("utf-8")).get("mutant", [])
    found = [
        one["why"]
        for one in listed
        if one["module"] == module and [one["changed"]] == changed
    ]
    return found[0] if found else ""


def changed_lines(diff: str, sign: str) -> list[str]:
    """Lines of a diff that are new (+) or gone (-)."""
    lines = [line for line in diff.splitlines() if line[:1] == sign]
    return [line[1:].strip() for line in lines if line[:3] != 3 * sign]


def key_of(spec: MutationSpec) -> str:
    """Which mutant this is."""
    return (
        f"{spec.module_path}:{spec.start_pos[0]} {spec.operator_name} {spec.occurrence}"
    )


def killed_before(lines: Path) -> dict[str, Row]:
    """What a run before this one killed, by key."""
    rows = [json.loads(line) for line in lines.read_text("utf-8").splitlines()]
    return {
        row["key"]: row for row in rows if row["outcome"] in ("killed", "timed out")
    }


def summary(rows: list[Row], args: argparse.Namespace) -> Row:
    """The whole result: counts, shares, and every mutant without its long diff."""
    outcomes = [row["outcome"] for row in rows]
    counts = {name: outcomes.count(name) for name in sorted(set(map(str, outcomes)))}
    died = counts.get("killed", 0) + counts.get("timed out", 0)
    same = counts.get("equivalent", 0)
    share = died / max(1, len(rows) - same)
    short = [
        {key: row[key] for key in row if key not in ("tests", "diff")}
        | {sign: changed_lines(str(row["diff"]), sign) for sign in "-+"}
        for row in rows
    ]
    return {
        "command": f'make mutants ARGS="--sample {args.sample} --seed {args.seed}"',
        "counts": counts,
        "share_of_all": round(died / max(1, len(rows)), 3),
        "share_without_equivalent": round(share, 3),
        "mutants": sorted(short, key=lambda row: str(row["key"])),
        "says": f"noticed: {died} of {len(rows)}; {same} alter nothing; "
        f"{share:.2f} of the others",
    }


if __name__ == "__main__":
    raise SystemExit(main())
