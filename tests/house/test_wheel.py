"""What `pip install holdfast` gives: one import name, the model, and commands that work alone."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from long_steps import long_steps
from lossy_set import write_lossy_set
from packages import MAY_IMPORT, ROOT, SHIPPED, folder_of

from holdfast.core.contract import channel_names
from holdfast.live.sources import open_source

LIVE = (
    "numpy",
    "msgspec",
    "numpy.libs",
    "onnxruntime",
    "usb",
    "libusb_package",
    "importlib_resources",
)
"""What the live path's dependencies put into site-packages."""
VIRTUAL = ("run", "--source", "virtual://ft232h")
"""Without a model: the shipped one is taken."""
OF_FORMAT = {
    "parquet": ("pyarrow", "pyarrow.libs"),
    "mcap": (
        "mcap",
        "mcap_protobuf",
        "google",
        "lz4",
        "zstandard",
    ),
    "lerobot": ("pandas", "pyarrow", "dateutil", "pytz", "six.py", "tzdata"),
}
"""What the extra of a format puts into site-packages, with what that needs itself."""


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
    """An environment with the wheel, the live path's packages and nothing else.

    Compiled modules are kept: each of many processes would compile the wheel anew.
    """
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder)
    packages = Path(sysconfig.get_paths()["platlib"])
    for name in LIVE:
        if (packages / name).exists():
            (folder / name).symlink_to(packages / name)
    return {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": ""}


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
    with long_steps():
        source = open_source("sim://pull-soft-ball")
    table = np.column_stack([source.t_ns * 1e-9, source.values])
    header = ",".join(["Time", *channel_names(6)])
    np.savetxt(path, table, delimiter=",", header=header, comments="")


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ((*VIRTUAL, "--seconds", "0.2"), 0, "samples"),
        ((*VIRTUAL, "--seconds", "0.2", "--to", "view"), 0, "samples"),
        (("scan", "virtual://ft232h"), 0, ""),
        (("simulate", "thesis", "--trials", "1", "--out", "made"), 0, "simulating"),
        (("train",), 2, "holdfast[train"),
        (("doctor", "--completion", "bash"), 6, "holdfast[completion]"),
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


def commands_of_the_readme() -> list[str]:
    """Those that run as they are printed, without a hand and without a name to fill in."""
    readme = (ROOT / "README.md").read_text("utf-8")
    commands = re.findall(r"`(holdfast [^`]+)`", readme)
    whole = []
    for command in commands:
        words = shlex.split(command)
        # it needs options, waits for a bridge, needs an extra, or takes as long as a test
        bare = len(words) == 2 or words[1] == "doctor" or "c" in words
        if not bare and not any(re.fullmatch("[A-Z.]+", word) for word in words):
            whole.append(command)
    return [one for one in whole if "oak" not in one and "completion" not in one]


def test_the_readmes_commands_are_those_of_the_wheel(
    installed: dict[str, str], tmp_path: Path
) -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    # the wheel has no folder models/: a shipped model has a name
    assert re.findall(r"holdfast \w+ models/", readme) == []
    commands = commands_of_the_readme()
    assert any("virtual://" in command for command in commands)
    for printed in commands:
        words = shlex.split(printed)[1:]
        if words[0] == "run":
            # the README's program above opens its scene, which takes seconds to simulate
            words = [word.split("?scene=")[0] for word in words] + ["--seconds", "0.2"]
        command = [sys.executable, "-S", "-m", "holdfast", *words]
        done = subprocess.run(
            command, cwd=tmp_path, env=installed, capture_output=True, text=True
        )
        assert done.returncode == 0, (printed, done.stderr)


@pytest.mark.parametrize("form", OF_FORMAT)
def test_a_conversion_needs_the_extra_of_its_format_and_no_other(
    installed: dict[str, str], tmp_path: Path, form: str
) -> None:
    write_lossy_set(tmp_path / "trials")
    words = ("convert", "trials", "--to", form, "--out", f"made-{form}")
    command = [sys.executable, "-S", "-m", "holdfast", *words]

    bare = subprocess.run(
        command, cwd=tmp_path, env=installed, capture_output=True, text=True
    )
    assert bare.returncode == 6, bare.stderr
    assert f"pip install 'holdfast[{form}]'" in bare.stderr

    packages = Path(sysconfig.get_paths()["platlib"])
    extra = tmp_path / "site"
    extra.mkdir()
    for name in OF_FORMAT[form]:
        # some ask for their own version, which stands beside them
        for found in [packages / name, *packages.glob(f"{name}-*.dist-info")]:
            if found.exists():
                (extra / found.name).symlink_to(found)
    with_extra = {**installed, "PYTHONPATH": f"{installed['PYTHONPATH']}:{extra}"}
    done = subprocess.run(
        command, cwd=tmp_path, env=with_extra, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert any((tmp_path / f"made-{form}").iterdir())


def test_the_doctor_says_in_one_line_which_extras_are_not_there(
    installed: dict[str, str], tmp_path: Path
) -> None:
    command = [sys.executable, "-S", "-m", "holdfast", "doctor", "--json"]
    done = subprocess.run(
        command, cwd=tmp_path, env=installed, capture_output=True, text=True, check=True
    )
    found = {line["what"]: line for line in json.loads(done.stdout)["findings"]}
    missing = [line for line in found.values() if line["status"] == "missing"]
    # the packages of the live path are linked here, and not installed
    assert {line["what"] for line in missing} - {"udev", "priority", "governor"} <= {
        "live path",
        "bridges",
    }
    assert found["extras"]["status"] == "ok"
    for extra in ("train", "viz", "mcap", "lsl"):
        assert extra in found["extras"]["found"]
    assert "data sets" not in found


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
