"""Modules under a second name: the links at the top, and the old names of modules that moved.

A link is for readers; nothing in Holdfast imports through it. Without this, Python would load every
module a second time under the link's name, and its classes would not be Holdfast's classes.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType


def link(name: str) -> None:
    """Let the package `name` and its modules be holdfast.`name` and its modules."""
    sys.meta_path.insert(0, _Renamed(name, f"holdfast.{name}"))
    sys.modules[name] = import_module(f"holdfast.{name}")


def link_old_names(package: str, room: str, names: Sequence[str]) -> None:
    """Let modules of a package go on under their old names, each with a DeprecationWarning.

    room: where they are now, with the modules below them. For one version after a move.
    """
    for name in names:
        old, new = f"{package}.{name}", f"holdfast.{room}.{name}"
        sys.meta_path.insert(0, _Renamed(old, new, is_old=True))


class _Renamed(MetaPathFinder, Loader):
    """Finds the module `prefix` and those below it, which in truth are `home` and below."""

    def __init__(self, prefix: str, home: str, *, is_old: bool = False) -> None:
        self._prefix = prefix
        self._home = home
        self._is_old = is_old
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        """This object itself loads every module that it renames."""
        is_ours = f"{fullname}.".startswith(f"{self._prefix}.")
        return ModuleSpec(fullname, self) if is_ours else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The package's own module, loaded where it is not yet."""
        name = self._home + spec.name.removeprefix(self._prefix)
        if self._is_old:
            text = f"{spec.name} is now {name}; the old name goes with the next version"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
        module = import_module(name)
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing to run: the module is there already."""
        # importlib has just written the second name's spec over the module's own
        assert module.__spec__ is not None
        module.__spec__ = self._specs.pop(module.__spec__.name)
