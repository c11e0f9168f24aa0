"""Sentences about the house itself: who may call whom, what the hand loads, what the locks hold."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from packages import (
    ARROWS,
    HOUSE,
    MAY_IMPORT,
    ROOT,
    SHIPPED,
    folder_of,
    imports_by_file,
    imports_of,
    loaded_by,
    reached,
)

if TYPE_CHECKING:
    from conftest import Built


NOT_ON_THE_HAND = {
    "scipy",
    "sklearn",
    "pandas",
    "onnx",
    "usb",
    "depthai",
    "matplotlib",
    "rich",
}
OF_ONE_FILE = (
    "depthai",
    "mcap",
    "openpyxl",
    "pyarrow",
    "pylsl",
    "pyxdf",
    "rosbags",
    "serial",
)
READS_PICKLE = {
    "pickle",
    "_pickle",
    "cPickle",
    "cloudpickle",
    "dill",
    "joblib",
    "marshal",
    "shelve",
}


SCRIPTS = ("holdfast/training/train.py", "holdfast/export/export.py")
"""The verbs of the same names as scripts: these two files alone may call the command line."""


def wrong_directions(package: str) -> dict[str, set[str]]:
    allowed = MAY_IMPORT[package] | {package}
    found = {
        file: (names & HOUSE) - allowed - ({"cli"} if file in SCRIPTS else set())
        for file, names in imports_by_file(package).items()
    }
    return {file: names for file, names in found.items() if names}


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_room_imports_only_the_rooms_it_may(package):
    assert wrong_directions(package) == {}


def test_an_arrow_of_the_drawing_leads_down_and_some_import_follows_it():
    rooms = list(ARROWS)
    for room, ends in ARROWS.items():
        imported = set().union(*imports_by_file(room).values())
        for end in ends:
            assert rooms.index(end) > rooms.index(room), (room, end)
            assert end in imported, f"no file of {room} imports {end}"
            others = set(ends) - {end}
            assert all(end not in reached(one) for one in others), (room, end)


def test_every_room_says_what_it_is_for_what_it_may_import_and_where_to_begin():
    for room in SHIPPED:
        text = ast.get_docstring(
            ast.parse((folder_of(room) / "__init__.py").read_text())
        )
        lines = str(text).splitlines()
        heads = [line.split(":")[0] for line in lines[:3]]
        assert heads == ["For", "May import", "Begin with"], room
        begin = re.search(r"[\w/]+\.py", lines[2])
        assert begin is not None, room
        assert (folder_of(room) / begin[0]).is_file(), lines[2]
        promised = set(re.findall(r"\w+", lines[1].split(":")[1])) & set(SHIPPED)
        assert promised <= reached(room), room


def test_inside_the_simulation_imports_go_down_only():
    above: list[str] = []
    for room in ("loop", "scenes", "physics", "effects"):
        for file in (folder_of("simulation") / room).glob("*.py"):
            text = file.read_text("utf-8")
            assert not [one for one in above if f"simulation.{one}" in text], file
        above.append(room)


def test_a_library_that_only_an_extra_installs_is_imported_in_one_file():
    files = {
        file: names
        for package in MAY_IMPORT
        for file, names in imports_by_file(package).items()
    }
    for library in OF_ONE_FILE:
        importers = [file for file, names in files.items() if library in names]
        assert len(importers) == 1, (library, importers)


def test_every_folder_with_code_has_a_place_in_the_table():
    folders = {p.parent.name for p in (ROOT / "holdfast").glob("*/__init__.py")}
    assert folders == set(SHIPPED)


def test_the_import_test_sees_every_way_to_import():
    source = """
import holdfast.training.fitting as t
def late():
    from holdfast.export import graph
    import importlib
    importlib.import_module("holdfast.simulation.scenes.scene")
    __import__("holdfast.drivers")
    from . import neighbour
"""
    expected = {
        "training",
        "export",
        "simulation",
        "drivers",
        "importlib",
        "edge_runtime",
    }
    assert imports_of(source, "edge_runtime") == expected


def test_edge_runtime_and_all_its_modules_load_nothing_that_is_not_on_the_hand():
    program = """
import importlib, pkgutil
from holdfast import edge_runtime
for m in pkgutil.walk_packages(edge_runtime.__path__, "holdfast.edge_runtime."):
    if not m.name.endswith("__main__"):
        importlib.import_module(m.name)
"""
    loaded = loaded_by(program)
    assert "edge_runtime" in loaded
    assert (
        loaded & (NOT_ON_THE_HAND | (set(MAY_IMPORT) - {"core", "edge_runtime"}))
        == set()
    )


@pytest.mark.parametrize("package", ["edge_runtime", "drivers"])
def test_nothing_on_the_hand_reads_a_pickle(package):
    readers = {
        file: names & READS_PICKLE for file, names in imports_by_file(package).items()
    }
    assert {file: names for file, names in readers.items() if names} == {}
    permissive = [
        str(f.relative_to(ROOT))
        for f in folder_of(package).rglob("*.py")
        if re.search(r"allow_pickle\s*=\s*True", f.read_text("utf-8"))
    ]
    assert permissive == []


def lock_files() -> list[Path]:
    return [ROOT / "tools/uv.txt", *sorted((ROOT / "requirements").glob("*.lock"))]


def requirement_names(requirements: list[str]) -> set[str]:
    return {
        re.split(r"[^A-Za-z0-9_.-]", r.strip())[0].lower().replace("_", "-")
        for r in requirements
    }


def locked_names(lock: Path) -> set[str]:
    return requirement_names(
        [x for x in lock.read_text("utf-8").splitlines() if re.match(r"[A-Za-z0-9]", x)]
    )


def test_no_lock_names_an_index_or_a_host():
    assert len(lock_files()) > 1
    address = re.compile(
        r"://|--(extra-)?index|--find-links|\w\.(org|com|net|io|dev)\b", re.I
    )
    lines = [
        f"{lock.name}: {x}"
        for lock in lock_files()
        for x in lock.read_text("utf-8").splitlines()
        if address.search(x)
    ]
    assert lines == []


def test_every_pin_in_every_lock_is_exact_and_hashed():
    for lock in lock_files():
        entries = re.split(r"\n(?=[A-Za-z0-9])", lock.read_text("utf-8"))
        good = re.compile(r"[\w.-]+==\S+ .*--hash=sha256:[0-9a-f]{64}", re.DOTALL)
        loose = [entry.split()[0] for entry in entries if not good.match(entry)]
        assert loose == [], lock.name


def test_every_declared_dependency_is_locked():
    about = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    live = requirement_names(about["project"]["dependencies"])
    extras = requirement_names(
        [r for e in about["project"]["optional-dependencies"].values() for r in e]
    )
    assert live == {
        "numpy",
        "onnxruntime",
        "pyusb",
        "libusb-package",
        "msgspec",
        "smbus2",
    }
    assert live <= locked_names(ROOT / "requirements/live.lock")
    dev = requirement_names(about["dependency-groups"]["dev"])
    assert live | extras | dev <= locked_names(ROOT / "requirements/dev.lock")
    build = requirement_names(about["build-system"]["requires"])
    assert build <= locked_names(ROOT / "requirements/build.lock")


def pins(name: str) -> set[str]:
    text = (ROOT / "requirements" / f"{name}.lock").read_text("utf-8")
    return set(re.findall(r"^[A-Za-z0-9]\S+==\S+", text, re.MULTILINE))


def test_the_hand_is_locked_to_the_versions_that_are_tested():
    assert pins("live")
    assert pins("live") <= pins("dev")


def test_the_demo_is_locked_to_a_part_of_what_is_tested_without_the_camera():
    assert pins("demo") < pins("dev")
    names = locked_names(ROOT / "requirements/demo.lock")
    assert not names & {"depthai", "pytest", "mypy", "atheris"}
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"][
        "optional-dependencies"
    ]
    assert requirement_names([*extras["train"], *extras["viz"]]) <= names


def test_the_version_is_the_same_wherever_it_is_written():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"][
        "version"
    ]
    citation = (ROOT / "CITATION.cff").read_text("utf-8")
    assert re.findall(r"^version: \"?([^\"\n]+)\"?$", citation, re.MULTILINE) == [
        version
    ]


def test_nothing_that_opens_a_model_leaves_telemetry_behind(
    tmp_path: Path, eight_classes: Built
) -> None:
    home = tmp_path / "home"
    home.mkdir()
    clean = {
        key: value
        for key, value in os.environ.items()
        if key not in ("ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME")
    }
    for first in (
        "holdfast.edge_runtime.monitor",
        "holdfast.live.bench",
        "holdfast.step.builder",
    ):
        model = repr(str(eight_classes.model))
        load = f"from holdfast.edge_runtime.monitor import Model; Model({model})"
        code = f"import {first}; {load}"
        subprocess.run(
            [sys.executable, "-c", code],
            check=True,
            cwd=ROOT,
            env={**clean, "HOME": str(home)},
        )
    assert list(home.rglob("*onnxruntime*")) == []
