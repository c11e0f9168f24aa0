"""`holdfast bench latency`: one decision on this machine, timed interleaved on one stream.

Absolute microseconds belong to one machine; ratios carry over to others. Percentiles are of all
calls but the first of each turn. That one comes to cold caches and has a median of its own. The
floors are busy waits as long as the step, and as the step in C: their tails are the machine's own
jitter. Every answer is checked while it is timed.

    bare forest             100 full-depth trees on the raw window in onnxruntime, io-bound
    ours, learner alone     our own trees and networks alone, on the rows that the step gives them
    ours, whole step        guard, bank, detectors, features, learner, votes: what runs on the hand
    ours, whole step in C   the same file as compiled C, called from Python (where there is a
                            compiler)
    ours, grip command      friction margin, controller and supervisor, from the step's answer on
"""

from __future__ import annotations

import tempfile
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort

from holdfast import edge_runtime
from holdfast.core.contract import BoolArray, FloatArray, Json
from holdfast.edge_runtime.graph import open_session, run_recording
from holdfast.edge_runtime.monitor import Model
from holdfast.evaluation.latency.calls import (
    BARE,
    C_FLOOR,
    C_STEP,
    FLOOR,
    GRIP,
    OWN,
    STEP,
    c_step_of,
    grip_of,
    learner_of,
    step_of,
)
from holdfast.evaluation.latency.memory import memory
from holdfast.evaluation.latency.timing import TURNS, busy_wait, time_in_turns
from holdfast.export.exporting import export_artifact
from holdfast.export.verify import cut_learners
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import load
from holdfast.training.featurise import FloatRows
from holdfast.training.fitting import train
from holdfast.training.plan import RAW_BASELINE
from holdfast.training.recording import DataSet

BUDGET = Path(edge_runtime.__file__).with_name("budget.toml")
PERCENTILES = (50, 99, 99.9)
TRIALS = 400
"""Simulated, to train the forest of the thesis on."""
STREAMED = 10
"""So many of them make the stream that is timed."""
C_RATIOS = ("c_step_over_step", "c_p999_over_floor_p999", "c_cold_over_step_cold")
"""Budgets that only a machine with a compiler can measure."""
KIND = "time on this machine, samples simulated"
"""Stands next to every figure."""


@dataclass(frozen=True)
class CallTimes:
    """Time of n calls, us: percentiles of the warm ones, and the median of each turn's first."""

    what: str
    n: int
    p50_us: float
    p99_us: float
    p999_us: float
    cold_p50_us: float

    def to_json(self) -> Json:
        """As it stands in latency.json."""
        return {
            "what": self.what,
            "n": self.n,
            "p50": self.p50_us,
            "p99": self.p99_us,
            "p99.9": self.p999_us,
            "cold_p50": self.cold_p50_us,
        }


@dataclass(frozen=True)
class LatencyFigures:
    """All calls. ratios: by the name of their budget. bytes: of the model file."""

    model: str
    rows: list[CallTimes]
    ratios: dict[str, float]
    bytes: int

    def to_json(self) -> Json:
        """As it stands in latency.json."""
        return {**vars(self), "rows": [row.to_json() for row in self.rows]}


def figures_of(path: Path) -> Json:
    """What latency.json holds of a model file: calls, memory, budgets, and what breaks one."""
    figures = latency(path)
    libraries, live = processes = memory(path)
    # Limits are on ratios, sizes and differences, which do not depend on this machine: how many
    # pages of libraries are mapped does.
    over_libraries_mb = live.resident_mb - libraries.resident_mb
    limited = budgets(figures.ratios, figures.bytes, over_libraries_mb)
    return figures.to_json() | {
        "memory": [asdict(row) for row in processes],
        "budgets": [one.to_json() for one in limited],
        "broken": [one.line for one in limited if one.is_broken],
    }


def latency(path: Path, turns: int = TURNS) -> LatencyFigures:
    """Time everything on one stream; the figures, and the ratios that budget.toml limits.

    turns: how often each takes its turn.
    """
    model = Model(path)
    with tempfile.TemporaryDirectory() as work:
        data = simulated_set(Path(work), model.card.rate_hz)
        stream = stream_of(data)
        # All calls get the samples of one stream, so none has easier rows than another.
        step = step_of(model, stream)
        step_in_c = c_step_of(model, stream, Path(work))

        bare = _bare(data, Path(work))
        rows = learner_rows(bare, stream)
        own = learner_of(learner_alone(path), learner_rows(model, stream))

        # Calls of microseconds take turns with each other, so that a busy moment hits all alike.
        quick = {
            STEP: step,
            GRIP: grip_of(model, stream),
            OWN: own,
            BARE: learner_of(learner_alone(bare.path), rows),
            **_floor(STEP, step, FLOOR),
        }
        # Without a compiler there is no such call, and no floor for it either.
        for call in step_in_c.values():
            quick |= step_in_c | _floor(C_STEP, call, C_FLOOR)

        times = _by_turn(time_in_turns(quick, turns), turns)

    calls = [_call_times(name, each) for name, each in times.items()]
    return LatencyFigures(
        model.card.model_id, calls, ratios(calls), path.stat().st_size
    )


def _floor(
    name: str, call: Callable[[], object], floor: str
) -> dict[str, Callable[[], object]]:
    """A busy wait as long as a call, by the floor's name."""
    # The median: a floor as long as a usual call, not as a disturbed one.
    times_us = time_in_turns({name: call}, turns=5)[name]
    return {floor: busy_wait(float(np.median(times_us)))}


def _by_turn(times: dict[str, FloatArray], turns: int) -> dict[str, FloatArray]:
    """[turns, calls]: the first call of a turn has cold caches, as a live loop after 7 ms."""
    return {name: values.reshape(turns, -1) for name, values in times.items()}


def _call_times(what: str, times_us: FloatArray) -> CallTimes:
    """times_us: [turns, calls]."""
    # The first call of a turn comes to cold caches and is a figure of its own.
    cold = times_us[:, 0]
    warm = times_us[:, 1:]
    p50, p99, p999 = np.percentile(warm, PERCENTILES).tolist()
    cold_p50 = float(np.median(cold))
    return CallTimes(what, times_us.size, p50, p99, p999, cold_p50)


def ratios(calls: Sequence[CallTimes]) -> dict[str, float]:
    """What the budgets limit: each a ratio of two figures of one run."""
    of = {one.what: one for one in calls}
    step = of[STEP]

    in_c: dict[str, float] = {}
    # Compared with the step in Python on the same stream, never across machines.
    if C_STEP in of:
        c_step = of[C_STEP]
        in_c = {
            "c_step_over_step": c_step.p50_us / step.p50_us,
            "c_p999_over_floor_p999": c_step.p999_us / of[C_FLOOR].p999_us,
            "c_cold_over_step_cold": c_step.cold_p50_us / step.cold_p50_us,
        }

    return in_c | {
        # Medians for speed: their ratio changes little from run to run.
        "step_over_bare_full_depth_forest": step.p50_us / of[BARE].p50_us,
        "step_over_own_learner": step.p50_us / of[OWN].p50_us,
        "grip_over_step": of[GRIP].p50_us / step.p50_us,
        # Tails are compared with a floor of the same length, which has the machine's jitter alone.
        "step_p999_over_floor_p999": step.p999_us / of[FLOOR].p999_us,
    }


@dataclass(frozen=True)
class Budget:
    """A figure and its largest value in budget.toml."""

    budget: str
    value: float
    limit: float

    @property
    def is_broken(self) -> bool:
        """Whether the figure is beyond the limit."""
        return self.value > self.limit

    @property
    def line(self) -> str:
        """For people."""
        return f"{self.budget}: {self.value:.3g}, at most {self.limit:g}"

    def to_json(self) -> Json:
        """As it stands in latency.json."""
        return {
            "budget": self.budget,
            "value": self.value,
            "limit": f"at most {self.limit:g}",
        }


def budgets(
    ratios: dict[str, float], n_bytes: int, over_libraries_mb: float
) -> list[Budget]:
    """All that budget.toml limits and this run measured. n_bytes: size of the model file.

    over_libraries_mb: resident memory of the live path over that of the libraries alone.
    """
    limits = tomllib.loads(BUDGET.read_text(encoding="utf-8"))

    found = ratios | {"model_mib": n_bytes / 2**20}
    found["over_libraries_mb"] = over_libraries_mb
    measured = []
    for name, limit in limits["at_most"].items():
        # Without a compiler there is no C form to measure; any other gap is a mistake.
        if name in found or name not in C_RATIOS:
            measured.append(Budget(name, found[name], limit))

    return measured


def simulated_set(work: Path, rate_hz: float) -> DataSet:
    """A small simulated set at the model's rate."""
    scene = Scene(read_scene_file("thesis", rate_hz=rate_hz), 0)
    write_set(scene, work / "set", TRIALS)
    return load(work / "set", windows="thesis")


def stream_of(data: DataSet) -> tuple[FloatArray, BoolArray]:
    """Some trials end to end: values [T, C] and valid [T, C/3]."""
    # Spread over the set, so that every action is in the stream.
    every = max(1, len(data.recordings) // STREAMED)
    chosen = data.recordings[::every][:STREAMED]
    values = np.concatenate([one.samples for one in chosen])
    valid = np.concatenate([one.valid for one in chosen])
    return values, valid


def _bare(data: DataSet, work: Path) -> Model:
    """The raw-window forest of 100 full-depth trees, as a model file."""
    # Two folds, the fewest: only the trees are needed, and no score of them.
    plan = replace(RAW_BASELINE, folds=2)
    train(data, work / "raw", plan)
    path, _ = export_artifact(work / "raw")
    return Model(path)


def learner_alone(path: Path) -> ort.InferenceSession:
    """A session of a file's learners, labels and probabilities, from their features on."""
    return open_session(cut_learners(onnx.load(path)))


def learner_rows(model: Model, stream: tuple[FloatArray, BoolArray]) -> FloatRows:
    """The very rows [T, F] that the whole step hands its learner."""
    rows: FloatRows = run_recording(model.session, *stream, ["features"])["features"]
    return rows
