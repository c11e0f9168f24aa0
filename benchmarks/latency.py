"""One decision and its parts, timed interleaved on one simulated stream; every answer is checked.

Beside the calls of `holdfast bench latency`:

    bare forest             100 full-depth trees on the raw window in onnxruntime, io-bound
    ours, learner alone     our own trees and networks alone, on the rows that the step gives them
    ours, whole step in C   the same file as compiled C, called from Python (where there is a
                            compiler)
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from itertools import cycle
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort

from benchmarks.timed_calls import simulated_set, stream_of
from holdfast.core.contract import Json
from holdfast.core.errors import CompilerFailed
from holdfast.edge_runtime.c_engine import LIBRARY, CompiledModel
from holdfast.edge_runtime.graph import open_session, run_recording
from holdfast.edge_runtime.model import ANSWERS
from holdfast.edge_runtime.monitor import Model
from holdfast.export.c.exporting import export_c
from holdfast.export.exporting import export_artifact
from holdfast.export.verify import cut_learners
from holdfast.live.bench import (
    FLOOR,
    GRIP,
    STEP,
    TURNS,
    Calls,
    CallTimes,
    Stream,
    board_ratios,
    budget_figures,
    budgets,
    grip_of,
    memory,
    step_of,
    timed,
    with_floor,
)
from holdfast.training.featurise import FloatRows
from holdfast.training.fitting import train
from holdfast.training.plan import RAW_BASELINE
from holdfast.training.recording import DataSet

C_STEP = "ours, whole step in C"
OWN = "ours, learner alone"
BARE = "bare forest, 100 full-depth trees"
C_FLOOR = "floor of the step in C"
"""Names of the calls, as latency.json has them."""


def figures_of(path: Path, turns: int = TURNS) -> Json:
    """What latency.json holds of a model file: calls, memory, budgets, and what breaks one."""
    model = Model(path)
    with tempfile.TemporaryDirectory() as work:
        data = simulated_set(Path(work), model.card.rate_hz)
        rows = timed(_calls(model, data, Path(work)), turns)
    libraries, live = processes = memory(path)
    found = {
        **board_ratios(rows, model.card.rate_hz),
        **part_ratios(rows),
        "model_mib": path.stat().st_size / 2**20,
        "over_libraries_mb": live.resident_mb - libraries.resident_mb,
    }
    return {
        "model": model.card.model_id,
        "rows": [row.to_json() for row in rows],
        "memory": [asdict(row) for row in processes],
        **budget_figures([*budgets("parts", found), *budgets("at_most", found)]),
    }


def _calls(model: Model, data: DataSet, work: Path) -> Calls:
    """All calls get the samples of one stream, so none has easier rows than another."""
    stream = stream_of(data)
    step = step_of(model, stream)
    bare = _bare(data, work)
    calls: Calls = {
        STEP: step,
        GRIP: grip_of(model, stream),
        OWN: learner_of(model, stream),
        BARE: learner_of(bare, stream),
        **with_floor(step, FLOOR),
    }
    # Without a compiler there is no such call, and no floor for it either.
    for call in c_step_of(model, stream, work).values():
        calls |= {C_STEP: call, **with_floor(call, C_FLOOR)}
    return calls


def part_ratios(rows: Sequence[CallTimes]) -> dict[str, float]:
    """Ratios of one run, by the name of their budget; those of the C form where there is one."""
    of = {one.what: one for one in rows}
    step = of[STEP]
    # Medians for speed: their ratio changes little from run to run.
    found = {
        "step_over_bare_full_depth_forest": step.p50_us / of[BARE].p50_us,
        "step_over_own_learner": step.p50_us / of[OWN].p50_us,
    }
    # Compared with the step in Python on the same stream, never across machines.
    if C_STEP in of:
        c_step = of[C_STEP]
        found["c_step_over_step"] = c_step.p50_us / step.p50_us
        found["c_p999_over_floor_p999"] = c_step.p999_us / of[C_FLOOR].p999_us
        found["c_cold_over_step_cold"] = c_step.cold_p50_us / step.cold_p50_us
    return found


def _bare(data: DataSet, work: Path) -> Model:
    """The raw-window forest of 100 full-depth trees, as a model file."""
    # Two folds, the fewest: only the trees are needed, and no score of them.
    plan = replace(RAW_BASELINE, folds=2)
    train(data, work / "raw", plan)
    path, _ = export_artifact(work / "raw")
    return Model(path)


def c_step_of(
    model: Model, stream: Stream, work: Path
) -> dict[str, Callable[[], object]]:
    """Step over a stream in the compiled library, by its name; empty without a compiler.

    Raises AssertionError where a label differs from onnxruntime's.
    """
    try:
        export_c(model.path, work / "c", build=True)
    # A machine without a compiler measures everything else.
    except CompilerFailed:
        return {}

    steps = CompiledModel(model.path, work / "c" / LIBRARY).stepper(ANSWERS)
    values, valid = stream
    turn = cycle(range(len(values)))

    def step() -> None:
        index = next(turn)
        steps.sample[0] = values[index]
        steps.valid[0] = valid[index]
        steps.step()

    # One whole turn is checked before anything is timed; the turn ends where it began.
    expected = run_recording(model.session, values, valid, ["situation"])["situation"]
    for label in expected:
        step()
        if not np.array_equal(steps.out["situation"][0], label):
            raise AssertionError("the C form does not label as onnxruntime does")

    return {C_STEP: step}


def learner_of(model: Model, stream: Stream) -> Callable[[], object]:
    """A file's learners alone, on the very rows that its whole step hands them, in turn."""
    rows: FloatRows = run_recording(model.session, *stream, ["features"])["features"]
    session: ort.InferenceSession = open_session(cut_learners(onnx.load(model.path)))
    # Bound once: a call then copies one row, and allocates nothing in Python.
    row = rows[:1].copy()
    turn = cycle(range(len(rows)))
    binding = session.io_binding()
    binding.bind_input("features", "cpu", 0, np.float32, row.shape, row.ctypes.data)
    for output in session.get_outputs():
        binding.bind_output(output.name, "cpu")

    def call() -> None:
        row[0] = rows[next(turn)]
        session.run_with_iobinding(binding)

    return call
