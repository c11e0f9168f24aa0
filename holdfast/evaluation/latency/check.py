"""`holdfast bench latency`: one decision beside its peers, timed interleaved on the same stream.

Absolute microseconds belong to one machine; ratios carry over to others. Percentiles are of all
calls but the first of each turn. That one comes to cold caches and has a median of its own. The
floors are busy waits as long as the step, and as the step in C: their tails are the machine's own
jitter. Every answer is checked while it is timed. Peers, on the same windows:

    scikit-learn            predict_proba of 100 full-depth trees on the raw window, one row
    bare forest             the same trees in onnxruntime, io-bound, nothing else computed
    ours, learner alone     our own trees and networks alone, on the rows that the step gives them
    ours, whole step        guard, bank, detectors, features, learner, votes: what runs on the hand
    ours, whole step in C   the same file as compiled C, called from Python (where there is a
                            compiler)
    ours, grip command      friction margin, controller and supervisor, from the step's answer on
    a walk in C             the same 100 trees in a few lines of C (where there is a compiler)
    treelite                the same trees by its interpreter (in the environment of `make peers`)
    the thesis' way         ten band-pass filters a channel, one sample at a time in Python, then
                            scikit-learn
"""

from __future__ import annotations

import tempfile
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import cycle
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
from scipy.signal import butter

from holdfast import edge_runtime
from holdfast.core.contract import CLASSES, BoolArray, FloatArray
from holdfast.core.errors import LibraryMissing
from holdfast.core.reading import Json
from holdfast.edge_runtime.graph import open_session, run_recording
from holdfast.edge_runtime.monitor import Model
from holdfast.evaluation.latency.calls import (
    BARE,
    C_FLOOR,
    C_STEP,
    FLOOR,
    GRIP,
    OWN,
    SKLEARN,
    STEP,
    THESIS,
    TREELITE,
    WALK,
    c_step_of,
    grip_of,
    learner_of,
    step_of,
)
from holdfast.evaluation.latency.forest_c import c_walk
from holdfast.evaluation.latency.memory import memory
from holdfast.evaluation.latency.timing import TURNS, busy_wait, time_in_turns
from holdfast.export.exporting import export_artifact
from holdfast.export.learner import Forest, reference_votes
from holdfast.export.spec import bands_for
from holdfast.export.verify import cut_learners
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.crossval import fit_learner
from holdfast.training.datasets import load
from holdfast.training.featurise import FloatRows, features_of, spec_for
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
SLOW_TURNS = 5
SLOW_CALLS = 20
"""Calls of milliseconds are timed less often."""


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
        data = _scenes(Path(work), model.card.rate_hz)
        stream = _stream(data)
        # All calls get the samples of one stream, so none has easier rows than another.
        step = step_of(model, stream)
        step_in_c = c_step_of(model, stream, Path(work))

        bare, forest = _bare(data, Path(work))
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
        quick |= _walk(forest, rows, Path(work))

        times = _by_turn(time_in_turns(quick, turns), turns)
        slow = _treelite(forest, rows) | {
            SKLEARN: _predict(forest, rows),
            THESIS: _thesis_way(forest, data),
        }
        slow_times = time_in_turns(slow, SLOW_TURNS, SLOW_CALLS)
        times |= _by_turn(slow_times, SLOW_TURNS)

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
        "thesis_over_step": of[THESIS].p50_us / step.p50_us,
    }


@dataclass(frozen=True)
class Budget:
    """A figure and its limit in budget.toml. at: "most" or "least"."""

    budget: str
    value: float
    at: str
    limit: float

    @property
    def is_broken(self) -> bool:
        """Whether the figure is beyond the limit."""
        if self.at == "most":
            return self.value > self.limit
        return self.value < self.limit

    @property
    def line(self) -> str:
        """For people."""
        return f"{self.budget}: {self.value:.3g}, at {self.at} {self.limit:g}"

    def to_json(self) -> Json:
        """As it stands in latency.json."""
        return {
            "budget": self.budget,
            "value": self.value,
            "limit": f"at {self.at} {self.limit:g}",
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
    for at in ("most", "least"):
        for name, limit in limits[f"at_{at}"].items():
            # Without a compiler there is no C form to measure; any other gap is a mistake.
            if name in found or name not in C_RATIOS:
                measured.append(Budget(name, found[name], at, limit))

    return measured


def _scenes(work: Path, rate_hz: float) -> DataSet:
    """A small simulated set at the model's rate."""
    scene = Scene(read_scene_file("thesis", rate_hz=rate_hz), 0)
    write_set(scene, work / "set", TRIALS)
    return load(work / "set", windows="thesis")


def _stream(data: DataSet) -> tuple[FloatArray, BoolArray]:
    """Some trials end to end: values [T, C] and valid [T, C/3]."""
    # Spread over the set, so that every action is in the stream.
    every = max(1, len(data.recordings) // STREAMED)
    chosen = data.recordings[::every][:STREAMED]
    values = np.concatenate([one.samples for one in chosen])
    valid = np.concatenate([one.valid for one in chosen])
    return values, valid


def _bare(data: DataSet, work: Path) -> tuple[Model, Forest]:
    """The raw-window forest of 100 full-depth trees, as a model file and as scikit-learn's."""
    # Two folds, the fewest: only the trees are needed, and no score of them.
    plan = replace(RAW_BASELINE, folds=2)
    train(data, work / "raw", plan)
    path, _ = export_artifact(work / "raw")

    # The same trees as in the file, kept by scikit-learn for its own predict_proba.
    rows = features_of(data, spec_for(data, RAW_BASELINE.groups))["classes"]
    everything = np.arange(len(rows))
    forest = fit_learner(data, rows, RAW_BASELINE, "classes", everything, 0)
    return Model(path), forest


def _predict(forest: Forest, rows: FloatRows) -> Callable[[], object]:
    # Threads cost more than they save on one row.
    forest.set_params(n_jobs=1)
    turn = cycle(range(len(rows)))

    def call() -> object:
        k = next(turn)
        return forest.predict_proba(rows[k : k + 1])

    return call


def _walk(
    forest: Forest, rows: FloatRows, work: Path
) -> dict[str, Callable[[], object]]:
    """The walk in C, its votes checked against the reference first; empty without a compiler."""
    try:
        votes = c_walk(forest, len(CLASSES), rows, work)
    except LibraryMissing:
        return {}

    # Only a walk with the same votes can be compared with the others.
    # Votes and not labels: a difference that changes no label would still be a mistake.
    expected = reference_votes(forest, rows, len(CLASSES))
    for k in range(len(rows)):
        if not np.array_equal(votes(k), expected[k]):
            raise AssertionError("the walk in C does not vote as the reference does")

    turn = cycle(range(len(rows)))
    return {WALK: lambda: votes(next(turn))}


def _treelite(forest: Forest, rows: FloatRows) -> dict[str, Callable[[], object]]:
    """treelite's own interpreter, one row a call; nothing where it is not installed."""
    try:
        import treelite
    except ImportError:
        return {}

    model = treelite.sklearn.import_model(forest)
    turn = cycle(range(len(rows)))

    def call() -> object:
        k = next(turn)
        return treelite.gtil.predict(model, rows[k : k + 1], nthread=1)

    return {TREELITE: call}


def _thesis_way(forest: Forest, data: DataSet) -> Callable[[], object]:
    """Every sample through ten second-order band-pass filters a channel, in plain Python."""
    samples = data.recordings[0].samples
    # Plain lists: on single numbers Python is faster with them than with numpy.
    filters = []
    for hz in bands_for(data.rate_hz):
        # The thesis' bands: a tenth of the centre frequency to either side.
        edges_hz = (0.9 * hz, 1.1 * hz)
        b, a = butter(1, edges_hz, "bandpass", fs=data.rate_hz)
        filters.append((b.tolist(), a.tolist()))

    memory = []
    for _ in range(samples.shape[1]):
        memory.append([[0.0, 0.0] for _ in filters])

    # The window is kept as float32, which is what the forest compares.
    window = np.zeros((1, forest.n_features_in_), dtype=np.float32)
    turn = cycle(range(len(samples)))

    def call() -> None:
        sample = samples[next(turn)].tolist()
        # Direct form II transposed, as scipy's lfilter has it.
        for value, states in zip(sample, memory, strict=True):
            for (b, a), state in zip(filters, states, strict=True):
                out = b[0] * value + state[0]
                state[0] = b[1] * value - a[1] * out + state[1]
                state[1] = b[2] * value - a[2] * out

        # The window moves on by one sample of all channels.
        n = len(sample)
        window[0, :-n] = window[0, n:]
        window[0, -n:] = sample
        forest.predict_proba(window)

    return call


def learner_alone(path: Path) -> ort.InferenceSession:
    """A session of a file's learners, labels and probabilities, from their features on."""
    return open_session(cut_learners(onnx.load(path)))


def learner_rows(model: Model, stream: tuple[FloatArray, BoolArray]) -> FloatRows:
    """The very rows [T, F] that the whole step hands its learner."""
    rows: FloatRows = run_recording(model.session, *stream, ["features"])["features"]
    return rows
