"""The ONNX file from other languages, by the examples; C and Rust open the library of Python's."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime

from benchmarks.runtimes.c_programs import StreamAnswers
from benchmarks.runtimes.programs import called
from benchmarks.runtimes.stream import Stream

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
IN_RUST, IN_C, IN_WEB = (
    EXAMPLES / name for name in ("rust", "onnxruntime-c", "onnxruntime-web")
)
HEADER = "onnxruntime_c_api.h"
Words = list[str | Path]


@dataclass(frozen=True)
class OnnxProgram:
    """An example. build: into a folder; the words that start it, to be followed by a model."""

    name: str
    is_installed: Callable[[], bool]
    build: Callable[[Path], Words]


def library() -> Path:
    """The library that Python's onnxruntime loads."""
    (found,) = (Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.so.*")
    return found


def has_cargo() -> bool:
    """Whether this machine builds Rust."""
    return shutil.which("cargo") is not None


def has_header() -> bool:
    """Whether gcc finds onnxruntime's header: installed, or in a folder that CPATH names."""
    if shutil.which("gcc") is None:
        return False
    words = ["gcc", "-E", "-x", "c", "-include", HEADER, "/dev/null"]
    return subprocess.run(words, capture_output=True).returncode == 0


def has_web() -> bool:
    """Whether Node is here, and `npm install` was run in the example."""
    return (
        shutil.which("node") is not None
        and (IN_WEB / "node_modules/onnxruntime-web").exists()
    )


def from_rust(folder: Path) -> Words:
    """Built by cargo. Raises HoldfastError."""
    cargo: Words = ["cargo", "build", "-q", "--release"]
    called([*cargo, "--target-dir", folder.resolve() / "rust"], IN_RUST)
    return [folder / "rust/release/hand", library()]


def from_c(folder: Path) -> Words:
    """Built by gcc. Raises HoldfastError."""
    folder.mkdir(parents=True, exist_ok=True)
    flags: Words = [
        "-std=c99",
        "-D_POSIX_C_SOURCE=200809L",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-O2",
    ]
    called(
        ["gcc", *flags, "-o", folder.resolve() / "hand", IN_C / "hand.c", "-ldl"],
        folder,
    )
    return [folder / "hand", library()]


def in_node(folder: Path) -> Words:
    """Nothing to build."""
    return ["node", IN_WEB / "node.js"]


RUST = OnnxProgram("onnxruntime, from Rust", has_cargo, from_rust)
C_API = OnnxProgram("onnxruntime, from C", has_header, from_c)
WEB = OnnxProgram("onnxruntime-web, in Node", has_web, in_node)
PROGRAMS = (RUST, C_API, WEB)


def answers_of(words: Words, model: Path, stream: Stream) -> StreamAnswers:
    """What an example answers to a stream."""
    given = text_of(stream)
    done = subprocess.run(
        [*words, model], input=given, capture_output=True, text=True, check=True
    )
    labels = np.array(done.stdout.split(), dtype=np.int32)
    return StreamAnswers(
        labels, np.zeros((len(labels), 0), np.uint8), float(done.stderr)
    )


def text_of(stream: Stream) -> str:
    """A line of numbers for each sample, nan for a lost finger."""
    values = np.where(np.repeat(stream.valid, 3, axis=1), stream.values, np.nan)
    return "\n".join(" ".join(map(repr, row)) for row in values.tolist()) + "\n"
