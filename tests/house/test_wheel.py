"""What `pip install holdfast` gives: one import name, the model, and commands that work alone."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from packages import MAY_IMPORT, ROOT, SHIPPED, folder_of

from holdfast.core.contract import channel_names
from holdfast.live.sources import open_source

LIVE = (
    "numpy",
    "numpy.libs",
    "onnxruntime",
    "usb",
    "libusb_package",
    "importlib_resources",
)
"""What the live path's dependencies put into site-packages."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    command = [
        sys.executable,
        "-m",
        "hatchling",
        "build",
        "-t",
        "wheel",
        "-d",
        str(folder),
    ]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment with the wheel, the live path's packages and nothing else."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder)
    packages = Path(sysconfig.get_paths()["platlib"])
    for name in LIVE:
        if (packages / name).exists():
            (folder / name).symlink_to(packages / name)
    return {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}


def test_the_wheel_puts_one_name_into_site_packages(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as packed:
        names = packed.namelist()
    assert {re.sub(r"-.*", "", name.split("/")[0]) for name in names} == {"holdfast"}
    packages = {name.split("/")[1] for name in names if name.startswith("holdfast/")}
    assert set(SHIPPED) <= packages
    assert "holdfast/models/holdfast-150hz.onnx" in names


def test_every_file_of_the_rooms_that_git_has_is_in_the_wheel(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as packed:
        names = set(packed.namelist())
    known = subprocess.run(
        ["git", "ls-files", "holdfast"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split()
    files = [name for name in known if not (ROOT / name).is_symlink()]
    assert set(files) - names == set()


AFTER = {
    "a hand, now": "print(answer.sequence)",
    "a recording": 'print("late" in answers.why, answers.act.any())',
}
"""What is asked after each of the README's programs, in their order."""
PRINTED = {"a hand, now": "149", "a recording": "False True"}


@pytest.mark.parametrize("program", AFTER)
def test_the_readmes_lines_run_as_printed_where_only_the_live_path_is(
    installed: dict[str, str], tmp_path: Path, program: str
) -> None:
    """Each with its imports, and five lines: a user copies them."""
    readme = (ROOT / "README.md").read_text("utf-8")
    programs = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    assert len(programs) == len(AFTER)
    code = programs[list(AFTER).index(program)]
    lines = [line for line in code.splitlines() if line]
    assert len(lines) <= 5 + code.count("import ")
    write_recording(tmp_path / "recording.csv")
    command = [sys.executable, "-S", "-c", f"{code}{AFTER[program]}"]
    done = subprocess.run(
        command, cwd=tmp_path, env=installed, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == PRINTED[program]


def write_recording(path: Path) -> None:
    """A simulated pull that the shipped model acts on, as a table of times and forces."""
    source = open_source("sim://pull-soft-ball")
    table = np.column_stack([source.t_ns * 1e-9, source.values])
    header = ",".join(["Time", *channel_names(6)])
    np.savetxt(path, table, delimiter=",", header=header, comments="")


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (
            (
                "run",
                "holdfast-150hz",
                "--source",
                "virtual://ft232h",
                "--seconds",
                "0.2",
            ),
            0,
            "",
        ),
        (("scan", "virtual://ft232h"), 0, ""),
        (
            ("run", "holdfast-150hz", "--source", "virtual://ft232h", "--view"),
            2,
            "holdfast[train",
        ),
        (("train",), 2, "holdfast[train"),
        (("completion", "bash"), 2, "holdfast[completion]"),
    ],
)
def test_a_command_works_or_names_an_extra(
    installed: dict[str, str],
    tmp_path: Path,
    words: tuple[str, ...],
    code: int,
    says: str,
) -> None:
    command = [sys.executable, "-S", "-m", "holdfast", *words]
    done = subprocess.run(
        command, cwd=tmp_path, env=installed, capture_output=True, text=True
    )
    assert done.returncode == code, done.stderr
    assert says in done.stderr


def test_every_extra_that_a_message_names_is_one_of_the_wheels() -> None:
    about = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    extras = set(about["project"]["optional-dependencies"])
    named = {
        extra
        for package in MAY_IMPORT
        for path in folder_of(package).rglob("*.py")
        for words in re.findall(r"holdfast\[([a-z0-9,]+)\]", path.read_text("utf-8"))
        for extra in words.split(",")
    }
    assert named
    assert named <= extras
