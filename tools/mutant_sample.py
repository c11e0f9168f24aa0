"""Which changes are tried: a sample by a seed, over packages, modules and kinds of change."""

from __future__ import annotations

import random
import warnings
from itertools import islice
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from cosmic_ray.work_item import MutationSpec

PACKAGES = ("core", "edge_runtime", "drivers")
TYPES_ALONE = "ReplaceBinaryOperator_BitOr"
"""Of these nearly all are `X | None` in an annotation, which nothing evaluates."""
OF_A_MODULE = 3


def sampled(n_mutants: int, seed: int) -> list[MutationSpec]:
    """The same mutants for the same seed and code: a share a package, few a module, one a line."""
    by_package = []
    for package in PACKAGES:
        modules = sorted(Path("holdfast", package).rglob("*.py"))
        random.Random(f"{seed} {package}").shuffle(modules)
        by_package.append(spec for path in modules for spec in drawn_from(path, seed))
    # interleaved, so that a smaller sample is the beginning of a larger one
    in_turns = (spec for turn in zip(*by_package, strict=False) for spec in turn)
    return list(islice(in_turns, n_mutants))


def drawn_from(module: Path, seed: int) -> list[MutationSpec]:
    """A few changes of a module, of different kinds: arithmetic, a comparison, a number, a loop."""
    dice = random.Random(f"{seed} {module}")
    code = module.read_text("utf-8")
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
        k = dice.choice(free) if free else 0
        if free and compiles(mutate_code(code, operator(), k)):
            drawn[kind] = MutationSpec(module, name, k, *found[k])
        if len(drawn) == OF_A_MODULE:
            break
    return list(drawn.values())


def compiles(code: str) -> bool:
    """Whether a change is code: without this a `*` that is no product would count as noticed."""
    with warnings.catch_warnings(action="ignore"):
        try:
            compile(code, "changed", "exec")
        except SyntaxError:
            return False
    return True
