"""`holdfast doctor MODEL` in Python on an emulated aarch64: Debian's interpreter, locked wheels.

Nothing is installed on this machine: the packages are unpacked into one folder, by an apt with
lists and status of its own. onnxruntime reads /proc/cpuinfo, and this machine's would tell it of
another processor; so the folder has one of an Arm processor.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from benchmarks.runtimes.programs import called, require

ROOT = Path(__file__).resolve().parents[2]
EMULATOR = "qemu-aarch64-static"
PACKAGES = ("python3-minimal", "libpython3-stdlib", "libstdc++6")
PLATFORM = "aarch64-manylinux_2_28"
CPUINFO = """processor\t: 0
BogoMIPS\t: 100.00
Features\t: fp asimd evtstrm aes pmull sha1 sha2 crc32 atomics fphp asimdhp cpuid asimdrdm
CPU implementer\t: 0x41
CPU architecture: 8
CPU variant\t: 0x3
CPU part\t: 0xd0c
CPU revision\t: 1
"""


def selftest(model: Path, folder: Path) -> list[str]:
    """The lines of the selftest on aarch64; folder: keeps what was fetched, for the next time.

    Raises LibraryMissing without the programs, HoldfastError where the selftest fails.
    """
    require(EMULATOR, "apt-get", "dpkg-deb")
    folder.mkdir(parents=True, exist_ok=True)
    root = folder / "root"
    site = folder / "site"
    if not (root / "proc/cpuinfo").exists():
        _unpack(folder, root)
    if not (site / "onnxruntime").exists():
        _wheels(site)
    python: list[str | Path] = [EMULATOR, "-L", root, root / "usr/bin/python3.11"]
    environment = os.environ | {
        "PYTHONPATH": f"{ROOT}:{site}",
        "PYTHONDONTWRITEBYTECODE": "1",
        "ORT_DISABLE_TELEMETRY": "1",
    }
    done = called(
        [*python, "-m", "holdfast", "doctor", model.resolve()], ROOT, environment
    )
    return done.stdout.decode("utf-8").splitlines()


def _unpack(folder: Path, root: Path) -> None:
    """Debian's packages for arm64 into `root`, by an apt that knows nothing of this machine's."""
    apt = folder / "apt"
    for part in ("state/lists/partial", "cache/archives/partial"):
        (apt / part).mkdir(parents=True, exist_ok=True)
    (apt / "status").touch()
    options = {
        "Dir::State": apt.resolve() / "state",
        "Dir::State::status": apt.resolve() / "status",
        "Dir::Cache": apt.resolve() / "cache",
        "APT::Architecture": "arm64",
        "APT::Architectures": "arm64",
        "APT::Install-Recommends": "false",
        "Debug::NoLocking": "1",
    }
    words = [
        word for key, value in options.items() for word in ("-o", f"{key}={value}")
    ]
    called(["apt-get", *words, "-qq", "update"], folder)
    called(
        ["apt-get", *words, "-qq", "-y", "--download-only", "install", *PACKAGES],
        folder,
    )
    for package in sorted((apt / "cache/archives").glob("*.deb")):
        called(["dpkg-deb", "-x", package.resolve(), root.resolve()], folder)
    (root / "proc").mkdir(exist_ok=True)
    (root / "proc/cpuinfo").write_text(CPUINFO, encoding="utf-8")


def _wheels(site: Path) -> None:
    """What the live path needs, by the hashes of its lock."""
    uv = ROOT / ".tools/bin/uv"
    only = [
        "--python",
        sys.executable,
        "--python-platform",
        PLATFORM,
        "--only-binary",
        ":all:",
    ]
    lock = ["--require-hashes", "-r", str(ROOT / "requirements/live.lock")]
    called([uv, "pip", "install", "-q", "--target", site.resolve(), *only, *lock], ROOT)
