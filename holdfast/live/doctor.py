"""What `holdfast doctor` examines: packages, models, buses and rights of this machine.

What belongs to an extra, a bridge or a board is examined only where that is there: a line that says
"missing" is something to do. Every check imports what it examines late: a package that is missing
is a finding, not an error.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

LIVE_PATH = "live path"
EXTRAS = {
    LIVE_PATH: ("numpy", "msgspec", "onnxruntime", "pyusb", "libusb-package", "smbus2"),
    "train": ("scikit-learn", "skl2onnx", "onnx", "scipy", "pandas", "skops"),
    "viz": ("matplotlib", "jinja2"),
    "camera": ("depthai",),
    "completion": ("shtab",),
    "dask": ("distributed",),
    "lerobot": ("pandas", "pyarrow"),
    "lsl": ("pylsl",),
    "mcap": ("mcap", "mcap-protobuf-support"),
    "parquet": ("pyarrow",),
    "ros2": ("rosbags",),
    "serial": ("pyserial",),
    "view": ("rich",),
    "xdf": ("pyxdf",),
    "xlsx": ("openpyxl",),
}
RULES = "holdfast board udev | sudo tee /etc/udev/rules.d/70-holdfast.rules"
Status = Literal["ok", "missing", "broken"]


@dataclass(frozen=True)
class Finding:
    """One thing checked: its status, what was found, and the next step if it is not ok."""

    what: str
    status: Status
    found: str
    next_step: str = ""


Check = Callable[[], list[Finding]]


def examine(settings: Check) -> Iterator[Finding]:
    """All findings; a check that raises becomes a finding too.

    settings: a check of the package above this one.
    """
    # from what everything needs to what only a live hand needs
    checks: dict[str, Check] = {
        "machine": _machine,
        "packages": _packages,
        "onnxruntime": _runtime,
        "models": _models,
        "settings": settings,
        "bridges": _bridges,
        "i2c": _native_buses,
        "priority": _priority,
    }
    for name, check in checks.items():
        yield from findings_of(name, check)


def findings_of(name: str, check: Check) -> list[Finding]:
    """What a check finds; its error is a finding of that name."""
    try:
        return check()
    # the live path is installed without the packages of training
    except ModuleNotFoundError as error:
        step = "only the live path is installed: pip install 'holdfast[train]'"
        return [Finding(name, "missing", f"needs {error.name}", step)]
    except Exception as error:  # doctor must report, whatever fails
        found = f"{type(error).__name__}: {error}"
        step = getattr(error, "next_step", "") or "report this line"
        return [Finding(name, "broken", found, step)]


def _machine() -> list[Finding]:
    system = f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs"
    found = f"Python {platform.python_version()}, {system}"
    return [Finding("machine", "ok", found)]


def missing_of(extra: str) -> list[str]:
    """The packages of an extra that are not installed."""
    missing = []
    for name in EXTRAS[extra]:
        try:
            importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    return missing


def _packages() -> list[Finding]:
    """The live path with its versions, and all extras in one line."""
    missing = missing_of(LIVE_PATH)
    live = Finding(
        LIVE_PATH,
        "missing",
        f"not installed: {', '.join(missing)}",
        "pip install holdfast",
    )
    if not missing:
        versions = [
            f"{one} {importlib.metadata.version(one)}" for one in EXTRAS[LIVE_PATH]
        ]
        live = Finding(LIVE_PATH, "ok", ", ".join(versions))

    absent = [extra for extra in EXTRAS if extra != LIVE_PATH and missing_of(extra)]
    if not absent:
        return [live, Finding("extras", "ok", "all are installed")]
    found = f"not installed, or in part: {', '.join(absent)}"
    step = "pip install 'holdfast[NAME]' for one that you want"
    return [live, Finding("extras", "ok", found, step)]


def _runtime() -> list[Finding]:
    from holdfast.edge_runtime.model_file import check_runtime

    check_runtime()
    return [Finding("onnxruntime", "ok", "not one of the versions known to be wrong")]


def _models() -> list[Finding]:
    """The shipped models, and the one that `holdfast export` without options wrote here."""
    from holdfast.core.schema import shipped

    # only where it was built: most machines have the shipped models alone
    words = [*shipped(), *map(str, Path().glob("build/default/holdfast.onnx"))]
    findings = []
    for word in words:
        findings += findings_of(f"model {word}", partial(_model, word))
    return findings


def _model(word: str) -> list[Finding]:
    from holdfast.edge_runtime.monitor import Model

    # a model that opens has answered its golden sequences as it did at its export
    found = f"id {Model(word).card.model_id}, golden sequences reproduced"
    return [Finding(f"model {word}", "ok", found)]


def _bridges() -> list[Finding]:
    """Every bridge on USB: whether this user may open it, and which kernel driver is bound."""
    from holdfast.core.errors import DeviceError
    from holdfast.drivers.bus import BRIDGE
    from holdfast.drivers.usb import UsbPort, find_usb, real_backend

    findings = []
    backend = real_backend()
    # several bridges are told apart by their number
    for number in range(len(find_usb(backend))):
        # only opening it shows whether this user may
        try:
            UsbPort(backend, number=number).close()
            findings.append(Finding(f"bridge {BRIDGE}", "ok", "can be opened"))
        except DeviceError as error:
            step = f"{RULES}, then plug it in again"
            found = Finding(f"bridge {BRIDGE}", "broken", str(error), step)
            findings.append(found)

    return findings or [Finding("bridges", "ok", "none on USB")]


def _native_buses() -> list[Finding]:
    buses = sorted(Path("/dev").glob("i2c-*"))
    if not buses:
        step = "on a Raspberry Pi: dtparam=i2c_arm=on in config.txt"
        return [Finding("i2c", "ok", "no /dev/i2c-*", step)]

    # a bus that is there and not allowed needs another remedy than a missing one
    names = ", ".join(map(str, buses))
    if not all(os.access(bus, os.R_OK | os.W_OK) for bus in buses):
        step = "sudo usermod -aG i2c $USER"
        return [Finding("i2c", "broken", f"not allowed: {names}", step)]
    return [Finding("i2c", "ok", names)]


def _priority() -> list[Finding]:
    from holdfast.live.running import PRIORITY, real_time

    # tried and not looked up: limits, capabilities and root can all allow it
    with real_time() as allowed:
        if allowed:
            return [Finding("priority", "ok", "a hand is read with real-time priority")]

    limit = f'echo "$USER - rtprio {PRIORITY}" | sudo tee /etc/security/limits.d/holdfast.conf'
    step = f"{limit}, then log in again"
    return [Finding("priority", "missing", "a busy machine may delay a sample", step)]
