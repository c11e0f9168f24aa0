"""The tables of docs/any-runtime.md: `make docs`."""

from __future__ import annotations

import sys
from pathlib import Path

from holdfast.core.reading import Json
from tools.doc_tables import Tables, refresh, table

HERE_HEADS = {
    "runtime": "runtime",
    "step_us": "step, us",
    "beside_python": "beside onnxruntime from Python",
    "labels_differ": "labels that differ",
    "same_bits": "bits of gcc's C",
}
BOARD_HEADS = {
    "model": "model",
    "precision": "precision",
    "flash_kb": "flash, kB",
    "ram_kb": "RAM, kB",
    "stack_kb": "of it stack, kB",
    "instructions": "instructions a step",
    "most_instructions": "the most",
    "projected_us": "projected at 480 MHz, us",
    "golden": "golden labels that differ",
    "stream": "stream labels that differ",
}
AARCH64_HEADS = {
    "model": "model",
    "aarch64_golden": "self-test in C",
    "stream": "stream labels that differ",
    "same_bits": "bits of gcc on x86-64",
}
SAME = {True: "the same", False: "others", None: "-"}


def here(figures: Json) -> Tables:
    """The runtimes of one machine."""
    rows = [row | {"same_bits": SAME[row["same_bits"]]} for row in figures["runtimes"]]
    return {"runtimes": table(rows, HERE_HEADS)}


def arm(figures: Json) -> Tables:
    """What was emulated."""
    models = figures["models"]
    return {
        "aarch64": table([_aarch64(one) for one in models], AARCH64_HEADS),
        "cortex-m7": table(
            [_board(one, board) for one in models for board in one["boards"]],
            BOARD_HEADS,
        ),
    }


def _aarch64(one: Json) -> Json:
    stream = f"{one['aarch64_labels_differ']} of {one['rows']:,}"
    return one | {"stream": stream, "same_bits": SAME[one["aarch64_same_bits"]]}


def _board(one: Json, board: Json) -> Json:
    kb = {
        f"{key}_kb": f"{board[f'{key}_bytes'] / 1000:.1f}"
        for key in ("flash", "ram", "stack")
    }
    counts = {key: f"{board[key]:,}" for key in ("instructions", "most_instructions")}
    return {
        **board,
        **kb,
        **counts,
        "model": one["model"],
        "projected_us": f"{board['projected_us']:.0f}",
        "golden": f"{board['labels_differ']} of {board['rows']} rows",
        "stream": f"{board['stream_labels_differ']} of {one['rows']:,}",
    }


if __name__ == "__main__":
    refresh(sys.argv[3], {Path(sys.argv[1]): here, Path(sys.argv[2]): arm})
