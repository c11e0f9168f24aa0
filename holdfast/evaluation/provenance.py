"""What figures were measured on."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass


@dataclass(frozen=True)
class Host:
    """A machine. machine: its instruction set. cpus: logical ones, None where not known."""

    machine: str
    system: str
    cpus: int | None


def host() -> Host:
    """This machine."""
    return Host(platform.machine(), platform.system(), os.cpu_count())
