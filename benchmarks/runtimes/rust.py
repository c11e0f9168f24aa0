"""The ONNX file from Rust: examples/rust, with the very library that Python's onnxruntime loads."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import onnxruntime

from benchmarks.runtimes.c_programs import StreamAnswers
from benchmarks.runtimes.programs import called
from benchmarks.runtimes.stream import Stream

NAME = "onnxruntime, from Rust"
EXAMPLE = Path(__file__).resolve().parents[2] / "examples/rust"


def has_cargo() -> bool:
    """Whether this machine builds Rust."""
    return shutil.which("cargo") is not None


def built(target: Path) -> Path:
    """The example's program, built in a folder. Raises HoldfastError."""
    cargo: list[str | Path] = ["cargo", "build", "-q", "--release"]
    called([*cargo, "--target-dir", target.resolve()], EXAMPLE)
    return target / "release/hand"


def from_rust(program: Path, model: Path, stream: Stream) -> StreamAnswers:
    """What the example answers to a stream; a lost finger is written as nan."""
    (library,) = (Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.so.*")
    values = np.where(np.repeat(stream.valid, 3, axis=1), stream.values, np.nan)
    text = "\n".join(" ".join(map(repr, row)) for row in values.tolist()) + "\n"
    done = subprocess.run(
        [program, library, model], input=text, capture_output=True, text=True, check=True
    )
    labels = np.array(done.stdout.split(), dtype=np.int32)
    return StreamAnswers(labels, np.zeros((len(labels), 0), np.uint8), float(done.stderr))
