"""B hands and objects, stepped together one sample period at a time.

All lanes go through the same sample period at once, because one graph answers them. A lane takes
fine steps where anything can happen (the script is busy, its grip moves, its object slides) and one
long step elsewhere, as an open loop does (simulation/script.py); with a grip that never changes the
result is that of the open loop, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.simulation.body import Body, Floor, Inputs, Pull, State, at_rest
from holdfast.simulation.closed_loop.drive import Actuator
from holdfast.simulation.closed_loop.people import Habits, LoopScript
from holdfast.simulation.core import step
from holdfast.simulation.effect import NO_EFFECTS
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.run import (
    SLIDES_M_S,
    StepSettings,
    TrialMotion,
    contact_marks,
    forces_of,
    mean_weight_s,
)
from holdfast.simulation.script import body_of, busy

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Spans:
    """Samples of B lanes: begins [B] of the loop, moves [B] of the physics, ends [B], counts [B].

    A lane's loop begins a while before its hand closes, so that the model has settled.
    """

    begins: IntArray
    moves: IntArray
    ends: IntArray
    counts: IntArray

    @property
    def periods(self) -> int:
        """Sample periods until the last lane has ended."""
        return int((self.ends - self.begins).max())


class StepTape:
    """What every step of every lane leaves: like run._Tape, but a lane may skip steps."""

    def __init__(self, steps: int, lanes: int) -> None:
        self.taken = np.zeros((steps, lanes), dtype=np.bool_)
        self.at_s = np.zeros((steps, lanes))
        self.agents_n = np.zeros((steps, 3, lanes), dtype=np.float32)
        self.gripped, self.slips, self.slides = (
            np.zeros((steps, lanes), dtype=np.bool_) for _ in range(3)
        )
        self.slip_m = np.zeros((steps, lanes), dtype=np.float32)

    def note(
        self,
        row: int,
        lanes: IntArray,
        at_s: FloatArray,
        state: State,
        travel_m: FloatArray,
    ) -> None:
        """One step of some lanes."""
        self.taken[row, lanes], self.at_s[row, lanes] = True, at_s
        self.agents_n[row][:, lanes] = state.agents_n
        marks = contact_marks(state, travel_m)
        self.gripped[row, lanes], self.slips[row, lanes] = marks[:2]
        self.slides[row, lanes], self.slip_m[row, lanes] = marks[2:]


class HandsAndObjects:
    """The physics of B lanes. forces_n [B, S, 3], position_m [B, 3]: at the last sample."""

    def __init__(
        self,
        trials: Sequence[PlannedTrial],
        settings: StepSettings,
        spans: Spans,
        actuator: Actuator,
        habits: Habits,
    ) -> None:
        self.settings, self.spans, self.actuator = settings, spans, actuator
        self.body = body_of(trials, settings.pressure)
        self.script = LoopScript(trials, self.body, habits)
        lanes = len(trials)
        start_s = spans.begins / settings.rate_hz
        self.state = at_rest(self.body, self.script.chunk(start_s[None])[0].closure_m)
        self.travel_m = np.zeros_like(self.state.normal_n)
        self.forces_n = np.zeros((lanes, len(self.state.normal_n), 3))
        self.position_m = np.zeros((lanes, 3))
        self.pieces = max(
            1, int(np.ceil(1.0 / (settings.rate_hz * settings.step_s) - 1e-9))
        )
        self.busy = _busy(trials, settings, spans)
        self.slid = np.zeros(lanes, dtype=np.bool_)
        self.tape = StepTape(spans.periods * self.pieces, lanes)
        self._parts: dict[bytes, Body] = {}

    def advance(self, period: int, target_n: FloatArray) -> None:
        """One sample period of all lanes; target_n [B]: of the drives."""
        at = self.spans.begins + period
        moves = (at >= self.spans.moves) & (at < self.spans.ends)
        fine = moves & (self.busy[period] | self.slid | self.actuator.moving(target_n))
        coarse = moves & ~fine
        if self.settings.effects != NO_EFFECTS:
            every = np.full_like(moves, fill_value=True)
            fine, coarse = (every, ~every) if fine.any() else (~every, every)
        self._step_all(
            period, at, np.flatnonzero(fine), np.flatnonzero(coarse), target_n
        )

    def _step_all(
        self,
        period: int,
        at: IntArray,
        fine: IntArray,
        coarse: IntArray,
        target_n: FloatArray,
    ) -> None:
        rate_hz, pieces = self.settings.rate_hz, self.pieces
        dt_s = 1.0 / (rate_hz * pieces)
        grips_n = np.stack([self.actuator.step(target_n, dt_s) for _ in range(pieces)])
        ends_s = (at + (np.arange(pieces)[:, None] + 1) / pieces) / rate_hz
        first = 0 if fine.size else pieces - 1
        self.script.grip_n = grips_n[first:]
        fine_part, coarse_part = _Part(self, fine), _Part(self, coarse)
        start_s = np.asarray(at / rate_hz, dtype=np.float64)
        before_s = start_s
        for k, now in enumerate(self.script.chunk(ends_s[first:]), first):
            fine_part.step(now, ends_s[k], ends_s[k] - before_s, period * pieces + k)
            before_s = ends_s[k]
        coarse_part.step(
            now, ends_s[-1], ends_s[-1] - start_s, (period + 1) * pieces - 1
        )
        fine_part.finish()
        coarse_part.finish()

    def body_part(self, lanes: IntArray) -> Body:
        """The body of some lanes; kept, because the same lanes come again and again."""
        key = lanes.tobytes()
        if key not in self._parts:
            if len(self._parts) > 8:
                self._parts.clear()
            self._parts[key] = _taken(self.body, lanes, len(self.travel_m[0]))
        return self._parts[key]

    def motion(
        self, lane: int, forces_n: FloatArray, position_m: FloatArray
    ) -> TrialMotion:
        """What became of a lane, as an open loop gives it; forces and positions [T, ..]."""
        tape, taken = self.tape, self.tape.taken[:, lane]
        return TrialMotion(
            t_s=np.arange(len(forces_n)) / self.settings.rate_hz,
            forces_n=forces_n,
            position_m=position_m,
            at_s=tape.at_s[taken, lane],
            agents_n=tape.agents_n[taken, :, lane].astype(np.float64),
            gripped=tape.gripped[taken, lane],
            slips=tape.slips[taken, lane],
            slides=tape.slides[taken, lane],
            slip_m=tape.slip_m[taken, lane].astype(np.float64),
        )


class _Part:
    """Some lanes during one sample period: taken out, stepped, put back."""

    def __init__(self, whole: HandsAndObjects, lanes: IntArray) -> None:
        self.whole, self.count = whole, len(lanes)
        self.lanes = np.repeat(lanes, 2) if len(lanes) == 1 else lanes
        if not self.count:
            return
        n = len(whole.travel_m[0])
        self.all = self.count == n
        self.body = whole.body if self.all else whole.body_part(self.lanes)
        self.state = whole.state if self.all else _taken(whole.state, self.lanes, n)
        self.travel_m = np.take(whole.travel_m, self.lanes, axis=-1)
        self.total = np.zeros((len(self.travel_m), 3, len(self.lanes)))
        self.weight_s = np.zeros(len(self.lanes))

    def step(self, now: Inputs, at_s: FloatArray, dt_s: FloatArray, row: int) -> None:
        """One step of these lanes; now, at_s, dt_s: of all lanes."""
        if not self.count:
            return
        lanes, settings, n = self.lanes, self.whole.settings, len(at_s)
        at_s, dt_s = at_s[lanes], dt_s[lanes]
        inputs = now if self.all else _inputs(now, lanes, n)
        effects = settings.effects if self.all else NO_EFFECTS
        step(self.body, self.state, inputs, dt_s, at_s, effects)
        self.travel_m += (
            np.add.reduce(self.state.slip_m_s, axis=0) / len(self.state.slip_m_s) * dt_s
        )
        self.whole.tape.note(row, lanes, at_s, self.state, self.travel_m)
        if settings.average_s:
            weight_s = mean_weight_s(
                at_s, dt_s, 1.0 / settings.rate_hz, settings.average_s
            )
            if weight_s.any():
                self.total += forces_of(self.body, self.state) * weight_s
                self.weight_s += weight_s

    def finish(self) -> None:
        """Put the lanes back, and the forces at the sample."""
        if not self.count:
            return
        whole, lanes = self.whole, self.lanes
        mean = whole.settings.average_s
        forces = (
            self.total / self.weight_s if mean else forces_of(self.body, self.state)
        )
        whole.forces_n[lanes] = np.moveaxis(forces, 2, 0)
        whole.position_m[lanes] = self.state.position_m.T
        whole.travel_m[:, lanes] = self.travel_m
        fast = (self.state.slip_m_s > SLIDES_M_S).any(axis=0)
        whole.slid[lanes] = (fast & (self.state.normal_n > 0.0)).any(axis=0)
        if not self.all:
            for one in fields(State):
                getattr(whole.state, one.name)[..., lanes] = getattr(
                    self.state, one.name
                )


def _taken(whole: Any, lanes: IntArray, n: int) -> Any:
    """Body or state of some of n lanes; what is the same for all lanes stays."""
    values = {one.name: getattr(whole, one.name) for one in fields(whole)}
    batched = (
        name
        for name, value in values.items()
        if isinstance(value, np.ndarray) and value.ndim and value.shape[-1] == n
    )
    # take, not [..., lanes]: the layout in memory decides in which order numpy sums
    return type(whole)(
        **(values | {n: np.take(values[n], lanes, axis=-1) for n in batched})
    )


def _inputs(now: Inputs, lanes: IntArray, n: int) -> Inputs:
    people = tuple(
        Pull(
            *(np.take(getattr(pull, one.name), lanes, axis=-1) for one in fields(Pull))
        )
        for pull in now.people
    )
    floor: Floor | None = None if now.floor is None else _taken(now.floor, lanes, n)
    return Inputs(np.take(now.closure_m, lanes, axis=-1), people, floor)


def _busy(
    trials: Sequence[PlannedTrial], settings: StepSettings, spans: Spans
) -> BoolArray:
    """[periods, B] where the script of a lane, or an effect, wants fine steps."""
    index = spans.begins + np.arange(spans.periods)[:, None]
    from_s, until_s = (
        index / settings.rate_hz,
        index / settings.rate_hz + 1.0 / settings.rate_hz,
    )
    is_busy = np.zeros(index.shape, dtype=np.bool_)
    more = settings.busy or [()] * len(trials)
    for lane, (trial, own) in enumerate(zip(trials, more, strict=True)):
        for start_s, end_s in [*busy(trial), *own]:
            is_busy[:, lane] |= (until_s[:, lane] > start_s) & (from_s[:, lane] < end_s)
    return is_busy
