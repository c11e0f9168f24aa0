"""Running a step graph: one sample of B recordings at a time, with explicit state.

B = 1 on the hand; training steps many recordings together through the same file. A Stepper is the
step of B hands, whatever computes it; StepGraph is that of onnxruntime.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray

if TYPE_CHECKING:
    import onnxruntime as ort

Outputs = dict[str, npt.NDArray[Any]]
Rows = npt.NDArray[np.int64]

BATCH = 64
"""Recordings stepped together: enough to hide the call, few enough to keep the state in cache."""
_DTYPES: dict[str, npt.DTypeLike] = {
    "tensor(double)": np.float64,
    "tensor(float)": np.float32,
    "tensor(bool)": np.bool_,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}


class Stepper(Protocol):
    """The step of B hands. sample [B, C] and valid [B, S] are written into before a step.

    out: arrays [B, ..] by the names of the outputs; the next step reuses them.
    """

    sample: FloatArray
    valid: BoolArray
    out: dict[str, npt.NDArray[Any]]

    def step(self) -> dict[str, npt.NDArray[Any]]:
        """Advance by one sample; returns `out`."""
        ...

    def reset(self) -> None:
        """Start from a fresh state at the next sample."""
        ...


Steps = Callable[[int], Stepper]
"""Number of hands B -> their step, from a fresh state, with the outputs that its maker chose."""


def open_session(model: bytes, *, arena: bool = True) -> ort.InferenceSession:
    """An onnxruntime session with one thread and no spinning, as suits a small board.

    arena: keep room for intermediate results, 1 MiB, by which many hands step 5 % faster.
    """
    import onnxruntime as ort  # here, because a compiled library answers without it

    options = ort.SessionOptions()

    # a step is too short to share between threads
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.enable_cpu_mem_arena = arena
    options.log_severity_level = 3

    session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    # it keeps the whole file for a change of its providers, which is never made
    session._model_bytes = b""
    return session


class StepGraph:
    """A step graph bound to buffers for B recordings.

    sample: [B, C] and valid: [B, n], to be written into before a step.
    outputs: which outputs to compute (default: all but the state, which is always kept).
    """

    def __init__(
        self,
        session: ort.InferenceSession,
        batch: int = 1,
        outputs: Sequence[str] | None = None,
    ):
        inputs = {one.name: one for one in session.get_inputs()}
        described = {one.name: one for one in session.get_outputs()}
        if outputs is None:
            outputs = [name for name in described if name != "state_out"]

        self._session = session
        self.batch = batch
        self._inputs: Outputs = {}
        for name in ("sample", "valid", "reset"):
            self._inputs[name] = _buffer(inputs[name], batch)

        # views of the inputs without the axis of length 1 that the file has
        self.sample: FloatArray = self._inputs["sample"].reshape(batch, -1)
        self.valid: BoolArray = self._inputs["valid"].reshape(batch, -1)
        self.valid[:] = True
        self._reset: BoolArray = self._inputs["reset"].reshape(batch)

        self.out: Outputs = {}
        for name in outputs:
            self.out[name] = _buffer(described[name], batch)

        # Two buffers hold the state, and each step swaps them as input and output: so a step
        # copies nothing and allocates nothing.
        self._states = [_buffer(inputs["state"], batch) for _ in range(2)]
        self._bindings = [self._bind(turn) for turn in range(2)]
        self._turn = 0

    def step(self) -> Outputs:
        """Advance by the sample in `sample` and `valid`.

        Returns output buffers that the next step reuses.
        """
        self._session.run_with_iobinding(self._bindings[self._turn])
        self._turn = 1 - self._turn
        # checked first: clearing 64 flags at every step would cost more
        if self._reset[0]:
            self._reset[:] = False
        return self.out

    def reset(self) -> None:
        """Start from a fresh state at the next sample."""
        self._reset[:] = True

    def take(self, other: StepGraph, which: Rows) -> None:
        """Go on from the states of some hands of another one [B], which may repeat."""
        np.take(other.state, which, axis=0, out=self.state, mode="clip")
        self._reset[:] = other._reset[which]

    @property
    def state(self) -> FloatArray:
        """[B, rows, C] state after the last step."""
        return self._states[self._turn]

    def _bind(self, turn: int) -> ort.IOBinding:
        """Inputs and outputs of one of the two turns, bound once to fixed memory."""
        binding = self._session.io_binding()

        # The file names the state twice, as an input and as an output: one buffer for each.
        inputs = {**self._inputs, "state": self._states[turn]}
        outputs = {**self.out, "state_out": self._states[1 - turn]}
        for name, array in inputs.items():
            binding.bind_input(
                name, "cpu", 0, array.dtype.type, array.shape, array.ctypes.data
            )

        for name, array in outputs.items():
            binding.bind_output(
                name, "cpu", 0, array.dtype.type, array.shape, array.ctypes.data
            )

        return binding


def _buffer(described: Any, batch: int) -> npt.NDArray[Any]:
    """Zeros for an input or output of B hands: a state of zeros is a fresh one."""
    shape = (batch, *described.shape[1:])
    return np.zeros(shape, dtype=_DTYPES[described.type])


def run_recording(
    session: ort.InferenceSession,
    values: FloatArray,
    valid: BoolArray,
    outputs: Sequence[str],
) -> Outputs:
    """All outputs of one recording: values [T, C], valid [T, C/3] -> each output [T, ...]."""
    rows = np.arange(len(values))
    (answers,) = run_recordings(session, [values], [valid], outputs, [rows])
    return answers


def run_recordings(
    session: ort.InferenceSession,
    values: Sequence[FloatArray],
    valid: Sequence[BoolArray],
    outputs: Sequence[str],
    rows: Sequence[Rows],
) -> list[Outputs]:
    """Step many recordings together, each from a fresh state, and keep the wanted rows of each.

    values: recordings [T_i, C]. rows: ascending row numbers to keep, per recording. Recordings of
    similar length share a batch. Shorter ones are padded at the end, and no output of the padding
    is kept.
    """
    return step_recordings(steps_of(session, outputs), values, valid, rows)


def steps_of(session: ort.InferenceSession, outputs: Sequence[str]) -> Steps:
    """The step of any number of hands in onnxruntime. outputs: those to compute."""
    return lambda hands: StepGraph(session, hands, outputs)


def step_recordings(
    steps: Steps,
    values: Sequence[FloatArray],
    valid: Sequence[BoolArray],
    rows: Sequence[Rows],
) -> list[Outputs]:
    """As `run_recordings`, by a step of any engine."""
    results: list[Outputs] = [{} for _ in values]
    # of similar length, so that little of a batch is padding
    order = sorted(range(len(values)), key=lambda index: len(values[index]))
    for start in range(0, len(order), BATCH):
        batch = order[start : start + BATCH]
        graph = steps(len(batch))
        wanted = [rows[index] for index in batch]
        kept = _KeptRows(wanted, graph.out)
        stacked, stacked_valid = _pad(values, valid, batch)
        for t in range(kept.n_steps):
            np.copyto(graph.sample, stacked[t])
            np.copyto(graph.valid, stacked_valid[t])
            kept.collect(t, graph.step())

        for position, index in enumerate(batch):
            results[index] = kept.of(position)

    return results


class _KeptRows:
    """Collects the wanted rows of a batch of recordings: one copy an output and step."""

    def __init__(self, rows: Sequence[Rows], buffers: Outputs) -> None:
        counts = [len(one) for one in rows]
        t = np.concatenate(rows)
        position = np.repeat(np.arange(len(rows)), counts)

        # stable, so that the rows of one step stay in the order of the recordings
        order = np.argsort(t, kind="stable")
        self.n_steps = int(t.max(initial=-1)) + 1
        self._position = position[order]

        # rows of step t: from starts[t] to starts[t + 1]
        steps = np.arange(self.n_steps + 1)
        self._starts = np.searchsorted(t[order], steps).tolist()

        self._out: Outputs = {}
        for name, buffer in buffers.items():
            shape = (len(t), *buffer.shape[1:])
            self._out[name] = np.empty(shape, buffer.dtype)

    def collect(self, t: int, out: Outputs) -> None:
        """Keep what is wanted of step t."""
        here = slice(self._starts[t], self._starts[t + 1])
        if here.start == here.stop:
            return

        hands = self._position[here]
        for name, array in self._out.items():
            # with mode="clip" numpy writes into `out` without a buffer of its own
            np.take(out[name], hands, axis=0, out=array[here], mode="clip")

    def of(self, position: int) -> Outputs:
        """The wanted rows of one recording of the batch."""
        mine = np.flatnonzero(self._position == position)
        return {name: array[mine] for name, array in self._out.items()}


def _pad(
    values: Sequence[FloatArray], valid: Sequence[BoolArray], batch: list[int]
) -> tuple[FloatArray, BoolArray]:
    """[T, B, C] and [T, B, n], time first so that a step reads one block of memory."""
    longest = max(len(values[index]) for index in batch)
    n_channels = values[batch[0]].shape[1]
    n_sensors = valid[batch[0]].shape[1]

    stacked = np.zeros((longest, len(batch), n_channels))
    stacked_valid = np.zeros((longest, len(batch), n_sensors), dtype=np.bool_)
    for position, index in enumerate(batch):
        length = len(values[index])
        stacked[:length, position] = values[index]
        stacked_valid[:length, position] = valid[index]

    return stacked, stacked_valid
