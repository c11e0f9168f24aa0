"""Mutation tests: a sample of small changes to the code, each to be noticed by its tests.

    make mutants ARGS="--sample 75 --seed 0"

Cosmic Ray finds and makes the changes, in two copies of the tree. A change is tried on the few
fastest test files that name its module (`mutant_tests.py`), so the share that died is a lower bound.
Changes that alter nothing are listed in `mutants_equivalent.toml`, each with its reason.

mutants.jsonl gets a line a mutant as it ends, so what was done before an interruption is kept;
`--again` tries only what lived, after a test was written. mutants.json is the whole result.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import subprocess
import time
import tomllib
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import Queue, get_context
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.plugins import get_operator, operator_names
from cosmic_ray.work_item import MutationSpec, TestOutcome
from mutant_tests import TimedTest, command_of, naming_tests, timed_tests

ROOT = Path(__file__).resolve().parents[1]
EQUIVALENT = ROOT / "tools/mutants_equivalent.toml"
PACKAGES = ("core", "edge_runtime", "drivers")
TYPES_ALONE = "ReplaceBinaryOperator_BitOr"
"""Of these nearly all are `X | None` in an annotation, which nothing evaluates."""
OF_A_MODULE = 3
AT_ONCE = 2
MEMORY_BYTES = 8 << 30
"""A changed size must not take the memory of the machine."""

Row = dict[str, object]


def main() -> int:
    """Copy the tree, change it, run tests; prints the survivors and the share that died."""
    args = options()
    trees = [args.out / f"tree-{number}" for number in range(AT_ONCE)]
    for tree in trees:
        copy_tree(tree)
    os.chdir(trees[0])
    specs = sampled(args.sample, args.seed)
    lines = args.out / "mutants.jsonl"
    known = killed_before(lines) if args.again else {}
    rows = [known[key] for one in specs if (key := key_of(one)) in known]
    open_specs = [one for one in specs if key_of(one) not in known]
    with pool(trees) as workers, lines.open("w", encoding="utf-8") as out:
        out.writelines(json.dumps(row) + "\n" for row in rows)
        for row in tried(workers, open_specs, args.out / "times.json"):
            rows.append(row)
            out.write(json.dumps(row) + "\n")
            out.flush()
            print(f"{len(rows)} of {len(specs)}: {row['outcome']}", flush=True)
            if row["outcome"] == "lived":
                print(row["diff"], flush=True)
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
        "--again", action="store_true", help="try only what lived in the run before"
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


def sampled(n_mutants: int, seed: int) -> list[MutationSpec]:
    """The same mutants for the same seed and code: a share a package, few a module, one a line."""
    dice = random.Random(seed)
    drawn: list[MutationSpec] = []
    for number, package in enumerate(PACKAGES):
        share = (n_mutants + number) // len(PACKAGES)
        modules = sorted(Path("holdfast", package).rglob("*.py"))
        modules = [path for path in modules if path.name != "__init__.py"]
        dice.shuffle(modules)
        own = [spec for path in modules for spec in drawn_from(path, dice)]
        drawn += own[:share]
    return drawn


def drawn_from(module: Path, dice: random.Random) -> list[MutationSpec]:
    """A few changes of a module, of different kinds: arithmetic, a comparison, a number, a loop."""
    nodes = list(ast_nodes(get_ast_from_path(module)))
    names = [name for name in sorted(operator_names()) if TYPES_ALONE not in name]
    dice.shuffle(names)
    drawn: dict[str, MutationSpec] = {}
    for name in names:
        kind = name.split("/")[1].split("_")[0]
        operator = get_operator(name)
        if kind in drawn or operator.arguments():
            continue
        found = [at for node in nodes for at in operator().mutation_positions(node)]
        lines = {one.start_pos[0] for one in drawn.values()}
        free = [k for k, at in enumerate(found) if at[0][0] not in lines]
        if free:
            k = dice.choice(free)
            drawn[kind] = MutationSpec(module, name, k, *found[k])
        if len(drawn) == OF_A_MODULE:
            break
    return list(drawn.values())


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


def tried(
    workers: ProcessPoolExecutor, specs: list[MutationSpec], kept: Path
) -> Iterable[Row]:
    """A row a mutant, as they end. Test files are timed once, without a change, before."""
    named = {path: naming_tests(path) for path in {one.module_path for one in specs}}
    times: dict[str, TimedTest] = {}
    if kept.exists():
        told = json.loads(kept.read_text("utf-8"))
        times = {name: TimedTest(**one) for name, one in told.items()}
    untimed = sorted({name for names in named.values() for name in names} - set(times))
    for timed in workers.map(timed_tests, (untimed[k::AT_ONCE] for k in range(AT_ONCE))):
        times |= timed
    kept.write_text(json.dumps({name: vars(one) for name, one in times.items()}))
    jobs = [
        workers.submit(tested, one, [times[name] for name in named[one.module_path]])
        for one in specs
    ]
    for job in as_completed(jobs):
        yield job.result()


def tested(spec: MutationSpec, timed: list[TimedTest]) -> Row:
    """A mutant and whether a test noticed it. Cosmic Ray runs the command where this runs."""
    tests = sorted((one for one in timed if one.usable), key=lambda one: one.wall_s)
    longest_s = 60 + 4 * sum(one.wall_s for one in tests)
    begin_s = time.monotonic()
    result = mutate_and_test(
        [spec], command_of([one.name for one in tests]), longest_s
    )
    lived = not tests or result.test_outcome == TestOutcome.SURVIVED
    if result.output == "timeout":
        outcome = "timed out"
    else:
        outcome = "lived" if lived else "killed"
    reason = equivalent(str(spec.module_path), result.diff or "")
    row: Row = {"why": reason} if lived and reason else {}
    return row | {
        "key": key_of(spec),
        "module": str(spec.module_path),
        "line": spec.start_pos[0],
        "outcome": "equivalent" if lived and reason else outcome,
        "diff": result.diff,
        "tests": [one.name for one in tests],
        "wall_s": round(time.monotonic() - begin_s, 1),
    }


def equivalent(module: str, diff: str) -> str:
    """Why a change alters nothing a caller sees, or an empty text."""
    changed = [
        line[1:].strip()
        for line in diff.splitlines()
        if line[:1] == "+" and line[:3] != "+++"
    ]
    listed = tomllib.loads(EQUIVALENT.read_text("utf-8")).get("mutant", [])
    found = [
        one["why"]
        for one in listed
        if one["module"] == module and [one["changed"]] == changed
    ]
    return found[0] if found else ""


def key_of(spec: MutationSpec) -> str:
    """Which mutant this is."""
    return f"{spec.module_path}:{spec.start_pos[0]} {spec.operator_name} {spec.occurrence}"


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
    short = [{key: row[key] for key in row if key != "tests"} for row in rows]
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
