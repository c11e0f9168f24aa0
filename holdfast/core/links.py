"""The links at the top: `import edge_runtime` gives the modules of holdfast.edge_runtime.

A link is for readers; nothing in Holdfast imports through it. Without this, Python would load every
module a second time under the link's name, and its classes would not be Holdfast's classes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType


def link(name: str) -> None:
    """Let the package `name` and its modules be holdfast.`name` and its modules."""
    sys.meta_path.insert(0, _Link(f"{name}."))
    sys.modules[name] = import_module(f"holdfast.{name}")


class _Link(MetaPathFinder, Loader):
    """Finds every module of one link."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        """This object itself loads every module of its link."""
        return ModuleSpec(fullname, self) if fullname.startswith(self._prefix) else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The package's own module, loaded where it is not yet."""
        module = import_module(f"holdfast.{spec.name}")
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing to run: the module is there already."""
        # importlib has just written the link's spec over the module's own
        assert module.__spec__ is not None
        module.__spec__ = self._specs.pop(module.__spec__.name)
