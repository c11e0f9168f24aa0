"""Scenes behind sim:// and virtual:// URLs, and one that goes on while it is read.

`sim://` is a trial of a scene as a stream. `virtual://..?scene=..` has the field of a trial at
emulated chips, recorded, or stepped as it is read: ROWS_HZ times a second of its own time, as far
as the next sample needs. So the real driver reads, the real file answers, and the answer moves the
emulated drive from that moment on.

The hand in the scene follows the rules of docs/shared-control.md: where no command comes for
EXPIRES_MS, it holds its grip. The physics share a core with the loop, and no time passes for them:
the loop's clock (SceneClock) stands still, so what they cost delays no sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from urllib.parse import parse_qs

import msgspec
import numpy as np
import numpy.typing as npt

from holdfast.core.contract import GripCommand
from holdfast.core.errors import UsageError
from holdfast.core.schema import checked
from holdfast.core.source import SourceUrl
from holdfast.drivers.replay import Replay
from holdfast.drivers.virtual.virtual_hand import Track
from holdfast.edge_runtime.supervisor import EXPIRES_MS
from holdfast.live.running import RunClock
from holdfast.simulation.effects.effect import EFFECT_MODULES
from holdfast.simulation.loop.drive import Actuator, Drive
from holdfast.simulation.loop.people import Habits
from holdfast.simulation.loop.physics import HandsAndObjects, Spans
from holdfast.simulation.loop.sensing import LoopSensors
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene, SimulatedTrial
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.simulation.scenes.script_times import grid_of
from holdfast.simulation.scenes.truth import Truth, truth_of

FIELD_HZ = 1000.0
"""Rate of a recorded field for the virtual chips, each of which converts it at its time."""
ROWS_HZ = 300.0
STEP_S = 1.0 / ROWS_HZ
"""One step a row: coarser than a recorded scene's, so that a small machine keeps up."""
Still = Callable[[], AbstractContextManager[None]]
COPIES = 2
"""The trial twice: numpy sums a batch of one in another order than a larger one."""
USUAL_SCENE = "falling-bottle"
"""Where the source names none: what is seen first is an object that is kept."""


# -- trials of a scene


# a run needs one trial, and a long one is large
@lru_cache(maxsize=1)
def trial_of(source: SourceUrl) -> tuple[Scene, SimulatedTrial]:
    """The trial of a sim:// URL, or of a virtual:// one at 1 kHz. Raises CardError, UsageError."""
    if source.scheme == "virtual":
        scene, trial = planned_trial(source, FIELD_HZ)
    else:
        card = read_scene_file(source.name, rate_hz=source.options.rate_hz)
        scene = Scene(card, source.options.seed)
        trial = _chosen(scene, source.options.trial)
    return scene, scene.run_together([trial])[0]


def _chosen(scene: Scene, number: int) -> PlannedTrial:
    trials = scene.trials()
    if number >= len(trials):
        what = f"scene {scene.file.name}: no trial {number}"
        raise UsageError(what, next_step=f"0..{len(trials) - 1}")
    return trials[number]


def simulated_stream(source: SourceUrl) -> Replay:
    """The trial of a sim:// URL as a stream. Raises CardError, UsageError."""
    scene, trial = trial_of(source)
    signal, _, _ = scene.join([trial])
    t_ns = np.round(signal.t_s * 1e9).astype(np.int64)
    values = signal.values.reshape(len(t_ns), -1)
    hand = scene.file.hand
    return Replay(
        t_ns, values, signal.valid, scene.file.rate_hz, signal.unit, hand=hand
    )


def scene_truth(source: SourceUrl) -> Truth | None:
    """The truth of the trial behind sim:// or virtual://; None where no scene is."""
    if source.scheme == "virtual" and not source.options.scene:
        return None
    return trial_of(source)[1].truth


def field_of(source: SourceUrl, report: Callable[[str], None]) -> Track:
    """The field of a scene's trial at the chips of a virtual hand.

    It takes seconds, so `report` gets a line. Raises CardError, UsageError.
    """
    report(f"simulating scene {source.options.scene}")
    signal = trial_of(source)[1].signal
    return Track(signal.t_s, signal.values)


def planned_trial(
    source: SourceUrl, rate_hz: float, step_s: float | None = None
) -> tuple[Scene, PlannedTrial]:
    """The trial of a virtual:// URL, in uT and without the effects of chip and bus.

    rate_hz: of its field. Raises CardError, UsageError.
    """
    options = source.options
    file_rate_hz = rate_hz if Path(options.scene).is_file() else None
    card = read_scene_file(options.scene, rate_hz=file_rate_hz)

    # the virtual chip adds its own noise and quantisation, which must not count twice
    effects: dict[str, dict[str, float]] = {"dipole": {}}
    for effect, values in card.effects.items():
        if EFFECT_MODULES[effect] != "effects.chip":
            effects[effect] = values

    steps = card.step_s if step_s is None else step_s
    field = replace(card, rate_hz=rate_hz, unit="uT", effects=effects, step_s=steps)
    scene = Scene(field, options.seed)
    return scene, _chosen(scene, options.trial)


# -- a scene that goes on while it is read


class SceneClock(RunClock):
    """Real time, but for a scene that is computed in the loop: the clock stands still meanwhile.

    No such time passes on a real hand. It is made up for where the loop would wait, so a machine
    with time to spare keeps to real time, and a slower one takes longer without being late.
    """

    def __init__(self) -> None:
        self._behind_ns = 0

    def now_ns(self) -> int:
        """ns; behind the machine's clock by what is not yet made up for."""
        return super().now_ns() - self._behind_ns

    def wait_until(self, t_ns: int) -> None:
        """Go on to t_ns: first by what the clock is behind, then by waiting."""
        # waiting time is free, so what the scene has cost is paid back out of it
        remaining_ns = max(t_ns - self.now_ns(), 0)
        self._behind_ns -= min(remaining_ns, self._behind_ns)
        super().wait_until(t_ns)

    @contextmanager
    def still(self) -> Iterator[None]:
        """A block that takes no time."""
        # the machine's clock, because this one stands still meanwhile
        began_ns = super().now_ns()
        try:
            yield
        finally:
            self._behind_ns += super().now_ns() - began_ns


@dataclass(frozen=True)
class SceneOutcome:
    """What became of the object. until_s: how much of the scene was played.

    kept: it is in the hand at that time. wearers_n: the grip that the wearer's command asks for;
    strongest_n: the largest grip; both of either side.
    """

    kept: bool
    until_s: float
    wearers_n: float
    strongest_n: float
    truth: Truth

    def line(self) -> str:
        """What became of the object, in one line."""
        end = f"the object is in the hand after {self.until_s:.1f} s"
        if self.truth.contact_s is None:
            end = "the hand has not closed yet"
        elif not self.kept:
            end = f"the object left the hand at {self.truth.contact_lost_s or self.until_s:.2f} s"
        grip = f"grip {self.wearers_n:.1f} N, at most {self.strongest_n:.1f} N"
        return f"scene: {end}; it slid {self.truth.slip_mm:.1f} mm; {grip}"


class LiveScene:
    """A trial of a scene as a field source that is stepped as it is read.

    began_ns is to be set to the start of the scene on the clock of the commands. still: a block in
    which that clock stands still.
    """

    def __init__(
        self,
        scene: Scene,
        trial: PlannedTrial,
        drive: Drive,
        still: Still = nullcontext,
    ) -> None:
        trials = [trial] * COPIES
        self.trial = trial
        self._still = still
        self.began_ns = 0

        grid = grid_of(trial, ROWS_HZ, STEP_S)
        rows = grid.n_samples
        begin = round(grid.start_s * ROWS_HZ)
        last = int(grid.sample[-1])
        spans = Spans(_for_all(0), _for_all(begin), _for_all(last), _for_all(rows))

        self._drive = Actuator(drive, trials)
        # commands may slow the drive down, and never make it faster than it is
        self._fastest_n_s = self._drive.fastest_n_s
        settings = scene.step_settings_of(trials)
        self._world = HandsAndObjects(trials, settings, spans, self._drive, Habits())
        self._sensors = LoopSensors(scene, trials, spans.counts)
        self._periods = spans.periods
        self._row = 0

        self.n_sensors = trial.hand.n_sensors
        # the whole field is reserved at once, and each row filled when it is reached
        self._field_ut = np.zeros((rows, self.n_sensors, 3))
        self._track = Track(np.arange(rows) / ROWS_HZ, self._field_ut)
        self._forces_n = np.zeros((rows, *self._world.forces_n.shape[1:]))
        self._position_m = np.zeros((rows, 3))

        self._command: GripCommand | None = None
        self._commanded_s = -math.inf
        self._strongest_n = 0.0
        # the first reading needs a field before the first step
        self._keep_row()

    @property
    def ended(self) -> bool:
        """Whether its last row is reached."""
        return self._row >= self._periods

    def at(self, now_s: float, sensor: int) -> list[float]:
        """x, y, z of one sensor (0 .. S - 1) in uT, now_s after the scene began."""
        self.advance(now_s)
        return self._track.at(now_s, sensor)

    def obey(self, command: GripCommand, now_ns: int) -> None:
        """Take a command, which acts from now on."""
        now_s = 1e-9 * (now_ns - self.began_ns)
        # up to this moment the hand still follows the command before
        self.advance(now_s)
        self._command = command
        self._commanded_s = now_s
        if command.slew_n_s > 0.0:
            self._drive.fastest_n_s = np.minimum(self._fastest_n_s, command.slew_n_s)

    def advance(self, until_s: float) -> None:
        """Step the scene to the first row at or after until_s, or to its end."""
        last = min(math.ceil(until_s * ROWS_HZ), self._periods)
        if self._row >= last:
            return
        with self._still():
            while self._row < last:
                targets_n = np.full(COPIES, self._next_target_n())
                self._world.advance(self._row, targets_n)
                self._row += 1
                self._keep_row()
            # a reading after the end of the scene finds its last field
            if last == self._periods:
                self._field_ut[last:] = self._field_ut[last]

    def outcome(self) -> SceneOutcome:
        """What has become of the object so far."""
        # only rows that were stepped: the rest of the scene has not happened
        n = self._row + 1
        motion = self._world.motion(0, self._forces_n[:n], self._position_m[:n])
        return SceneOutcome(
            # a run that is stopped at once has no motion yet
            kept=bool(motion.gripped[-1:].any()),
            until_s=self._row / ROWS_HZ,
            wearers_n=self.trial.grip_n,
            strongest_n=self._strongest_n,
            truth=truth_of(self.trial, motion),
        )

    def _keep_row(self) -> None:
        k = self._row
        forces = self._world.forces_n
        readings = self._sensors.read(_for_all(k), forces)
        # the copies are alike: the first one is the hand that is read
        self._field_ut[k] = readings.values[0]
        self._forces_n[k] = forces[0]
        self._position_m[k] = self._world.position_m[0]
        self._strongest_n = max(self._strongest_n, float(self._drive.grip_n[0]))

    def _next_target_n(self) -> float:
        """The target of the drive at this row, N a side; 0 for none: the grip is the wearer's."""
        command = self._command
        if command is None:
            return 0.0
        # on the scene's clock, as the deadline of a real hand runs on its own
        silent_s = self._row / ROWS_HZ - self._commanded_s
        expired = silent_s > 1e-3 * EXPIRES_MS
        # a live command to idle or yield gives the grip back to the wearer
        if not expired and command.mode in ("idle", "yield"):
            return 0.0
        # without a target the motor stays where it is: the grip is held
        if expired or command.target_n is None:
            return float(self._drive.kept_n[0])
        return command.target_n


def _for_all(value: int) -> npt.NDArray[np.int64]:
    """The value for each copy of the trial."""
    return np.full(COPIES, value, dtype=np.int64)


def live_scene(
    source: SourceUrl, drive: Drive, still: Still = nullcontext
) -> LiveScene:
    """The scene of a virtual:// URL, or the usual one. Raises UsageError, CardError."""
    if source.scheme != "virtual":
        raise UsageError(
            f"--grip virtual: the source {source.url!r} has no scene whose hand could be moved",
            next_step="--source virtual://ft232h",
        )
    usual = source.options.scene or USUAL_SCENE
    options = msgspec.structs.replace(source.options, scene=usual)
    scene, trial = planned_trial(source._replace(options=options), ROWS_HZ, STEP_S)
    if drive.ceiling_n < trial.grip_n:
        raise UsageError(
            f"--grip virtual: a ceiling of {drive.ceiling_n:g} N is below the {trial.grip_n:.1f} N "
            "with which the scene's hand holds the object",
            next_step=f"ceiling_n={math.ceil(trial.grip_n)} or more",
        )
    return LiveScene(scene, trial, drive, still)


def drive_of(url: str, ceiling_n: float | None = None) -> Drive:
    """The drive of virtual?lag_ms=..&ceiling_n=... Raises UsageError.

    ceiling_n: of the hand; the stricter of both limits counts.
    """
    query = parse_qs(url.partition("?")[2], keep_blank_values=True)
    raw = {key: values[-1] for key, values in query.items()}
    drive = checked(raw, Drive, "--grip virtual", UsageError, strict=False)
    limit_n = min(drive.ceiling_n, ceiling_n or math.inf)
    return msgspec.structs.replace(drive, ceiling_n=limit_n)
