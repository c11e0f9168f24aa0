"""`holdfast export --to c`: whole files or none, one clear error for each thing that is wrong."""

from __future__ import annotations

import ctypes
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from c_form import STRICT, require_compiler
from command_line import fails
from small_model import for_the_hand, graph_of, sealed_bytes

import holdfast
from holdfast.core.errors import NotCompilable, OutputError
from holdfast.core.schema import LIBRARY
from holdfast.core.writing import write_whole
from holdfast.export.c.graph import read_graph
from holdfast.export.c.source import c_source
from holdfast.export.exporting import model_card, seal

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "any-runtime.md"
BLOCK = re.compile(r"```(sh|c|text)\n(.*?)```", re.DOTALL)
SOURCES = ["holdfast.c", "holdfast.h", "holdfast_selftest.c", "model.json"]
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "small.onnx"
    path.write_bytes(sealed_bytes())
    return path


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    from holdfast.export.c.exporting import export_c

    require_compiler()
    folder = tmp_path_factory.mktemp("library")
    (folder / "small.onnx").write_bytes(sealed_bytes())
    done = export_c(folder / "small.onnx", folder / "c", build=True)
    assert done.selftest == ["golden: 102 rows, 0 labels differ"]
    return ctypes.CDLL(str(folder / "c" / LIBRARY))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_command_compiles_beside_the_model(run: Run, model: Path):
    require_compiler()
    code, out, _ = run("export", model, "--to", "c")
    assert code == 0
    assert names(model.parent / "small-c") == sorted([*SOURCES, LIBRARY])
    assert "0 labels differ" in out
    # equal bits need a processor that fuses products and sums
    assert "numbers may differ from Python's in the last bits" in out
    assert "fuses products and sums where the processor can (FMA)" in out


def test_without_a_compiler_the_line_it_prints_makes_the_library_elsewhere(
    run: Run, model: Path, monkeypatch: pytest.MonkeyPatch
):
    require_compiler()
    monkeypatch.setenv("CC", "no-such-compiler")
    code, out, _ = run("export", model, "--to", "c")
    assert code == 0
    folder = model.parent / "small-c"
    assert names(folder) == SOURCES
    line = next(line for line in out.splitlines() if "on another machine" in line)
    subprocess.run(line[line.index("cc -std") :].split(), cwd=folder, check=True)
    assert "compiled C" in holdfast.load(model).engine


def test_two_exports_of_a_file_are_the_same_to_the_last_byte(model: Path):
    assert c_source(read_graph(model))[0] == c_source(read_graph(model))[0]


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """For what asks for the sources alone."""
    monkeypatch.setenv("CC", "no-such-compiler")


@pytest.mark.usefixtures("no_compiler")
def test_an_earlier_export_is_replaced_only_with_force(run: Run, model: Path):
    run("export", model, "--to", "c")
    source = model.parent / "small-c" / "holdfast.c"
    source.write_text("mine")
    fails(run, 5, "OutputError", "export", model, "--to", "c", says="exists already")
    assert source.read_text() == "mine"
    assert run("export", model, "--to", "c", "--force")[0] == 0
    assert source.read_text() != "mine"


def test_a_place_that_takes_no_folder_is_an_error_of_one_line(run: Run, model: Path):
    export = ("export", model, "--to", "c", "--out")
    fails(run, 5, "OutputError", *export, model, says="cannot write")
    fails(run, 5, "OutputError", *export, model / "below", says="cannot write")
    assert names(model.parent) == ["small.onnx"]


@pytest.mark.usefixtures("no_compiler")
@pytest.mark.parametrize(
    "earlier", [None, "", "an earlier export"], ids=["none", "empty", "full"]
)
def test_a_disk_that_fills_up_leaves_what_was_there(
    run: Run, model: Path, monkeypatch: pytest.MonkeyPatch, earlier: str | None
):
    folder = model.parent / "c"
    if earlier is not None:
        folder.mkdir()
    for name in SOURCES if earlier else []:
        (folder / name).write_text(earlier or "")

    def fill_up(path: Path, content: str | bytes) -> Path:
        if path.name == "holdfast_selftest.c":
            raise OutputError("cannot write (No space left on device)", where=path)
        return write_whole(path, content)

    monkeypatch.setattr("holdfast.export.c.exporting.write_whole", fill_up)
    words = ("export", model, "--to", "c", "--out", folder, "--force")
    fails(run, 5, "OutputError", *words, says="No space left")
    assert folder.exists() == (earlier is not None)
    for path in folder.iterdir() if earlier is not None else []:
        assert path.read_text() == earlier


def test_what_has_no_c_form_is_refused_by_its_name(model: Path):
    graph = read_graph(model)
    altered = [
        replace(node, op_type="Erf") if node.op_type == "Softmax" else node
        for node in graph.nodes
    ]
    with pytest.raises(
        NotCompilable, match=r"operator Erf for p_class: it has no C form"
    ):
        c_source(replace(graph, nodes=tuple(altered)))


def script(folder: Path, body: str) -> str:
    path = folder / "strange-cc"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return str(path)


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ('echo "x.c:1: error: no" >&2; exit 1', "error: no"),
        (
            'case "$*" in *" selftest "*) cp /bin/false selftest;; esac',
            "answers differently",
        ),
    ],
    ids=["fails", "computes wrongly"],
)
def test_a_compiler_that_does_not_do_leaves_nothing_behind(
    run: Run, model: Path, monkeypatch: pytest.MonkeyPatch, body: str, says: str
):
    monkeypatch.setenv("CC", script(model.parent, body))
    fails(run, 5, "CompilerFailed", "export", model, "--to", "c", "--build", says=says)
    assert names(model.parent) == ["small.onnx", "strange-cc"]


def test_a_state_of_another_size_or_model_gives_a_code_and_no_answer(
    library: ctypes.CDLL,
):
    library.holdfast_message.restype = ctypes.c_char_p
    size = library.holdfast_state_bytes()
    state, out = (
        ctypes.create_string_buffer(size),
        ctypes.create_string_buffer(b"\xff" * 999, 999),
    )
    sample = (ctypes.c_float * 6)()
    assert library.holdfast_init_sized(state, ctypes.c_size_t(size - 8)) == -1
    assert b"another size" in library.holdfast_message(-1)
    assert library.holdfast_step(state, sample, out) == -2
    assert out.raw[:2] == b"\x00\x01", "settled is 0 and unknown is 1"
    assert library.holdfast_init_sized(state, ctypes.c_size_t(size)) == 0
    assert library.holdfast_step(state, sample, out) == 0


def test_a_float_sample_is_answered_as_the_same_numbers_in_double(library: ctypes.CDLL):
    size, out = (
        library.holdfast_state_bytes(),
        [ctypes.create_string_buffer(999) for _ in "ab"],
    )
    states = [ctypes.create_string_buffer(size) for _ in "ab"]
    for state in states:
        library.holdfast_init_sized(state, ctypes.c_size_t(size))
    for row in range(60):
        numbers = [(k * row % 7) / 8.0 for k in range(6)]
        library.holdfast_step(states[0], (ctypes.c_float * 6)(*numbers), out[0])
        library.holdfast_step_valid(
            states[1], (ctypes.c_double * 6)(*numbers), None, out[1]
        )
        assert out[0].raw == out[1].raw
    assert states[0].raw == states[1].raw


def compile_in(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [require_compiler(), *STRICT, *words],
        cwd=folder,
        capture_output=True,
        text=True,
    )


@pytest.mark.usefixtures("no_compiler")
@pytest.mark.skipif(shutil.which("nm") is None, reason="no nm")
def test_the_object_holds_no_memory_that_changes_and_needs_only_libm(
    run: Run, model: Path
):
    run("export", model, "--to", "c")
    folder = model.parent / "small-c"
    assert compile_in(folder, "-O2", "-c", "holdfast.c").returncode == 0
    listed = subprocess.run(
        ["nm", "holdfast.o"], cwd=folder, capture_output=True, text=True
    )
    symbols = [line.split()[-2:] for line in listed.stdout.splitlines()]
    assert not [name for kind, name in symbols if kind in "bBdDC"]
    needed = {name for kind, name in symbols if kind == "U"}
    assert needed <= {
        "memcpy",
        "memmove",
        "memset",
        "sqrt",
        "floorf",
        "__stack_chk_fail",
    }


def test_the_page_does_what_it_says_with_a_small_model_too(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    require_compiler()
    monkeypatch.chdir(tmp_path)
    made = for_the_hand()
    # as the shipped file, which answers with four of its six fingers
    spec = msgspec.structs.replace(made.spec, min_valid_sensors=4)
    made = replace(made, spec=spec)
    Path("models").mkdir()
    Path("models/holdfast-150hz.onnx").write_bytes(
        seal(graph_of(made), model_card(made), made.spec)
    )
    printed = ""
    for kind, text in BLOCK.findall(PAGE.read_text("utf-8")):
        if kind == "c":
            Path("hand.c").write_text(text)
        elif kind == "text":
            assert text == printed
        elif text.startswith("holdfast "):
            code, printed, _ = run(*shlex.split(text)[1:])
            assert code == 0
        else:
            done = subprocess.run(
                ["sh", "-e", "-c", text], capture_output=True, text=True
            )
            assert (done.returncode, done.stderr) == (0, "")
            printed = done.stdout
