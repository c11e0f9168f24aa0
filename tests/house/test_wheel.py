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

import pytest
from lossy_set import write_lossy_set
from packages import MAY_IMPORT, ROOT, SHIPPED, folder_of

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


def python(
    installed: dict[str, str], folder: Path, *words: str
) -> subprocess.CompletedProcess[str]:
    """Python in this environment alone."""
    command = [sys.executable, "-S", *words]
    return subprocess.run(
        command, cwd=folder, env=installed, capture_output=True, text=True
    )


def test_the_wheel_puts_one_name_into_site_packages(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as packed:
        names = packed.namelist()
    assert {re.sub(r"-.*", "", name.split("/")[0]) for name in names} == {"holdfast"}
    packages = {name.split("/")[1] for name in names if name.startswith("holdfast/")}
    assert set(SHIPPED) <= packages
    assert "holdfast/models/holdfast-150hz.onnx" in names
    # the files learned from recordings by others, whose licence asks for it
    assert "holdfast/models/NOTICE" in names


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="needs the repository")
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


def test_the_readmes_program_prints_what_it_says_where_only_the_live_path_is(
    installed: dict[str, str], tmp_path: Path
) -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    fed = "answer = monitor.feed(sample)"
    assert program.count(fed) == 1
    program = program.replace(fed, f"{fed}; whys.append(answer.why)")
    kept = f"whys = []\n{program}print(sample.sequence + 1 - len(whys), *whys[150:])"
    done = python(installed, tmp_path, "-c", kept)
    assert done.returncode == 0, done.stderr
    state, troubles = done.stdout.splitlines()[-2:]
    # it runs in real time: a machine that is too busy loses samples, or answers too late
    if troubles.split() == ["0"]:
        assert f"# {state}\n" in program


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ((*VIRTUAL, "--grip", "virtual", "--seconds", "0.2"), 0, "obeys its wearer"),
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
    done = python(installed, tmp_path, "-m", "holdfast", *words)
    assert done.returncode == code, done.stderr
    assert says in done.stderr


@pytest.mark.parametrize("form", OF_FORMAT)
def test_a_conversion_needs_the_extra_of_its_format_and_no_other(
    installed: dict[str, str], tmp_path: Path, form: str
) -> None:
    write_lossy_set(tmp_path / "trials")
    out = f"made-{form}"
    words = ("-m", "holdfast", "convert", "trials", "--to", form, "--out", out)
    bare = python(installed, tmp_path, *words)
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
    done = python(with_extra, tmp_path, *words)
    assert done.returncode == 0, done.stderr
    assert any((tmp_path / out).iterdir())


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
