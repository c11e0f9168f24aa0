"""`holdfast run --engine c`: the compiled library answers as onnxruntime does, line by line."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from c_form import require_compiler
from command_line import fails
from loop_bench import card_text, row
from made_once import made_once
from small_model import for_the_hand, graph_of, sealed_bytes

import holdfast
from holdfast.core.contract import Prediction
from holdfast.core.errors import GoldenMismatch, ModelError
from holdfast.core.schema import LIBRARY
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.c_engine import CompiledModel
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.model import Model
from holdfast.export.c.exporting import export_c
from holdfast.export.exporting import model_card, seal
from holdfast.live.run import answer
from holdfast.live.sources import open_live

ROOT = Path(__file__).resolve().parents[2]
FAULT = "nack:3@1%2B0.2"
TIMES = ("t_acquired_ns", "t_decided_ns", "latency_us")
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A committee for the virtual hand, with its library in the place that the engine looks in."""

    require_compiler()

    def write(folder: Path) -> None:
        made = for_the_hand()
        (folder / "small.onnx").write_bytes(
            seal(graph_of(made), model_card(made), made.spec)
        )
        export_c(folder / "small.onnx", folder / "small-c", build=True)

    return made_once(tmp_path_factory, "engine", write) / "small.onnx"


def lines(model: OpenedModel, scene: Path, seconds: float) -> list[dict[str, Any]]:
    """What a run on virtual time answers, without its times."""
    clock, given = VirtualClock(), list[Prediction]()
    url = f"virtual://ft232h?scene={scene}&seed=1&fault={FAULT}"
    source = open_live(url, clock=clock, report=lambda line: None)
    end_ns = clock.now_ns() + round(1e9 * seconds)

    def emit(prediction: Prediction, *more: object) -> int:
        given.append(prediction)
        return 0

    answer(source, model, clock, emit, lambda: clock.now_ns() >= end_ns)
    answers = [dataclasses.asdict(one) for one in given]
    return [{k: v for k, v in one.items() if k not in TIMES} for one in answers]


def near(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(
            near(one[key], other[key]) for key in one
        )
    return one == other or (isinstance(one, float) and abs(one - other) <= 2e-6)


def test_both_engines_give_the_same_lines_on_a_virtual_hand_that_loses_a_finger(
    model, tmp_path
):
    scene = tmp_path / "pull.toml"
    scene.write_text(
        card_text(row("pull"), effects="[effects.dipole]\n"), encoding="utf-8"
    )
    compiled, reference = (
        lines(one(model), scene, 1.8) for one in (CompiledModel, Model)
    )
    assert len(compiled) == len(reference) > 200
    assert all(near(one, other) for one, other in zip(compiled, reference, strict=True))
    assert {line["why"] for line in reference} >= {"", "settling", "sensors"}
    assert len({line["state"] for line in reference}) > 2


def run_of(model: Path, *words: str) -> tuple[str, str]:
    """stdout (exit code, whether onnxruntime was loaded) and stderr of a short run."""
    program = f"""
import sys
from holdfast.cli.main import main
words = ["run", {str(model)!r}, "--source", "virtual://ft232h", "--seconds", "0.2", "--to", "none"]
code = main([*words, *sys.argv[1:]])
print(code, "onnxruntime" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    return done.stdout, done.stderr


def test_a_run_takes_the_c_form_beside_its_model_unless_it_is_declined(model):
    stdout, stderr = run_of(model)
    assert stdout == "0 False\n", stderr
    assert "the step is compiled C" in stderr
    stdout, stderr = run_of(model, "--engine", "onnxruntime")
    assert stdout == "0 True\n", stderr
    assert "compiled C" not in stderr


@pytest.mark.skipif(os.getuid() != 0, reason="only root gives files away")
def test_a_library_of_another_user_is_taken_only_by_its_name(model, tmp_path):
    mine = tmp_path / model.name
    shutil.copy(model, mine)
    shutil.copytree(model.parent / "small-c", tmp_path / "small-c")
    assert "compiled C" in holdfast.load(mine).engine
    os.chown(tmp_path / "small-c" / LIBRARY, 4242, -1)
    assert "belongs to another user" in holdfast.load(mine).engine
    assert "compiled C" in holdfast.load(mine, engine="c").engine


@pytest.fixture
def copied(model: Path, tmp_path: Path) -> Path:
    """The model with its library, in a folder of its own."""
    shutil.copytree(model.parent / "small-c", tmp_path / "small-c")
    return Path(shutil.copy(model, tmp_path / model.name))


BROKEN = {
    "nothing": "{}",
    "a list": "[]",
    "null": "null",
    "text": '"digest"',
    "brackets": "[" * 100_000,
    "a number for a digest": '{"digest": 1}',
    "no outputs": '{"digest": "DIGEST"}',
    "numbers for tables": '{"digest": "DIGEST", "golden": 1, "outputs": 1, "card": 1}',
    "other tables": '{"digest": "DIGEST", "golden": {"a": 1}, "outputs": [1], "card": []}',
    "other types": '{"digest": "DIGEST", "golden": {}, "card": {}, "outputs": '
    '[{"name": "a", "dtype": "zz", "shape": 1}]}',
    "not UTF-8": "\udcff",
}
"""What stands in model.json."""


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_card_of_a_library_is_told_and_onnxruntime_answers(copied, what):
    about = copied.parent / "small-c" / "model.json"
    digest = json.loads(about.read_bytes())["digest"]
    text = BROKEN[what].replace("DIGEST", digest)
    about.write_bytes(text.encode("utf-8", "surrogateescape"))
    opened = holdfast.load(copied)
    assert "until then onnxruntime computes the step" in opened.engine
    with pytest.raises(ModelError):
        CompiledModel(copied)


def test_a_library_in_the_working_folder_is_not_loaded_by_itself(
    copied, tmp_path, monkeypatch
):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    alone = shutil.copy(copied, elsewhere / copied.name)
    monkeypatch.chdir(tmp_path)
    assert (tmp_path / "small-c" / LIBRARY).is_file()
    assert holdfast.load(alone).engine == ""
    assert "compiled C" in holdfast.load(copied.name).engine


def test_a_library_that_does_not_fit_is_one_clear_error(
    run: Run, model: Path, tmp_path: Path
):
    alone = tmp_path / "alone.onnx"
    alone.write_bytes(sealed_bytes())
    words = ("run", alone, "--source", "virtual://ft232h", "--engine", "c")
    fails(run, 4, "LibraryRefused", *words, says="no compiled library")
    torn = tmp_path / LIBRARY
    torn.write_bytes(b"no library")
    for library, says in (
        (torn, "is no library of a model"),
        (model.parent / "small-c" / LIBRARY, "is of model"),
    ):
        settings = tmp_path / "holdfast.toml"
        settings.write_text(f'library = "{library}"\n', encoding="utf-8")
        fails(run, 4, "LibraryRefused", *words, "--config", settings, says=says)


def test_a_library_that_answers_otherwise_is_refused(model: Path, tmp_path: Path):
    """The golden sequence is replayed at every load, as onnxruntime does."""
    folder = tmp_path / "altered"
    export_c(model, folder)
    source = (folder / "holdfast.c").read_text()
    (folder / "holdfast.c").write_text(
        source.replace("x[k] >= x[y[0]]", "x[k] < x[y[0]]")
    )
    words = ["gcc", "-std=c99", "-shared", "-fPIC", "-o", LIBRARY, "holdfast.c", "-lm"]
    subprocess.run(words, cwd=folder, check=True)
    with pytest.raises(GoldenMismatch, match="differs from the golden sequence"):
        CompiledModel(model, folder / LIBRARY)


def test_many_hands_are_each_answered_as_if_alone(model: Path):
    compiled, rng = CompiledModel(model), np.random.default_rng(3)
    names = ("p_situation", "situation", "unknown", "settled")
    many, alone = (
        compiled.stepper(names, 3),
        [compiled.stepper(names) for _ in range(3)],
    )
    for values in rng.normal(size=(120, *many.sample.shape)):
        many.sample[:] = values
        for one, own in zip(alone, values, strict=True):
            one.sample[:] = own
        together, each = many.step(), [one.step() for one in alone]
        for name in names:
            assert together[name].tobytes() == b"".join(
                one[name].tobytes() for one in each
            )
    assert len(np.unique(together["p_situation"], axis=0)) == 3
    assert together["settled"].all()
    many.reset()
    assert not many.step()["settled"].any()
