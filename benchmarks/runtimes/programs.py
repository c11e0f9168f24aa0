"""Programs of other projects that the runtimes and Arm benchmarks call: compilers, emulators."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from holdfast.core.errors import HoldfastError, LibraryMissing

PACKAGES = {
    "gcc": "gcc",
    "clang": "clang",
    "wasm-ld": "lld",
    "node": "nodejs",
    "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu libc6-dev-arm64-cross",
    "qemu-aarch64-static": "qemu-user-static",
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "arm-none-eabi-size": "binutils-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
    "apt-get": "apt",
    "dpkg-deb": "dpkg",
}
"""Program -> Debian's packages that it is in."""
LONGEST_S = 900.0


def require(*programs: str) -> None:
    """Raise LibraryMissing where one of them is not installed."""
    missing = [name for name in programs if shutil.which(name) is None]
    if missing:
        packages = " ".join(PACKAGES[name] for name in missing)
        raise LibraryMissing(
            f"no {', '.join(missing)}",
            cause="not installed",
            next_step=f"apt-get install {packages} (Debian 12)",
        )


def called(
    words: Sequence[str | Path],
    folder: Path,
    environment: Mapping[str, str] | None = None,
) -> subprocess.CompletedProcess[bytes]:
    """A program that ended well. Raises HoldfastError with the last line that it wrote."""
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        capture_output=True,
        check=False,
        timeout=LONGEST_S,
        env=environment,
    )
    if done.returncode:
        lines = (
            (done.stderr or done.stdout).decode("utf-8", "replace").strip().splitlines()
        )
        raise HoldfastError(
            f"{words[0]} failed: {lines[-1] if lines else done.returncode!s:.300}"
        )
    return done
