"""Programs of other projects that the runtimes and Arm benchmarks call: compilers, emulators."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
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
    words: Sequence[str | Path], folder: Path
) -> subprocess.CompletedProcess[bytes]:
    """A program that ended well. Raises HoldfastError with the last line that it wrote."""
    command = [str(word) for word in words]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, check=False, timeout=LONGEST_S
    )
    if done.returncode:
        wrote = (done.stderr or done.stdout).decode("utf-8", "replace").splitlines()
        last = wrote[-1] if wrote else f"it ended with {done.returncode}"
        raise HoldfastError(f"{words[0]} failed: {last:.300}")
    return done
