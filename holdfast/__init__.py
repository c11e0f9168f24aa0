"""Know a grip is about to fail before it does: slip from magnetic fingertips.

The names in `__all__` are the public interface (docs/api.md). They load when they are first used,
so that `import holdfast` loads next to nothing.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from holdfast.core import errors as errors
    from holdfast.core.contract import GripCommand as GripCommand
    from holdfast.core.contract import Prediction as Prediction
    from holdfast.core.contract import Sample as Sample
    from holdfast.core.errors import DataError as DataError
    from holdfast.core.errors import DeviceError as DeviceError
    from holdfast.core.errors import HoldfastError as HoldfastError
    from holdfast.core.errors import ModelError as ModelError
    from holdfast.core.errors import UsageError as UsageError
    from holdfast.core.trial_file import read_trial as read_trial
    from holdfast.data.datasets import load as load_set
    from holdfast.edge_runtime.monitor import GripMonitor
    from holdfast.edge_runtime.recording import Answers as Answers
    from holdfast.live.hand_files import OpenHand

# onnxruntime from 1.31 on collects and sends usage data unless this turns it off before its import
os.environ["ORT_DISABLE_TELEMETRY"] = "1"

_HOMES = {
    "Prediction": "core.contract",
    "Sample": "core.contract",
    "DataError": "core.errors",
    "DeviceError": "core.errors",
    "HoldfastError": "core.errors",
    "ModelError": "core.errors",
    "UsageError": "core.errors",
    "read_trial": "core.trial_file",
    "Answers": "edge_runtime.recording",
    "GripCommand": "core.contract",
}
"""Public name -> the module that has it."""

__all__ = [
    "Answers",
    "DataError",
    "DeviceError",
    "GripCommand",
    "HoldfastError",
    "ModelError",
    "Prediction",
    "Sample",
    "UsageError",
    "errors",
    "load",
    "load_set",
    "open_hand",
    "read_trial",
]


def load(
    model: str | Path,
    *,
    live: bool = True,
    bias_known: bool = False,
    engine: str = "auto",
) -> GripMonitor:
    """A monitor on a model: `feed` it one sample at a time, or `replay` a whole recording.

    model: a file, or the name of a shipped model. live: the samples that are fed are stamped by
    CLOCK_BOOTTIME, and a late answer is `unknown`; False for recorded samples. bias_known: the bias
    was measured before, so a start with an object in the hand is detected. engine: "auto" takes the
    C form beside the file where there is one that fits, as `engine` of the monitor then says;
    "onnxruntime" or "c". Raises ModelError.
    """
    from holdfast.edge_runtime.engine import ModelChoice
    from holdfast.edge_runtime.monitor import NOW_NS, GripMonitor

    opened = ModelChoice(str(model), engine).open()
    clock_ns = NOW_NS if live else None
    return GripMonitor(opened, clock_ns, bias_known=bias_known)


def open_hand(
    url: str, *, calibration: str | Path | None = None, bias: str | Path | None = None
) -> OpenHand:
    """A hand, a stream or a recording, read now; `for sample in hand.samples(monitor)`.

    url: as for `holdfast run --source`: usb://ft232h, virtual://ft232h, replay://PATH, ..
    calibration: the file of `holdfast calibrate`, which turns field into newtons. bias: the file of
    `holdfast bias`; without it the hand must be empty at first. Raises UsageError, DeviceError or
    DataError.
    """
    from holdfast.live.hand_files import OpenHand

    return OpenHand(url, calibration, bias)


def __getattr__(name: str) -> Any:
    if name == "errors":
        return import_module("holdfast.core.errors")
    if name == "load_set":
        return import_module("holdfast.data.datasets").load
    if name not in _HOMES:
        raise AttributeError(f"module 'holdfast' has no attribute {name!r}")
    return getattr(import_module(f"holdfast.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
