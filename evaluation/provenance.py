"""What figures were measured on."""

from __future__ import annotations

import os
import platform
from typing import Any


def host() -> dict[str, Any]:
    """What the figures were measured on."""
    return {"machine": platform.machine(), "system": platform.system(), "cpus": os.cpu_count()}
