"""A scene that goes on while it is read: the hand in it follows the commands that it gets.

The scene behind virtual://..?scene=.. is stepped ROWS_HZ times a second of its own time, as far as
the next sample needs, and its field goes to the emulated chips. So the real driver reads, the real
file answers, and the answer moves the emulated drive from that moment on.

The hand in the scene follows the rules of docs/shared-control.md: where no command comes for
EXPIRES_MS, it holds its grip. The physics share a core with the loop, and no time passes for them:
the loop's clock (SceneClock) stands still, so what they cost delays no sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, fields
from urllib.parse import parse_qs

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import UsageError
from holdfast.edge_runtime.supervisor import EXPIRES_MS, GripCommand
from holdfast.live.running import RunClock
from holdfast.live.scene_source import planned_scene
from holdfast.simulation.drive import Actuator, Drive
from holdfast.simulation.loop_people import Habits
from holdfast.simulation.loop_physics import HandsAndObjects, Spans
from holdfast.simulation.loop_sensing import LoopSensors
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.scene import Scene
from holdfast.simulation.script_times import grid_of
from holdfast.simulation.stepper import TrialMotion
from holdfast.simulation.truth import Truth, truth_of

ROWS_HZ = 300.0
STEP_S = 1.0 / ROWS_HZ
"""One step a row: coarser than a recorded scene's, so that a small machine keeps up."""
Still = Callable[[], AbstractContextManager[None]]
COPIES = 2
"""The trial twice: numpy sums a batch of one in another order than a larger one."""
LARGEST = 1e4
"""Of a figure of the virtual drive."""


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
        """One line for people."""
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

        grid = grid_of(trial, ROWS_HZ, STEP_S)
        rows = grid.n_samples
        begin = round(grid.start_s * ROWS_HZ)
        last = int(grid.sample[-1])
        spans = Spans(_for_all(0), _for_all(begin), _for_all(last), _for_all(rows))

        self._drive = Actuator(drive, trials)
        # commands may slow the drive down, and never make it faster than it is
        self._fastest_n_s = self._drive.fastest_n_s
        _require_strength(drive, trial)

        settings = scene.step_settings_of(trials)
        self._world = HandsAndObjects(trials, settings, spans, self._drive, Habits())
        self._sensors = LoopSensors(scene, trials, spans.counts)
        self._periods = spans.periods
        self._row = 0
        self.began_ns = 0

        contacts = self._world.forces_n.shape[1]
        self.n_sensors = trial.hand.n_sensors
        # the whole field is reserved at once, and each row filled when it is reached
        self._field_ut = np.zeros((rows, self.n_sensors, 3))
        self._t_s = np.arange(rows) / ROWS_HZ
        self._forces_n = np.zeros((rows, contacts, 3))
        self._position_m = np.zeros((rows, 3))

        self._wearers_n = trial.grip_n
        self._command: GripCommand | None = None
        self._strongest_n = 0.0
        self._commanded_s = -math.inf
        # the first reading needs a field before the first step
        self._keep_row()

    def at(self, now_s: float, sensor: int) -> list[float]:
        """x, y, z of one sensor (0 .. S - 1) in uT, now_s after the scene began."""
        self.advance(now_s)
        # the rows around this time alone: the field grows while it is read
        first = max(int(now_s * ROWS_HZ) - 1, 0)
        near = slice(min(first, len(self._t_s) - 1), first + 4)
        field_ut = self._field_ut[near, sensor]
        return [float(np.interp(now_s, self._t_s[near], one)) for one in field_ut.T]

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
        if self._row < last:
            with self._still():
                self._step_to(last)

    def _step_to(self, last: int) -> None:
        while self._row < last:
            self._world.advance(self._row, np.full(COPIES, self._next_target_n()))
            self._row += 1
            self._keep_row()
            # a reading after the end of the scene finds its last field
            if self._row == self._periods:
                self._field_ut[self._row :] = self._field_ut[self._row]

    def outcome(self) -> SceneOutcome:
        """What has become of the object so far."""
        # only rows that were stepped: the rest of the scene has not happened
        n = self._row + 1
        forces_n = self._forces_n[:n]
        position_m = self._position_m[:n]
        motion: TrialMotion = self._world.motion(0, forces_n, position_m)
        # a run that is stopped at once has no motion yet
        kept = bool(motion.gripped[-1]) if len(motion.gripped) else False

        return SceneOutcome(
            kept=kept,
            until_s=self._row / ROWS_HZ,
            wearers_n=self._wearers_n,
            strongest_n=self._strongest_n,
            truth=truth_of(self.trial, motion),
        )

    def _keep_row(self) -> None:
        k = self._row
        forces = self._world.forces_n
        readings, _ = self._sensors.read(_for_all(k), forces)
        # the copies are alike: the first one is the hand that is read
        self._field_ut[k] = readings.values[0]
        self._forces_n[k] = forces[0]
        self._position_m[k] = self._world.position_m[0]
        self._strongest_n = max(self._strongest_n, float(self._drive.grip_n[0]))

    def _next_target_n(self) -> float:
        """The target of the drive at this row, N a side; 0 for none: the grip is the wearer's."""
        command = self._command
        row_s = self._row / ROWS_HZ
        if command is None:
            return 0.0
        # on the scene's clock, as the deadline of a real hand runs on its own
        expired = row_s - self._commanded_s > 1e-3 * EXPIRES_MS
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


def live_scene(url: str, drive: Drive, still: Still = nullcontext) -> LiveScene:
    """The scene of a virtual:// URL. Raises UsageError where it has none, CardError."""
    planned = planned_scene(url, ROWS_HZ, STEP_S)
    if planned is None:
        raise UsageError(
            f"--grip virtual: the source {url!r} has no scene whose hand could be moved",
            next_step="--source 'virtual://ft232h?scene=pull-soft-ball&seed=1'",
        )
    return LiveScene(*planned, drive, still)


def _require_strength(drive: Drive, trial: PlannedTrial) -> None:
    if drive.ceiling_n < trial.grip_n:
        raise UsageError(
            f"--grip virtual: a ceiling of {drive.ceiling_n:g} N is below the {trial.grip_n:.1f} N "
            "with which the scene's hand holds the object",
            next_step=f"ceiling_n={math.ceil(trial.grip_n)} or more",
        )


def drive_of(url: str) -> Drive:
    """The drive of virtual?lag_ms=..&ceiling_n=... Raises UsageError."""
    known = [one.name for one in fields(Drive)]
    figures = {}
    query = url.partition("?")[2]
    for key, values in parse_qs(query, keep_blank_values=True).items():
        if key not in known:
            raise UsageError(
                f"--grip virtual: {key[:40]!r} is not known",
                next_step=f"allowed: {', '.join(known)}",
            )
        # a drive without lag or play is an ideal one; one without force or speed is none
        may_be_zero = key in ("lag_ms", "backlash_mm")
        figures[key] = _figure(key, values[-1], may_be_zero=may_be_zero)

    return Drive(**figures)


def _figure(key: str, text: str, *, may_be_zero: bool) -> float:
    try:
        figure = float(text)
    except ValueError:
        # refused below, like every number outside its range
        figure = -1.0

    if not 0.0 <= figure <= LARGEST or (not figure and not may_be_zero):
        bound = "from 0" if may_be_zero else "above 0"
        what = f"--grip virtual: {key}={text[:40]!r} is not a number {bound} to {LARGEST:g}"
        raise UsageError(what, next_step=f"{key}=50")

    return figure
