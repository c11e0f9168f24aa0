"""The C form of a model: the same labels, votes and flags as the ONNX file, from any compiler."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import onnx
import pytest
from adapted_model import base_of, file_of
from c_form import SANITISED, CForm, c_form, require_compiler, run
from c_rows import hard_features, hard_streams
from made_once import made_once
from small_model import artifact, graph_of, spec, with_networks

from holdfast.edge_runtime.graph import StepGraph, open_session
from holdfast.edge_runtime.model_file import read_sealed
from holdfast.export.c.graph import read_graph
from holdfast.export.exporting import model_card, seal
from holdfast.export.structure import hard_rows
from holdfast.export.verify import cut_learners
from holdfast.step.features import GROUPS
from holdfast.step.pooled import FAMILIES
from holdfast.step.spec import StepSpec

if TYPE_CHECKING:
    from conftest import Built

RELEASED = Path(__file__).resolve().parents[2] / "models" / "holdfast-150hz.onnx"
SMALL = ("four situations", "committee", "adapted committee")
MODELS = (*SMALL, pytest.param("released", marks=pytest.mark.soak))
"""The released file's C form is built and tested by .ci/run."""
KINDS = [
    *((name, "gcc") for name in SMALL),
    ("committee", "clang"),
    ("adapted committee", "clang"),
]
"""Models and compilers: what clang may see otherwise is in the larger ones."""
Make = Callable[[str], CForm]
Answers = dict[str, npt.NDArray[Any]]


def everything() -> Any:
    """An artifact of all operators: every feature group, trees, networks, weights, two heads."""
    return with_networks(artifact(spec(tuple(GROUPS), n_sensors=3, rate_hz=150.0)))


@pytest.fixture(scope="session")
def form(tmp_path_factory: pytest.TempPathFactory, four_situations: Built) -> Make:
    """The C form of one of MODELS, made once a run."""

    def data(name: str) -> bytes:
        if name == "committee":
            made = everything()
            return seal(graph_of(made), model_card(made), made.spec)
        if name == "adapted committee":
            return file_of(base_of(committee=True))
        return read_sealed(
            four_situations.model if name == "four situations" else RELEASED
        )

    def make(name: str) -> CForm:
        def write(folder: Path) -> None:
            (folder / "model.onnx").write_bytes(data(name))
            c_form(folder / "model.onnx", folder / "c")

        folder = made_once(tmp_path_factory, f"c-{name.replace(' ', '-')}", write)
        return CForm(
            folder / "model.onnx", folder / "c", read_graph(folder / "model.onnx")
        )

    return make


def sanitised(made: CForm, compiler: str = "gcc") -> Path:
    return made.program(compiler, *SANITISED)


def quick(made: CForm) -> Path:
    return made.program("gcc", "-O2")


def of_onnx(made: CForm, values: npt.NDArray[Any], valid: npt.NDArray[Any]) -> Answers:
    """Every output of the ONNX file at every sample of streams [N, T, C]."""
    steps = StepGraph(open_session(made.model.read_bytes()), len(values))
    kept: dict[str, list[npt.NDArray[Any]]] = {
        name: [] for name in (*steps.out, "state")
    }
    for t in range(values.shape[1]):
        np.copyto(steps.sample, values[:, t])
        np.copyto(steps.valid, valid[:, t])
        for name, answer in {**steps.step(), "state": steps.state}.items():
            kept[name].append(answer.copy())
    return {name: np.concatenate(np.stack(rows, axis=1)) for name, rows in kept.items()}


def of_c(
    made: CForm, program: Path, values: npt.NDArray[Any], valid: npt.NDArray[Any]
) -> Any:
    """The same of a program of the C form."""
    streams, samples, channels = values.shape
    fresh = np.tile(np.arange(samples) == 0, streams)
    return made.stepped(
        program, values.reshape(-1, channels), np.concatenate(valid), fresh
    )


def is_label(name: str, answers: npt.NDArray[Any]) -> bool:
    return answers.dtype != np.float32 or "votes" in name


def require_same(made: CForm, answers: Answers, out: Any) -> None:
    """No label, vote or flag differs, and floats are within the golden sequence's tolerance."""
    names = [name for name in made.graph.outputs if name in answers]
    differ = {
        name: int((out[name] != answers[name]).sum())
        for name in names
        if is_label(name, answers[name])
    }
    assert not any(differ.values()), differ
    for name in set(names) - set(differ):
        assert np.allclose(out[name], answers[name], rtol=1e-6, atol=1e-6), name


def test_a_compiler_without_the_runtime_of_its_sanitizers_skips_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    compiler = tmp_path / "cc-alone"
    compiler.write_text(
        '#!/bin/sh\ncase "$*" in *-fsanitize=*) exit 1;; esac\nexec gcc "$@"\n'
    )
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    assert require_compiler("cc-alone", "-O0") == "cc-alone"
    with pytest.raises(pytest.skip.Exception, match="cc-alone lacks the runtime of"):
        require_compiler("cc-alone", "-O0", "-fsanitize=address")


@pytest.mark.parametrize(("name", "compiler"), KINDS)
def test_the_golden_sequence_is_replayed_without_a_difference(form, name, compiler):
    made = form(name)
    program = made.program(compiler, *SANITISED, main="holdfast_selftest.c")
    done = subprocess.run([str(program)], capture_output=True, text=True)
    rows = len(made.graph.golden["settled"])
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"golden: {rows} rows, 0 labels differ\n"


def test_rules_at_the_ends_of_their_type_overflow_nothing(form):
    program = form(MODELS[0]).program("gcc", *SANITISED)
    ends = (-(2**31), -1, 0, 1, 2**31 - 1)
    rows = [
        [end] * 6 + [fresh, situation, 1000, period_us, wish]
        for end, period_us, wish in product(ends, ends, (0, 1, 2))
        for fresh, situation in ((1, 3), (0, 0), (0, 3), (0, -1))
    ]
    # a decision is four int32 and three bytes; the sanitizer ends the program at an overflow
    found = run(program, "decide", np.array(rows, dtype="i4"), np.dtype("V20"))
    assert len(found) == len(rows)


def exact_features(made: CForm) -> int:
    """How many features come before the pooled ones, which are the last of all groups."""
    spec = StepSpec.from_json(made.graph.card.raw["spec"])
    return sum(GROUPS[name].count(spec) for name in spec.groups if name not in FAMILIES)


@pytest.mark.parametrize("streams", [8, pytest.param(200, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", MODELS)
def test_hard_streams_are_answered_as_the_onnx_file_answers(form, name, streams):
    """NaN, infinite, lost and impossible samples, ties of the friction cone, numbers on a grid."""
    made = form(name)
    values, valid = hard_streams(made.graph.card, streams, seed=streams)
    answers = of_onnx(made, values, valid)
    got = of_c(made, quick(made), values, valid)
    require_same(made, answers, got["out"])
    # means of pooled features are sums of inexact products: these bits need fused ones
    exact = exact_features(made)
    features = got["features"][:, :exact], answers["features"][:, :exact]
    assert np.array_equal(*features)
    pooled = got["features"][:, exact:], answers["features"][:, exact:]
    assert np.allclose(*pooled, rtol=1e-6, atol=1e-9)
    largest = np.abs(answers["state"]).max()
    assert np.abs(got["state"] - answers["state"]).max() < 1e-12 * largest
    assert 0.05 < answers["unknown"].mean() < 0.95


@pytest.mark.parametrize(("name", "compiler"), KINDS)
def test_hard_streams_break_no_rule_of_c(form, name, compiler):
    """With the address and the undefined-behaviour sanitiser; the answers have the same bits."""
    made = form(name)
    values, valid = hard_streams(made.graph.card, 4, seed=1)
    got = of_c(made, sanitised(made, compiler), values, valid)
    assert got.tobytes() == of_c(made, quick(made), values, valid).tobytes()


def hard_answers(made: CForm, n: int) -> npt.NDArray[np.float32]:
    """Rows of features on every edge of trees and networks."""
    rows = hard_features(made.graph, n, seed=n)
    if made.graph.n_features == everything_features(made):
        finite = np.where(np.isfinite(rows), rows, np.float32(0.0))
        learners = [head.learner for head in everything().heads]
        hard = [hard_rows(one, finite, seed=3) for one in learners]
        return np.concatenate([rows, *(one[:: 100_000 // n] for one in hard)])
    return rows


def everything_features(made: CForm) -> int:
    from holdfast.step.features import feature_count

    return feature_count(everything().spec)


@pytest.mark.parametrize("n", [5_000, pytest.param(100_000, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", MODELS)
def test_rows_on_every_threshold_get_the_same_votes_and_labels(form, name, n):
    made = form(name)
    rows = hard_answers(made, n)
    session = open_session(cut_learners(onnx.load(made.model)))
    names = [one.name for one in session.get_outputs()]
    answers = dict(zip(names, session.run(names, {"features": rows}), strict=True))
    require_same(made, answers, made.answered(quick(made), rows))


@pytest.mark.parametrize("name", SMALL)
def test_rows_on_every_threshold_break_no_rule_of_c(form, name):
    made = form(name)
    rows = hard_features(made.graph, 2_000, seed=7)
    got = made.answered(sanitised(made), rows)
    assert got.tobytes() == made.answered(quick(made), rows).tobytes()


def has_fused_products() -> bool:
    cpu = Path("/proc/cpuinfo")
    return cpu.is_file() and " fma " in cpu.read_text("ascii", errors="replace")


@pytest.mark.skipif(
    not has_fused_products(), reason="no fused multiply-add on this processor"
)
@pytest.mark.parametrize(
    "name", ["committee", pytest.param("released", marks=pytest.mark.soak)]
)
def test_with_fused_products_every_number_has_the_bits_of_onnxruntime(form, name):
    """So the sums are in onnxruntime's order, and only the rounding of products differs."""
    made = form(name)
    fused = made.program("gcc", "-O2", "-mfma", "-DHOLDFAST_FUSED")
    values, valid = hard_streams(made.graph.card, 3, seed=2)
    answers, got = of_onnx(made, values, valid), of_c(made, fused, values, valid)
    assert np.array_equal(got["features"], answers["features"])
    assert np.array_equal(got["state"], answers["state"])
