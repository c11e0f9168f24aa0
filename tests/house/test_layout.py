"""The package works without the links at the top: nothing that runs depends on one."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from packages import ROOT

LINKS = ("drivers", "edge_runtime", "export", "training")
IN_GIT = (ROOT / ".git").exists()
"""Not in an unpacked archive, where these tests may run too."""


def without_links(folder: Path) -> Path:
    """A clone by a git that makes no links, as on a file system that has none or in a zip."""
    command = ["git", "clone", "-q", "-c", "core.symlinks=false", str(ROOT)]
    subprocess.run([*command, str(folder / "clone")], check=True)
    return folder / "clone"


BUILD = """
import gzip, sys
from hatchling.cli import hatchling

packed = gzip.GzipFile
# the smallest size takes seconds, and nothing here asks for it
gzip.GzipFile = lambda **options: packed(compresslevel=1, **options)
sys.argv = ["hatchling", "build", "-t", "sdist", "-d", sys.argv[1]]
sys.exit(hatchling())
"""


def unpacked_sdist(folder: Path) -> Path:
    """The source distribution."""
    command = [sys.executable, "-c", BUILD, str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (packed,) = folder.glob("*.tar.gz")
    with tarfile.open(packed) as archive:
        archive.extractall(folder / "sdist", filter="data")
    (tree,) = (folder / "sdist").iterdir()
    return tree


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return unpacked_sdist(tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not IN_GIT:
        pytest.skip("needs the repository")
    return without_links(tmp_path_factory.mktemp("clone"))


def python(tree: Path, *words: str) -> str:
    """What Python prints, with the tree's own package in place of the installed one."""
    done = subprocess.run(
        [sys.executable, *words],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


PROGRAM = """
import runpy, sys
from contextlib import suppress

import holdfast

for program in ("training.train", "export.export"):
    sys.argv = [program, "--help"]
    with suppress(SystemExit):
        runpy.run_module(f"holdfast.{program}", run_name="__main__")
print(holdfast.__file__)
print(holdfast.load("holdfast-150hz").card.model_id)
"""


@pytest.mark.parametrize("name", ["clone", "sdist"])
def test_a_tree_without_links_trains_exports_and_answers(
    name: str, request: pytest.FixtureRequest
) -> None:
    tree = request.getfixturevalue(name)
    assert not any((tree / name).is_dir() for name in LINKS)
    *helped, file, model_id = python(tree, "-c", PROGRAM).splitlines()
    assert str(helped).count("usage:") == 2
    assert Path(file).is_relative_to(tree)
    assert len(model_id) == 12


def test_the_source_archive_has_its_tests(sdist: Path) -> None:
    words = ("-m", "pytest", "-q", "-p", "no:cacheprovider")
    printed = python(sdist, *words, "tests/edge_runtime/test_decision.py")
    assert " passed" in printed


def test_the_old_name_of_a_module_that_moved_gives_the_module_and_a_warning() -> None:
    program = """
import warnings
from importlib import import_module
import holdfast

def old(name):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        module = import_module(name)
    (warning,) = (one for one in caught if one.category is DeprecationWarning)
    return module, str(warning.message)

datasets, said = old("holdfast.training.datasets")
assert datasets.load is holdfast.load_set
print(said)
thesis, _ = old("holdfast.training.datasets.thesis")
assert thesis is import_module("holdfast.data.datasets.thesis")
assert old("holdfast.training.progress")[0] is import_module("holdfast.core.progress")
assert old("holdfast.export.spec")[0] is import_module("holdfast.step.spec")
assert datasets.__spec__.name == "holdfast.data.datasets"
"""
    said = "holdfast.training.datasets is now holdfast.data.datasets"
    assert python(ROOT, "-c", program).startswith(said)


@pytest.mark.skipif(
    not all((ROOT / name).is_symlink() for name in LINKS), reason="no links here"
)
def test_a_link_gives_the_modules_of_the_package(tmp_path: Path) -> None:
    program = """
import edge_runtime.monitor, drivers, export.verify, training
import holdfast.edge_runtime.monitor, holdfast.drivers.replay, holdfast.export.verify
assert edge_runtime is holdfast.edge_runtime
assert edge_runtime.monitor is holdfast.edge_runtime.monitor
assert export.verify is holdfast.export.verify
import drivers.replay
assert drivers.replay.Replay is holdfast.drivers.replay.Replay
assert edge_runtime.monitor.__spec__.name == "holdfast.edge_runtime.monitor"
print("one of each")
"""
    assert python(ROOT, "-c", program).strip() == "one of each"
