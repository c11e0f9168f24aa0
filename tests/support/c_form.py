"""C forms of small models, compiled once a run, and their answers beside onnxruntime's."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from holdfast.export.c.exporting import export_c
from holdfast.export.c.graph import C_TYPES, Graph, read_graph

HARNESS = Path(__file__).with_name("c_harness.c")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off")
SANITIZERS: tuple[str, ...] = (
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
)
if resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY:
    # a sanitizer maps 16 TB of addresses, which is more than a mutant's tests may have
    SANITIZERS = ()
SANITISED = ("-O0", *SANITIZERS)
NUMPY_TYPES = {"double": "f8", "float": "f4", "int32_t": "i4", "uint8_t": "u1"}
Array = npt.NDArray[Any]


def require_compiler(name: str = "gcc", *flags: str) -> str:
    """A compiler that is installed, with the runtime of the sanitizers that flags ask for.

    Without one a test skips; where nothing may skip it fails for gcc.
    """
    sanitizers = tuple(flag for flag in flags if flag.startswith("-fsanitize="))
    line = ""
    if shutil.which(name) is None:
        line = f"no {name}: apt-get install {name}"
    elif sanitizers and not _makes_a_program(name, *sanitizers):
        line = f"{name} lacks the runtime of its sanitizers ({' '.join(sanitizers)})"
    if line:
        if name == "gcc" and os.environ.get("HOLDFAST_REQUIRE_DATA") == "1":
            pytest.fail(line, pytrace=False)
        pytest.skip(line)
    return name


@cache
def _makes_a_program(compiler: str, *flags: str) -> bool:
    """Whether an empty program compiles and links with these flags, tried once a process."""
    with TemporaryDirectory() as folder:
        command = [compiler, *flags, "-x", "c", "-", "-o", f"{folder}/empty"]
        source = b"int main(void) { return 0; }"
        return (
            subprocess.run(command, input=source, capture_output=True).returncode == 0
        )


@dataclass(frozen=True)
class CForm:
    """A model's sources in a folder, and its graph. model: the ONNX file."""

    model: Path
    folder: Path
    graph: Graph

    def program(self, compiler: str, *flags: str, main: str = str(HARNESS)) -> Path:
        """A program with this main: the harness, or a file of the C form; compiled once."""
        require_compiler(compiler, *flags)
        kind = "".join((compiler, *flags))
        built, path = (
            self.folder / f"{kind}.o",
            self.folder / f"{kind}-{Path(main).stem}",
        )
        if not built.exists():
            self._compile(built, compiler, *flags, "-c", "holdfast.c")
        if not path.exists():
            self._compile(path, compiler, *flags, "-I.", built.name, main, "-lm")
        return path

    def _compile(self, made: Path, compiler: str, *words: str) -> None:
        """Under a name of its own first: another process of the tests may make the same."""
        own = made.with_name(f"{os.getpid()}-{made.name}")
        command = [compiler, *STRICT, "-o", own.name, *words]
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[:2000]
        own.replace(made)

    @property
    def out_type(self) -> np.dtype[Any]:
        """The layout of holdfast_out."""
        fields = [
            (
                name,
                NUMPY_TYPES[C_TYPES[self.graph.element(name)]],
                self.graph.shape(name)[1:],
            )
            for name in self.graph.outputs
        ]
        return np.dtype(fields, align=True)

    def stepped(
        self, program: Path, values: Array, valid: Array, fresh: Array
    ) -> Array:
        """features, out and state after every sample: values [T, C], valid [T, S], fresh [T]."""
        channels, rows = values.shape[1], self.graph.shape("state")[1:]
        record = [
            ("sample", "f8", channels),
            ("valid", "u1", channels // 3),
            ("fresh", "u1"),
        ]
        given = np.zeros(len(values), np.dtype(record))
        given["sample"], given["valid"], given["fresh"] = values, valid, fresh
        answers = [
            ("features", "f4", self.graph.n_features),
            ("out", self.out_type),
            ("state", "f8", rows),
        ]
        return run(program, "step", given, np.dtype(answers))

    def answered(self, program: Path, features: Array) -> Array:
        """out for every row of features [N, F] float32."""
        return run(program, "answer", np.ascontiguousarray(features), self.out_type)


def run(program: Path, mode: str, given: Array, answers: np.dtype[Any]) -> Array:
    """A harness' answers to records, one for each."""
    done = subprocess.run(
        [str(program), mode], input=given.tobytes(), capture_output=True
    )
    assert done.returncode == 0, done.stderr.decode()[:3000]
    return np.frombuffer(done.stdout, answers)


def c_form(model: Path, folder: Path) -> CForm:
    """Export a model as C into a new folder."""
    export_c(model, folder)
    return CForm(model, folder, read_graph(model))
