"""Trials of a card with `[controller]`: the motion of a hand that acted, to the end of the trial.

The loop goes on as long as the recording does. The recording's samples are those that the model
file got in the loop: both come from the same forces, by the same laws (sensing.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import CardError
from holdfast.core.reading import Json
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.edge_runtime.grip import GripSense
from holdfast.edge_runtime.monitor import require_fit
from holdfast.edge_runtime.supervisor import IDLE, Limits
from holdfast.simulation.card import Card
from holdfast.simulation.closed_loop.controllers import Managed, managed
from holdfast.simulation.closed_loop.drive import COLUMNS, GripRecord, HandControl
from holdfast.simulation.closed_loop.loop import (
    LANES,
    ClosedLoop,
    LoopController,
    LoopSettings,
    LoopTruth,
)
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.run import TrialMotion, motions
from holdfast.simulation.scene import Moved, Scene

Done = Callable[[float], None]
GRIP = COLUMNS.index("grip_n")
REPORT_PERIODS = 50


@lru_cache(maxsize=2)
def model_of(choice: ModelChoice) -> OpenedModel:
    """A model file, opened once a process. Raises a ModelError, or UsageError."""
    return choice.open()


def scene_of(card: Card, seed: int) -> Scene:
    """The scene of a card; its hand acts where the card has a controller."""
    return Scene(card, seed, None if card.controller is None else controlled_motions)


def require_controller(scene: Scene, trials: Sequence[PlannedTrial]) -> None:
    """Raise what a card's controller lacks: the model, its fit, or a strong enough drive.

    Raises NotAModel, ChannelError, UnitError, RateError, CardError.
    """
    card, control = scene.card, scene.card.controller
    if control is None:
        return
    contacts = 3 * card.hand.n_contacts
    require_fit(
        model_of(ModelChoice(control.model)).card,
        n_channels=contacts,
        unit=card.unit,
        rate_hz=card.rate_hz,
        where=card.name,
    )
    _require_strength(card.name, control, trials)


def _require_strength(
    card: str, control: HandControl, trials: Sequence[PlannedTrial]
) -> None:
    strongest_n = max((t.grip_n for t in trials if t.action != "nothing"), default=0.0)
    if strongest_n > control.drive.ceiling_n:
        raise CardError(
            f"controller.ceiling_n = {control.drive.ceiling_n:g} is below {strongest_n:.3g} N a "
            "side, with which a hand of this card holds its object",
            where=card,
            next_step=f"ceiling_n = {np.ceil(strongest_n):g} or more, or weaker grips",
        )


def controlled_motions(
    scene: Scene, trials: Sequence[PlannedTrial], done: Done
) -> Moved:
    """Motion and grip of trials, in their order; an empty hand gets no command: None.

    done: called with the share that is stepped. Raises as require_controller.
    """
    require_controller(scene, trials)
    for start in range(0, len(trials), LANES):
        part = trials[start : start + LANES]
        yield from _part(
            scene, part, partial(_report, done, start, len(part), len(trials))
        )


def _report(done: Done, before: int, lanes: int, total: int, share: float) -> None:
    done((before + share * lanes) / total)


def _part(scene: Scene, trials: Sequence[PlannedTrial], done: Done) -> Moved:
    held = [trial for trial in trials if trial.action != "nothing"]
    empty = [trial for trial in trials if trial.action == "nothing"]
    in_hand = iter(RecordedLoop(scene, held).run(done) if held else ())
    alone = _open_loop(scene, empty)
    for trial in trials:
        yield (next(alone), None) if trial.action == "nothing" else next(in_hand)


def _open_loop(scene: Scene, trials: Sequence[PlannedTrial]) -> Iterator[TrialMotion]:
    if trials:
        twice = [*trials, *trials]  # numpy would sum a single lane in another order
        yield from motions(twice, scene.step_settings_of(twice))


class RecordedLoop:
    """A closed loop of trials with an object that keeps everything a recording needs."""

    def __init__(self, scene: Scene, trials: Sequence[PlannedTrial]) -> None:
        control = scene.card.controller
        assert control is not None
        self.count = len(trials)
        self._model = model_of(ModelChoice(control.model))
        self._commands: list[FloatArray] = []
        self._control, self._make = control, _maker(scene, control)
        lanes = trials if len(trials) > 1 else [*trials, *trials]
        settings = LoopSettings(control.drive, whole_trials=True)
        self.loop = ClosedLoop(scene, lanes, self._model, self._noting, settings)

    def _noting(self, trials: Sequence[PlannedTrial], rate_hz: float) -> LoopController:
        return _Noting(self._make(trials, rate_hz), self._commands)

    def run(
        self, done: Done = lambda share: None
    ) -> list[tuple[TrialMotion, GripRecord]]:
        """Run to the end of every trial. done: called with the share that is stepped."""
        loop, kept = self.loop, _Kept(self._commands)
        for period in range(loop.spans.periods):
            target_n = loop.decide(period)
            kept.grip_n.append(loop.actuator.grip_n.copy())
            loop.world.advance(period, target_n)
            kept.forces_n.append(loop.world.forces_n.copy())
            kept.position_m.append(loop.world.position_m.copy())
            if period % REPORT_PERIODS == 0:
                done(period / loop.spans.periods)
        return [self._recording(lane, kept) for lane in range(self.count)]

    def _recording(self, lane: int, kept: _Kept) -> tuple[TrialMotion, GripRecord]:
        spans = self.loop.spans
        begins, ends = int(spans.begins[lane]), int(spans.ends[lane])
        forces_n = np.zeros((int(spans.counts[lane]), *kept.forces_n[0].shape[1:]))
        position_m = np.zeros((len(forces_n), 3))
        for k in range(ends - begins):
            forces_n[begins + k + 1] = kept.forces_n[k][lane]
            position_m[begins + k + 1] = kept.position_m[k][lane]
        position_m[ends + 1 :] = position_m[ends]
        overrode_s = float(self.loop.wearer.overrode_s[lane])
        grip = GripRecord(self._rows(lane, kept), self._about(), overrode_s)
        return self.loop.world.motion(lane, forces_n, position_m), grip

    def _rows(self, lane: int, kept: _Kept) -> FloatArray:
        """[T, 5] as COLUMNS; before and after the loop the wearer's own grip is left alone."""
        begins, ends = (
            int(self.loop.spans.begins[lane]),
            int(self.loop.spans.ends[lane]),
        )
        rows = np.full((int(self.loop.spans.counts[lane]), len(COLUMNS)), np.nan)
        rows[:, COLUMNS.index("mode")] = IDLE
        rows[:, GRIP] = self.loop.actuator.own_n[lane]
        for k in range(ends - begins):
            rows[begins + k, :GRIP] = kept.commands[k][:, lane]
            rows[begins + k, GRIP] = kept.grip_n[k][lane]
        rows[ends:, GRIP] = kept.grip_n[ends - begins - 1][lane]
        return rows

    def _about(self) -> Json:
        return about(self._control, self._model)


@dataclass(frozen=True)
class _Kept:
    """One entry a sample: commands [4, B], as COLUMNS without the grip; grips, forces, places."""

    commands: list[FloatArray]
    grip_n: list[FloatArray] = field(default_factory=list)
    forces_n: list[FloatArray] = field(default_factory=list)
    position_m: list[FloatArray] = field(default_factory=list)


class _Noting:
    """A managed controller whose commands are kept."""

    def __init__(self, managed_one: Managed, commands: list[FloatArray]) -> None:
        self._managed, self._commands = managed_one, commands
        self.mu_hat = managed_one.mu_hat

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] target, N a side; 0 for none."""
        target_n, grip = self._managed.step(sense, now), self._managed.grip
        self.mu_hat = self._managed.mu_hat
        numbers = (target_n, grip.margin.needed_n, grip.margin.mu_hat)
        known = [np.where(number > 0.0, number, np.nan) for number in numbers]
        self._commands.append(np.stack([*known, grip.supervisor.mode]))
        return target_n


def _maker(
    scene: Scene, control: HandControl
) -> Callable[[Sequence[PlannedTrial], float], Managed]:
    limits = Limits(ceiling_n=control.drive.ceiling_n)
    return managed(scene, control.name, control.setting, limits=limits)


def about(control: HandControl, model: OpenedModel) -> Json:
    """Controller, model and drive, for meta data."""
    return {
        "name": control.name,
        "model": control.model,
        "model_id": model.card.model_id,
        "setting": control.setting,
        "drive": asdict(control.drive),
    }
