"""The live path: a sealed model and a stream of samples become one Prediction a sample."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from edge_runtime.contract import CLASSES, SITUATIONS, Prediction, Sample, State
from edge_runtime.decision import UNKNOWN, DecisionRules, DecisionState, decide
from edge_runtime.errors import ChannelError, TimeError
from edge_runtime.graph import StepGraph
from edge_runtime.model import Model as Model  # the README's import: a monitor and its model from one module
from edge_runtime.onnx_rules import ANSWERS, WEIGHS


class GripMonitor:
    """Feeds prepared samples to a model and turns its outputs into predictions.

    clock_ns: monotonic; injected, so that a replay can run on the recording's own time.
    """

    def __init__(self, model: Model, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.card = model.card
        self._graph = StepGraph(model.session, 1, self._outputs())
        self._rules = DecisionRules(**self.card.decision)
        self._clock_ns = clock_ns
        self.stepped_ns = 0
        """When the graph was done with the last sample."""
        self.reset()

    def feed(self, sample: Sample, *, opening: bool = False, override: bool = False) -> Prediction:
        """One sample in, one prediction out. values [C] are prepared (bias removed), in the model's unit.

        Samples that never came (a gap in t_ns) count as lost: the graph is stepped over them, and a gap of
        more than 20 ms makes the state unknown until the history is whole again. Raises ChannelError, and
        TimeError where time runs backwards.

        A hand that has read the same numbers to the last bit for as long as the model looks back is no live hand, and
        no model was trained on one: the state is unknown. (One finger that repeats itself is for the driver to find, by
        the chip's own counter.) A sample that comes twice, with the same time and the same sequence, is answered again
        and counts once.
        """
        if sample.values.shape != (self.card.n_channels,) or sample.valid.shape != (self.card.n_channels // 3,):
            raise ChannelError(
                f"a sample of {sample.values.shape} values and {sample.valid.shape} flags, "
                f"the model wants {self.card.n_channels} channels of {self.card.n_channels // 3} sensors",
                next_step="use a model made for this source",
            )
        came_before = (sample.t_ns, sample.sequence) == (self._last_t_ns, self._last_sequence)
        if not came_before:
            self._bridge_gap(sample.t_ns)
            self._remember(sample)
            np.copyto(self._graph.sample[0], sample.values)
            np.copyto(self._graph.valid[0], sample.valid)
            self._graph.step()
        self.stepped_ns = self._clock_ns()
        return self._predict(sample, came_before, opening, override)

    def reset(self) -> None:
        """Forget the stream; the next sample starts afresh and unsettled."""
        self._graph.reset()
        self._decision = DecisionState()
        self._last_t_ns: int | None = None
        self._last_sequence: int | None = None
        self._last_reading, self._repeated = b"", 0

    def lose_track(self) -> None:
        """Forget the stream, not what is requested: unknown until settled again, and who holds goes on holding."""
        self._graph.reset()
        self._last_t_ns = None

    def _bridge_gap(self, t_ns: int) -> None:
        """Step over the samples that are missing since the last one, as invalid ones."""
        passed_ns = 0 if self._last_t_ns is None else t_ns - self._last_t_ns
        if passed_ns < 0:
            raise TimeError(
                f"a sample {-passed_ns / 1e6:.3f} ms older than the one before it",
                cause="a clock that was set, or samples out of order",
                next_step="reset the monitor and start again",
            )
        self._last_t_ns = t_ns
        missing = round(passed_ns * 1e-9 * self.card.rate_hz) - 1
        self._graph.valid[:] = False
        for _ in range(min(missing, self.card.gap_samples + 1)):  # one more than is bridged, and it is all the same
            self._graph.step()

    def _remember(self, sample: Sample) -> None:
        """Remember the sample, and count those in a row of which every valid sensor reads the same bits."""
        self._last_sequence = sample.sequence
        reading = sample.values.reshape(-1, 3)[sample.valid].tobytes()
        self._repeated = self._repeated + 1 if reading == self._last_reading else 1
        self._last_reading = reading

    def _outputs(self) -> list[str]:
        return [*ANSWERS, *(WEIGHS if self.card.has_weight else ()), *self.card.heads]

    def _predict(self, sample: Sample, came_before: bool, opening: bool, override: bool) -> Prediction:
        out = self._graph.out
        unknown = bool(out["unknown"][0]) or self._repeated >= self.card.settle_samples
        label = UNKNOWN if unknown else int(out["situation"][0])
        permille = _risky_permille(out["votes"][0])
        counted = UNKNOWN if came_before else label
        self._decision = decide(self._rules, self._decision, counted, permille, opening=opening, override=override)
        state: State = "unknown" if unknown else _STATES[label]
        weighs = self.card.has_weight and state not in ("unknown", "nothing")
        p_situation = _named(SITUATIONS, out["p_situation"][0])
        decided = self._clock_ns()
        return Prediction(
            sequence=sample.sequence,
            t_acquired_ns=sample.t_ns,
            t_decided_ns=decided,
            latency_us=(decided - sample.t_ns) / 1000.0,
            state=state,
            p_situation=p_situation,
            p_risky=p_situation["risky_slip"],
            p_class=_named(CLASSES, out["p_class"][0]) if weighs else None,
            weight=("heavy" if out["weight"][0] else "light") if weighs else None,
            extra={name: float(out[name][0]) for name in self.card.heads},
            detectors={n: bool(f) for n, f in zip(self.card.detectors, out["detectors"][0], strict=True)},
            arm=self._decision.arm,
            act=self._decision.act,
            degraded=not unknown and int(out["usable_sensors"][0]) < self.card.n_channels // 3,
            settled=bool(out["settled"][0]),
            model_id=self.card.model_id,
        )


_STATES: tuple[State, ...] = ("nothing", "grasp", "safe_slip", "risky_slip")


def _risky_permille(votes: Any) -> int:
    """Risky share of the integer votes in thousandths (of eight classes, the last two are risky)."""
    risky = votes[len(votes) * 3 // 4 :].sum()
    return int(1000 * int(risky) // int(votes.sum()))


def _named(names: tuple[str, ...], values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}
