"""Trials of a scene with `[controller]`: the motion of a hand that acted, to the end of the trial.

The loop goes on as long as the recording does. The recording's samples are those that the model
file got in the loop: both come from the same forces, by the same laws (loop_sensing.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import CardError
from holdfast.core.reading import Json
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.edge_runtime.grip import AnswerRules
from holdfast.edge_runtime.monitor import require_fit
from holdfast.edge_runtime.supervisor import IDLE, Limits
from holdfast.simulation.closed_loop import (
    MOST_TOGETHER,
    ClosedLoop,
    LoopSettings,
    Managed,
    managed,
    model_of,
)
from holdfast.simulation.drive import GRIP_COLUMNS, GripRecord, HandControl
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.run import Done, TrialMotion, motions
from holdfast.simulation.scene import Moved, Scene
from holdfast.simulation.scene_file import SceneFile, read_scene_file

COMMANDS = len(GRIP_COLUMNS) - 1
"""Columns of what is commanded; the last one is the grip of the drive."""
REPORT_PERIODS = 50
"""Progress is reported once in this many sample periods."""


def scene_of(file: SceneFile, seed: int) -> Scene:
    """The scene of a scene file; its hand acts where the file has a controller."""
    return Scene(file, seed, None if file.controller is None else controlled_motions)


def planned_set(
    card: str, seed: int, total: int | None, rate_hz: float | None, rate_option: str
) -> tuple[Scene, list[PlannedTrial]]:
    """The scene of a card with so many of its trials, planned and runnable.

    total: None for all; rate_hz: None for the card's; rate_option: names it in an error.
    Raises CardError, and what its controller lacks.
    """
    file = read_scene_file(card, rate_hz=rate_hz, rate_option=rate_option)
    scene = scene_of(file, seed)
    trials = scene.trials(total)
    require_controller(scene, trials)
    return scene, trials


def require_controller(scene: Scene, trials: Sequence[PlannedTrial]) -> None:
    """Raise what a scene's controller lacks: the model, its fit, or a strong enough drive.

    Raises NotAModel, ChannelError, UnitError, RateError, CardError.
    """
    file = scene.file
    control = scene.file.controller
    if control is None:
        return

    # The model must fit contacts, unit and rate of the scene before anything is simulated.
    model = model_of(ModelChoice(control.model))
    require_fit(
        model.card,
        n_channels=3 * file.hand.n_sensors,
        unit=file.unit,
        rate_hz=file.rate_hz,
        where=file.name,
    )
    # A drive that is weaker than the wearer's grip would let objects go by itself.
    grips_n = [trial.grip_n for trial in trials if trial.holds_object]
    strongest_n = max(grips_n, default=0.0)
    if strongest_n > control.drive.ceiling_n:
        raise CardError(
            f"controller.ceiling_n = {control.drive.ceiling_n:g} is below {strongest_n:.3g} N a "
            "side, with which a hand of this scene holds its object",
            where=file.name,
            next_step=f"ceiling_n = {np.ceil(strongest_n):g} or more, or weaker grips",
        )


def controlled_motions(
    scene: Scene, trials: Sequence[PlannedTrial], done: Done
) -> Moved:
    """Motion and grip of trials, in their order; an empty hand gets no command: None.

    done: called with the share that is stepped. Raises as require_controller.
    """
    require_controller(scene, trials)
    for start in range(0, len(trials), MOST_TOGETHER):
        part = trials[start : start + MOST_TOGETHER]

        def report(share: float, start: int = start, count: int = len(part)) -> None:
            done((start + share * count) / len(trials))

        yield from _part(scene, part, report)


def _part(scene: Scene, trials: Sequence[PlannedTrial], done: Done) -> Moved:
    """Trials with an object in the loop, those of the empty hand without."""
    # An empty hand has nothing to hold, so no controller needs to run for it.
    held = [trial for trial in trials if trial.holds_object]
    empty = [trial for trial in trials if not trial.holds_object]

    recordings: list[tuple[TrialMotion, GripRecord]] = []
    if held:
        recordings = RecordedLoop(scene, held).run(done)
    in_hand = iter(recordings)

    # Each twice, because numpy sums a single trial in another order than many.
    twice = [*empty, *empty]
    alone: Iterator[TrialMotion] = iter(())
    if twice:
        alone = motions(twice, scene.step_settings_of(twice))

    for trial in trials:
        if not trial.holds_object:
            yield next(alone), None
        else:
            yield next(in_hand)


class RecordedLoop:
    """A closed loop of trials with an object that keeps everything a recording needs.

    _rows        [periods, 5, B] as GRIP_COLUMNS, at the beginning of each period
    _forces_n    [periods, B, S, 3] at the end of each period
    _position_m  [periods, B, 3] of the object, likewise
    """

    def __init__(self, scene: Scene, trials: Sequence[PlannedTrial]) -> None:
        control = scene.file.controller
        assert control is not None
        self.count = len(trials)
        self._control = control
        self._model = model_of(ModelChoice(control.model))
        limits = Limits(ceiling_n=control.drive.ceiling_n)
        rules = AnswerRules.of(self._model.card.decision)
        make = managed(scene, control.name, control.setting, rules, limits)

        # numpy sums a single trial in another order than many, so one runs twice.
        batch = trials if len(trials) > 1 else [*trials, *trials]
        settings = LoopSettings(control.drive, whole_trials=True)
        self.loop = ClosedLoop(scene, batch, self._model, make, settings)

        periods = self.loop.spans.periods
        n = len(batch)
        contacts = self.loop.world.forces_n.shape[1]
        self._rows = np.zeros((periods, len(GRIP_COLUMNS), n))
        self._forces_n = np.zeros((periods, n, contacts, 3))
        self._position_m = np.zeros((periods, n, 3))

    def run(
        self, done: Done = lambda share: None
    ) -> list[tuple[TrialMotion, GripRecord]]:
        """Run to the end of every trial. done: called with the share that is stepped."""
        loop = self.loop
        periods = self.loop.spans.periods
        assert isinstance(loop.controller, Managed)

        for period in range(periods):
            # The row of a sample has what was decided at it, and the grip it was decided with.
            target_n = loop.decide(period)
            self._rows[period, :COMMANDS] = _commands(loop.controller)
            self._rows[period, COMMANDS] = loop.actuator.grip_n

            loop.world.advance(period, target_n)
            self._forces_n[period] = loop.world.forces_n
            self._position_m[period] = loop.world.position_m
            if period % REPORT_PERIODS == 0:
                done(period / periods)

        return [self._recording(trial) for trial in range(self.count)]

    def _recording(self, trial: int) -> tuple[TrialMotion, GripRecord]:
        """Motion and grip of one trial, from the arrays of the whole batch."""
        spans = self.loop.spans
        begins = int(spans.begins[trial])
        ends = int(spans.ends[trial])
        count = int(spans.counts[trial])
        periods = ends - begins

        # What a period ends with is the sample after it.
        contacts = self._forces_n.shape[2]
        forces_n = np.zeros((count, contacts, 3))
        forces_n[begins + 1 : ends + 1] = self._forces_n[:periods, trial]
        position_m = np.zeros((count, 3))
        position_m[begins + 1 : ends + 1] = self._position_m[:periods, trial]

        # After the loop nothing moves.
        position_m[ends + 1 :] = position_m[ends]

        rows = self._grip_rows(trial, count, begins, ends)
        overrode_s = float(self.loop.wearer.overrode_s[trial])
        origin = about(self._control, self._model.card.model_id)
        grip = GripRecord(rows, origin, overrode_s)
        motion = self.loop.world.motion(trial, forces_n, position_m)
        return motion, grip

    def _grip_rows(self, trial: int, count: int, begins: int, ends: int) -> FloatArray:
        """[T, 5] as GRIP_COLUMNS; outside the loop the wearer's grip is left alone."""
        # Before the loop: no command, and the wearer's grip.
        rows = np.full((count, len(GRIP_COLUMNS)), np.nan)
        rows[:, COMMANDS - 1] = IDLE
        rows[:, COMMANDS] = self.loop.trials[trial].grip_n

        periods = ends - begins
        rows[begins:ends] = self._rows[:periods, :, trial]

        # After it the drive, which cannot be driven back, stays where it was.
        rows[ends:, COMMANDS] = self._rows[periods - 1, COMMANDS, trial]
        return rows


def _commands(controller: Managed) -> FloatArray:
    """[4, B] of GRIP_COLUMNS, nan where the controller has no number."""
    margin = controller.grip.margin
    supervisor = controller.grip.supervisor
    numbers = np.stack([controller.target_n, margin.needed_n, margin.mu_hat])
    # A controller that has no number yet gives zero.
    known = np.where(numbers > 0.0, numbers, np.nan)
    return np.vstack([known, supervisor.mode])


def about(control: HandControl, model_id: str) -> Json:
    """Controller, model and drive, for meta data."""
    return {
        "name": control.name,
        "model": control.model,
        "model_id": model_id,
        "setting": control.setting,
        "drive": asdict(control.drive),
    }
