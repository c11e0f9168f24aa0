"""Figures cross functions and packages as values that nothing changes, and are compared as such."""

from __future__ import annotations

import ast
from functools import cache
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CHANGED_IN_PLACE = {"GripSense", "Group", "Handle", "Traffic"}
ONE_OBJECT = {
    "kind is Holdfast",
    "register is REGISTERS['I2C_ADDRESS']",
    "register is REGISTERS[name]",
    "holder is dev_handle",
    "self._claimed.get(intf) is dev_handle",
    "self._claimed.get(intf, dev_handle) is not dev_handle",
    "self._claimed.get(interface) is not handle",
}
"""Classes, registers and handles: what is asked is whether it is the very same."""
IDENTITY = (ast.Is, ast.IsNot)
CONTAINED = (ast.In, ast.NotIn)


@cache
def nodes() -> list[ast.AST]:
    """Of the code of three packages."""
    paths = [
        path
        for package in ("core", "edge_runtime", "drivers")
        for path in sorted((ROOT / "holdfast" / package).rglob("*.py"))
    ]
    trees = [ast.parse(path.read_text("utf-8")) for path in paths]
    return [node for tree in trees for node in ast.walk(tree)]


def test_values_of_the_core_the_live_path_and_the_drivers_are_frozen() -> None:
    classes = [one for one in nodes() if isinstance(one, ast.ClassDef)]
    unfrozen = {
        one.name
        for one in classes
        for form in map(ast.unparse, one.decorator_list)
        if form.startswith("dataclass") and "frozen=True" not in form
    }
    assert unfrozen == CHANGED_IN_PLACE


def is_one_of_a_kind(node: ast.expr) -> bool:
    """None, True, False, or the type of something."""
    if isinstance(node, ast.Constant):
        return node.value is None or isinstance(node.value, bool)
    return isinstance(node, ast.Call) and ast.unparse(node.func) == "type"


def test_none_and_types_are_compared_by_identity_and_numbers_and_texts_are_not() -> (
    None
):
    """Small numbers are one object in CPython, and larger ones are not."""
    by_identity: set[str] = set()
    by_value: set[str] = set()
    for node in (one for one in nodes() if isinstance(one, ast.Compare)):
        sides = [node.left, *node.comparators]
        for operator, pair in zip(node.ops, pairwise(sides), strict=True):
            expected = any(map(is_one_of_a_kind, pair))
            if isinstance(operator, CONTAINED) or expected == isinstance(
                operator, IDENTITY
            ):
                continue
            found = by_identity if isinstance(operator, IDENTITY) else by_value
            found.add(ast.unparse(node))
    assert by_value == set()
    assert by_identity == ONE_OBJECT


def test_every_parameter_has_a_name_that_a_caller_may_use() -> None:
    for node in nodes():
        if isinstance(node, ast.arguments):
            assert [one.arg for one in node.posonlyargs] == []
