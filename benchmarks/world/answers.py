"""The answered hand: sensors, the model file, the controller, and a hand that obeys its commands.

As a program of one's own would do it (docs/api.md): `holdfast.load`, a bias from the first rows as
`open_hand` takes it, one `Sample` after the other into `feed`, and the `GripCommand` of `holdfast
run --grip`. The hand obeys as docs/shared-control.md says: it grips for the larger one of the
wearer's grip and the target, until its wearer opens it; without a target it keeps the grip that it
has in `hold`, and gives it back in `idle` and `yield`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

import holdfast
from benchmarks.world.draws import HAND, HOLDS, WorldTrial
from benchmarks.world.hand import RATE_HZ, World
from benchmarks.world.outcomes import Outcome, Watch
from holdfast.core.contract import BoolArray, FloatArray
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.edge_runtime.preparation import Tare
from holdfast.live.grip import controller_for
from holdfast.simulation.effects.effect import stream
from holdfast.simulation.loop.drive import Opening
from holdfast.simulation.loop.sensing import LoopSensors
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file

SENSORS = ("chain", "ideal")
"""Our sensor chain: that of the card SENSOR_CARD; ideal: the forces themselves."""
SENSOR_CARD = "thesis"
DITHER_N = 1e-4
"""Noise of ideal sensors: a hand whose samples are all equal counts as dead."""
TIGHTER_N = 1.0
"""A target so far above the wearer's grip counts as a tightening."""
SPARE_S = 0.3
"""After the giver has let go: when a hold is quiet and tightenings in it are false."""

Read = Callable[[int, FloatArray], tuple[FloatArray, BoolArray]]
"""(number of the sample, forces [S, 3] in N) -> (values [3 S], valid [S])."""


@dataclass
class Answers:
    """What the controller did. Commands count where they exceed the wearer's grip by TIGHTER_N.

    outcome      what became of the object
    earlier      the hand was tightened between the giver's letting go and the event
    called       it was tightened, or asked to act, in the event, while the object was held
    released_s   from the wearer's opening until the command is gone, s; 0 where there was none
    tightenings  how often a tightening began in the quiet of the hold
    quiet_s      how long that quiet was
    most_n       largest command while the object is held, N a side; 0 for none
    """

    outcome: Outcome
    earlier: bool = False
    called: bool = False
    released_s: float = 0.0
    tightenings: int = 0
    quiet_s: float = 0.0
    most_n: float = 0.0


@lru_cache(maxsize=1)
def sensor_scene(seed: int) -> Scene:
    """The scene whose sensors are used."""
    return Scene(read_scene_file(SENSOR_CARD), seed)


def reader(trial: WorldTrial, sensors: str) -> Read:
    """The sensors of a trial."""
    rng = stream(trial.seed, trial.number, "dither")
    if sensors == "ideal":
        all_valid = np.ones(HAND.n_contacts, dtype=np.bool_)

        def ideal(k: int, forces_n: FloatArray) -> tuple[FloatArray, BoolArray]:
            noise = DITHER_N * rng.normal(size=forces_n.size)
            return forces_n.ravel() + noise, all_valid

        return ideal

    scene = sensor_scene(trial.seed)
    row = scene.file.rows[0]
    planned = scene.trial(row, row.objects[0], trial.number)
    samples = int(trial.end_s * RATE_HZ) + 2
    chain = LoopSensors(scene, [planned], np.array([samples]))

    def read(k: int, forces_n: FloatArray) -> tuple[FloatArray, BoolArray]:
        rows = chain.read(np.array([k]), forces_n[None])
        return rows.values[0].ravel(), rows.valid[0]

    return read


@lru_cache(maxsize=2)
def _monitor(model: str) -> GripMonitor:
    """Opened once a process."""
    return holdfast.load(model, live=False)


class HandProgram:
    """Model, controller and the drive's target of one hand. target_n: beyond the wearer, N."""

    def __init__(self, model: str, controller: str) -> None:
        self._monitor = _monitor(model)
        self._monitor.reset()
        card = self._monitor.card
        self._control = controller_for(controller, card, lambda line: None)
        self._tare = Tare(card.preparation, card.n_channels)
        self.model_id = card.model_id
        self.acts = False
        self.commanded_n = 0.0

    def step(
        self,
        k: int,
        values: FloatArray,
        valid: BoolArray,
        opening: bool,
        kept_n: float,
    ) -> float:
        """One sample; returns the target beyond the wearer's grip, N a side.

        kept_n: the target with which it keeps the grip that it has.
        """
        values, valid = self._tare.prepare(values, valid)
        sample = holdfast.Sample(round(k * 1e9 / RATE_HZ), values, valid, k)
        prediction = self._monitor.feed(sample, opening=opening)
        command: holdfast.GripCommand = self._control.step(prediction, values, valid)
        self.acts = prediction.act
        self.commanded_n = command.target_n or 0.0
        if command.mode in ("idle", "yield"):
            return 0.0
        if command.target_n is None:
            return kept_n
        return command.target_n


def answered_run(
    trial: WorldTrial,
    pads: str,
    sensors: str,
    model: str,
    controller: str,
    opening: Opening = "wearer",
) -> Answers:
    """The trial in a hand with holdfast."""
    world = World(trial, pads, opening)
    read = reader(trial, sensors)
    program = HandProgram(model, controller)
    watch = Watch(world)
    log = _Log(Answers(watch.outcome), trial)
    k = 0
    while not watch.over:
        values, valid = read(k, world.forces_n())
        is_told = world.script.opening(world.t_s)
        kept_n = float(world.drive.kept_n[0])
        target_n = program.step(k, values, valid, is_told, kept_n)
        log.take(world, program)
        world.advance(target_n)
        watch.look()
        k += 1
    return log.answers


class _Log:
    """Fills in Answers sample by sample."""

    def __init__(self, answers: Answers, trial: WorldTrial) -> None:
        self.answers = answers
        self._trial = trial
        self._was_tighter = False
        self._quiet_from_s = trial.give_s + trial.numbers["give_s"] + SPARE_S

    def take(self, world: World, program: HandProgram) -> None:
        """One sample, before the world goes on."""
        trial = self._trial
        t_s = world.t_s
        if t_s < trial.give_s:
            return
        found = self.answers
        wearers_n = world.script.own_n(t_s)
        tighter = bool(program.commanded_n > wearers_n + TIGHTER_N)
        found.most_n = max(found.most_n, program.commanded_n)
        if t_s < trial.act_s:
            found.earlier = found.earlier or tighter
        elif t_s < trial.open_s:
            found.called = found.called or tighter or program.acts
        elif program.commanded_n > 0.0:
            found.released_s = t_s - trial.open_s
        self._count(t_s, tighter)

    def _count(self, t_s: float, tighter: bool) -> None:
        """Tightenings in quiet: before the event, or in a hold at any time."""
        quiet = t_s >= self._quiet_from_s
        if self._trial.kind not in HOLDS:
            quiet = quiet and t_s < self._trial.act_s
        if quiet:
            self.answers.quiet_s += 1.0 / RATE_HZ
            self.answers.tightenings += int(tighter and not self._was_tighter)
        self._was_tighter = tighter
