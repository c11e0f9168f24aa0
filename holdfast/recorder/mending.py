"""What `holdfast repair` does to one trial's folder."""

from __future__ import annotations

import json
import os
from pathlib import Path

from edge_runtime.errors import OutputError
from edge_runtime.tactile_file import mend
from edge_runtime.writing import write_whole
from holdfast.recorder.folder import INTERRUPTED, RECORDING
from holdfast.recorder.labels import EVENTS, META, TACTILE, read_meta


def repaired(folder: Path) -> list[str]:
    """Mend one trial; what was done, in words. Raises a DataError or OutputError."""
    mended = mend(folder / TACTILE)
    torn = f"{mended.cut_bytes} bytes of a torn line taken away, {mended.rows} samples whole"
    said = [torn] if mended.cut_bytes else []
    cut = _mend_events(folder / EVENTS)
    said += [f"{cut} bytes of a torn event taken away"] if cut else []
    meta = read_meta(folder)
    if meta.get("state") == RECORDING:
        told = {**meta, "state": INTERRUPTED, "why": f"cut off; mended, {mended.rows} samples"}
        write_whole(folder / META, json.dumps(told, indent=1) + "\n")
        said.append(f"marked as interrupted with {mended.rows} samples")
    return said


def _mend_events(path: Path) -> int:
    try:
        data = path.read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            os.truncate(path, whole)
        return len(data) - whole
    except FileNotFoundError:
        return 0
    except OSError as error:
        raise OutputError(f"cannot be mended ({error.strerror})", where=path, next_step="copy it, mend that") from None
