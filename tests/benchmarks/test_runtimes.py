"""Every runtime of this machine answers one stream; the report of an emulated image is read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from c_form import require_compiler
from headless_browser import browser, needs_chromium, served
from page_tables import filled
from small_model import for_the_hand, graph_of

from benchmarks.runtimes import here as bench
from benchmarks.runtimes.arm import read_report
from benchmarks.runtimes.c_programs import CLANG, GCC, WASM, answers_of, golden_of
from benchmarks.runtimes.onnx_programs import C_API, IN_WEB, WEB, OnnxProgram, text_of
from benchmarks.runtimes.onnx_programs import answers_of as onnx_answers_of
from benchmarks.runtimes.programs import require
from benchmarks.runtimes.stream import Stream
from holdfast.core.errors import HoldfastError, LibraryMissing
from holdfast.edge_runtime.graph import run_recording
from holdfast.edge_runtime.model import Model
from holdfast.export.c.exporting import export_c
from holdfast.export.exporting import model_card, seal
from tools.doc_tables import tables_of

RELEASED = Path(__file__).resolve().parents[2] / "models/holdfast-150hz.onnx"
AT = "document.getElementById"
PRINTED = """golden: 252 rows, 1 labels differ
golden: 3 probabilities differ by more than 1e-6
steps 252 instructions 244127 most 246880 stack 24272 state 17144 out 100
"""


def short_stream(model: Model) -> Stream:
    rng = np.random.default_rng(5)
    values = 0.2 * rng.normal(size=(160, 18)) + np.tile([0.1, 0.2, 1.0], 6)
    valid = np.ones((160, 6), dtype=np.bool_)
    valid[130:133, 2] = False
    out = run_recording(model.session, values, valid, ["situation", "unknown"])
    return Stream(
        values, valid, np.where(out["unknown"], -1, out["situation"]).astype(np.int64)
    )


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_compiler()
    made = for_the_hand()
    path = tmp_path_factory.mktemp("runtimes") / "small.onnx"
    path.write_bytes(seal(graph_of(made), model_card(made), made.spec))
    return path


def test_every_runtime_gives_the_labels_of_onnxruntime_and_gcc_and_clang_the_same_bits(
    model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "stream_of", short_stream)
    monkeypatch.setattr(bench, "ROUNDS", 1)
    monkeypatch.setattr(
        bench.onnx_programs, "PROGRAMS", ()
    )  # cargo fetches and compiles for long
    figures = bench.measure(model)
    rows = {row["runtime"]: row for row in figures["runtimes"]}
    doubles = [row for name, row in rows.items() if "single" not in name]
    assert [row["labels_differ"] for row in doubles] == [0] * len(doubles)
    assert {row["same_bits"] for row in doubles} == {True, None}
    assert {one.name for one in (CLANG, WASM) if one.is_installed} <= set(rows)
    assert rows["C, gcc, single precision"]["same_bits"] is False
    assert rows["onnxruntime, from Python"]["beside_python"] == 1.0
    made = tables_of("docs/any-runtime.md", {"here": figures})
    assert "| C, gcc |" in made["runtimes"]


@pytest.mark.parametrize("one", [C_API, WEB], ids=lambda one: one.name)
def test_an_example_answers_as_onnxruntime_from_python_without_telemetry(
    one: OnnxProgram, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not one.is_installed():
        pytest.skip(f"{one.name}: not installed, see docs/any-runtime.md")
    stream, words = short_stream(Model(RELEASED)), one.build(tmp_path)
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("ORT_DISABLE_TELEMETRY")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    given = onnx_answers_of(words, RELEASED, stream)
    assert given.labels.tolist() == stream.labels.tolist()
    assert len(set(given.labels)) > 2
    assert given.step_us > 1.0
    assert list((tmp_path / "home").rglob("*onnxruntime*")) == []


@needs_chromium
def test_the_onnx_file_answers_in_a_worker_of_a_browser_as_in_python(
    tmp_path: Path,
) -> None:
    if not WEB.is_installed():
        pytest.skip(f"{WEB.name}: not installed, see docs/any-runtime.md")
    stream = short_stream(Model(RELEASED))
    samples = tmp_path / "samples.txt"
    samples.write_text(text_of(stream))
    with served(IN_WEB) as address, browser(tmp_path / "profile") as shown:
        shown.open(address, 800, 600)
        shown.wait_until(f"{AT}('samples') && document.readyState === 'complete'")
        shown.choose("#model", RELEASED)
        shown.wait_until(
            f"{AT}('said').textContent.startsWith('The model was opened in ')"
        )
        shown.choose("#samples", samples)
        shown.wait_until(f"{AT}('phases').childElementCount")
        lines = shown.value(
            f"[...{AT}('phases').children].map((one) => one.textContent)"
        )
        assert shown.problems == []
    names = ["unknown", "nothing", "grasp", "safe slip", "risky slip"]
    labels: list[int] = []
    for first, last, name in re.findall(r"(\d+) to (\d+): (.*)", "\n".join(lines)):
        labels += [names.index(name) - 1] * (1 + int(last) - int(first))
    assert labels == stream.labels.tolist()


def test_a_label_that_differs_is_counted(model: Path, tmp_path: Path) -> None:
    stream = short_stream(Model(model))
    export_c(model, tmp_path / "c")
    altered = tmp_path / "c/holdfast.c"
    source = altered.read_text().replace("x[k] >= x[y[0]]", "x[k] < x[y[0]]")
    altered.write_text(source)
    given = answers_of(GCC, tmp_path / "c", stream, tmp_path, passes=1)
    assert bench.row("altered", [given], stream, given)["labels_differ"] > 40
    with pytest.raises(HoldfastError, match="labels differ"):
        golden_of(GCC, tmp_path / "c", tmp_path)


def test_the_report_of_an_image_is_read_and_one_without_it_is_an_error() -> None:
    read = read_report(PRINTED, "double", 1000)
    assert (read.rows, read.labels_differ, read.flash_bytes) == (252, 1, 1000)
    assert read.ram_bytes == 24272 + 17144 + 100
    assert read.projected_us == pytest.approx(246880 / 480)
    with pytest.raises(HoldfastError, match="without its report"):
        read_report("qemu: fatal: Lockup", "double", 1000)


def test_a_program_that_is_missing_is_named_with_its_package(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(LibraryMissing, match="gcc-arm-none-eabi libnewlib"):
        require("arm-none-eabi-gcc")


def test_the_page_has_a_place_for_every_table(tmp_path: Path) -> None:
    row = {"runtime": "C", "step_us": 1.0, "beside_python": 0.1, "labels_differ": 0}
    board: dict[str, Any] = {
        "precision": "double",
        "rows": 252,
        "labels_differ": 0,
        "stream_labels_differ": 1,
        "flash_bytes": 1_274_000,
        "ram_bytes": 41_500,
        "stack_bytes": 24_272,
        "instructions": 244_127,
        "most_instructions": 246_880,
        "projected_us": 514.3,
    }
    one = {
        "model": "m",
        "rows": 9,
        "aarch64_golden": "golden",
        "aarch64_labels_differ": 0,
        "aarch64_same_bits": True,
        "boards": [board],
    }
    made = {"here": {"runtimes": [row | {"same_bits": None}]}, "arm": {"models": [one]}}
    page = filled("docs/any-runtime.md", made, tmp_path)
    assert "| m | double | 1274.0 | 41.5 | 24.3 | 244,127 | 246,880 | 514 |" in page
