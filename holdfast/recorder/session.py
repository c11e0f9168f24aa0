"""A session: trial after trial from one source, by the operator's keys, each in a folder of its
own.

Between trials nothing is recorded. In a trial the k-th sample is due at start + k periods, as in
edge_runtime/live.py: what could not be read in time is a gap in `sequence`, and so is a reading
that came twice; nothing is invented, moved or put in order afterwards. A clock that jumps by a
second or more ends the trial, which is kept as interrupted. Where the source ends, or the scene
behind it, a trial is kept only if it is complete: the hand closed and was empty again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.paced import Paced
from edge_runtime.contract import FloatArray
from edge_runtime.errors import EmptyRecording, TimeError
from edge_runtime.live import ANOTHER_CLOCK_NS, Measured, Source, Stamps
from edge_runtime.trial_layout import META
from edge_runtime.writing import write_whole
from holdfast.recorder.beside import Beside
from holdfast.recorder.card import Task
from holdfast.recorder.folder import INTERRUPTED, KEPT, REDONE, discard, new_trial
from holdfast.recorder.keys import HELP_READY, HELP_TRIAL, Keys
from holdfast.recorder.labels import MARKS, read_meta
from holdfast.recorder.quality import Quality, in_words
from holdfast.recorder.trial import TrialRecorder

READY_WAIT_S = 0.1
CAMERA_EVERY = 30
"""Between looks at the camera's process, samples."""
TIME_OVER, SOURCE_OVER = "time over", "source over"


@dataclass(frozen=True)
class SessionOptions:
    """What the session is to do. seconds: of a trial, or until a key; at_once: begin without
    one."""

    root: Path
    person: str
    rate_hz: float
    seconds: float | None
    at_once: bool
    mass_g: dict[str, float]


def show_nothing(trial: TrialRecorder, measured: Measured, now_ns: int) -> None:
    """Where there is no terminal to show a trial on."""


HostClock = Callable[[], int]
"""CLOCK_MONOTONIC, ns, by which a camera's frames are stamped too."""
Show = Callable[[TrialRecorder, Measured, int], None]


class Session:
    """about: what every trial's meta.json says. truth: of a scene, for the times of its first and
    last sample.

    show: gets every sample of a trial as it is written, and must return at once.
    """

    def __init__(
        self,
        asked: SessionOptions,
        source: Source,
        clock: Any,
        keys: Keys,
        say: Callable[[str], None],
        *,
        bias: FloatArray,
        about: dict[str, Any],
        camera: Beside | None = None,
        truth: Callable[[int, int], list[dict[str, Any]]] | None = None,
        show: Show = show_nothing,
        host_ns: HostClock = time.monotonic_ns,
    ) -> None:
        self.asked, self.source, self.clock, self.keys, self.say = asked, source, clock, keys, say
        self.bias, self.about, self.camera, self.truth, self.show = bias, about, camera, truth, show
        self.host_ns = host_ns
        self.period_ns = 1e9 / asked.rate_hz
        self.kept = 0
        self._last: tuple[Path, Task] | None = None

    def run(self, tasks: Sequence[Task], stopped: Callable[[], bool]) -> int:
        """Record the tasks in turn; returns how many trials were kept. Raises what the source and
        the disk raise."""
        still = list(tasks)
        while still and not stopped():
            self.say(f"next: {_words(still[0])} ({len(still)} left); {HELP_READY}")
            begins = "begin" if self.asked.at_once else self._ready(stopped)
            if begins == "stop":
                break
            if begins == "redo":
                self._discard_last(still)
                continue
            outcome = self._record(still[0], stopped)
            if self._last is not None:
                still.pop(0)
            elif outcome in (TIME_OVER, SOURCE_OVER) and self.asked.at_once:
                raise EmptyRecording(
                    "a trial that cannot be kept", cause="the line above", next_step="longer trials"
                )
            if outcome in ("stop", "signal"):
                break
        return self.kept

    def _ready(self, stopped: Callable[[], bool]) -> str:
        """begin, redo or stop."""
        while not stopped():
            if self.keys.closed:
                self.say("nobody can press a key here; --at-once begins without")
                return "stop"
            key = self.keys.pressed(READY_WAIT_S)
            if key in ("begin", "redo", "stop"):
                return key
        return "stop"

    def _discard_last(self, still: list[Task]) -> None:
        if self._last is None:
            self.say("there is no trial of this session to do again")
            return
        folder, task = self._last
        self.say(f"moved to {discard(self.asked.root, self.asked.person, folder)}")
        still.insert(0, task)
        self.kept, self._last = self.kept - 1, None

    # -- one trial

    def _record(self, task: Task, stopped: Callable[[], bool]) -> str:
        """One trial from its folder to its figures; how it ended: keep, redo, stop, signal,
        TIME_OVER, SOURCE_OVER."""
        self._last = None
        folder = new_trial(self.asked.root, self.asked.person, task)
        self._write_mass(folder, task)
        try:
            if self.camera is not None:
                self.camera.start(folder)
            trial = self._open(folder, task)
        except BaseException:
            if self.camera is not None:
                self.camera.stop()
            discard(self.asked.root, self.asked.person, folder)
            raise
        try:
            self.say(f"recording {folder.relative_to(self.asked.root)}; {HELP_TRIAL}")
            outcome = self._samples(trial, stopped)
            self._end(trial, task, outcome)
        except BaseException as error:
            if self.camera is not None:
                self.camera.stop()
            trial.give_up(INTERRUPTED, str(error) or type(error).__name__)
            raise
        return outcome

    def _open(self, folder: Path, task: Task) -> TrialRecorder:
        if isinstance(self.source, Paced):
            self.source.begin_anew()
        about = {
            "person": self.asked.person,
            "object": task.thing,
            "action": task.action,
            "style": task.style,
            "started_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            **self.about,
        }
        quality = Quality(self.bias, self.period_ns, self.source.unit)
        return TrialRecorder(
            folder, self.source.n_channels, about, quality, self.host_ns() - self.clock.now_ns()
        )

    def _samples(self, trial: TrialRecorder, stopped: Callable[[], bool]) -> str:
        stamps, start_ns, turn = Stamps(self.period_ns), self.clock.now_ns(), 0
        end_ns = None if self.asked.seconds is None else start_ns + round(1e9 * self.asked.seconds)
        while not stopped():
            self.clock.wait_until(start_ns + round(turn * self.period_ns))
            now_ns = self.clock.now_ns()
            if end_ns is not None and now_ns >= end_ns:
                return TIME_OVER
            measured = self.source.read()
            if measured is None:
                return SOURCE_OVER
            trouble, t_ns = stamps.judge(measured.t_ns)
            _require_one_clock(trial, trouble, t_ns)
            if trouble:
                trial.quality.lost += 1
            else:
                trial.write(t_ns, turn, measured)
            self.show(trial, measured, now_ns)
            key = self.keys.pressed()
            if key in ("keep", "redo", "stop"):
                return key
            if key in MARKS and trial.started:
                self.say(f"{key.replace('_', ' ')} at {trial.mark(key, self.clock.now_ns()):.3f} s")
            if self.camera is not None and turn % CAMERA_EVERY == 0:
                self._look_at_camera(trial, self.camera)
            turn += 1
            missed = max(0, int((self.clock.now_ns() - start_ns) / self.period_ns) - turn)
            trial.quality.lost += missed
            turn += missed
        return "signal"

    def _look_at_camera(self, trial: TrialRecorder, camera: Beside) -> None:
        why = camera.lost()
        if why:
            trial.note({"t_s": trial.t_s, "event": "camera_lost", "why": why})
            self.say(f"the camera is lost, the hand is recorded on: {why}")

    def _end(self, trial: TrialRecorder, task: Task, outcome: str) -> None:
        filmed: dict[str, Any] = {}
        if self.camera is not None:
            self._look_at_camera(trial, self.camera)
            filmed = {"camera": self.camera.stop()}
        events = self.truth(*trial.span_ns) if self.truth is not None and trial.started else None
        for event in events or ():
            trial.note(event)
        over = (
            "the source ended"
            if outcome == SOURCE_OVER
            else "the scene ended"
            if _is_over(events, trial)
            else ""
        )
        state = {"redo": REDONE, "signal": INTERRUPTED}.get(outcome, KEPT)
        told = trial.close(state, over, **filmed)
        self.say(f"{told['state']}: {in_words(told)}")
        if told.get("why") and told["state"] == INTERRUPTED:
            self.say(f"not kept, and to be recorded again: {told['why']}")
        if filmed.get("camera", {}).get("void"):
            self.say(f"no camera part in this trial: {filmed['camera']['void']}")
        if filmed.get("camera", {}).get("doubt"):
            self.say(
                f"warning: the camera's tags: {filmed['camera']['doubt']}; what was recorded is kept"
            )
        if told["state"] == REDONE:
            self.say(f"moved to {discard(self.asked.root, self.asked.person, trial.folder)}")
        if told["state"] == KEPT:
            self.kept, self._last = self.kept + 1, (trial.folder, task)

    def _write_mass(self, folder: Path, task: Task) -> None:
        """The card's mass into the object's meta.json; what else a person wrote there stays."""
        if task.thing in self.asked.mass_g:
            home = folder.parent.parent
            told = read_meta(home) | {"mass_g": self.asked.mass_g[task.thing]}
            write_whole(home / META, json.dumps(told) + "\n")


def _is_over(events: list[dict[str, Any]] | None, trial: TrialRecorder) -> bool:
    """Whether a scene's last phase ended before the trial's last sample; None: there is no
    scene."""
    return events is not None and all(one["t1_s"] < trial.t_s for one in events if "label" in one)


def _require_one_clock(trial: TrialRecorder, trouble: str, t_ns: int) -> None:
    """Raise TimeError where stamps jump by a second or more: another clock, or a machine that
    slept."""
    if trouble == "restarts" or (
        trial.started and t_ns - trial.quality.times_ns[-1] > ANOTHER_CLOCK_NS
    ):
        raise TimeError(
            f"the clock jumped by {1e-9 * (t_ns - trial.quality.times_ns[-1]):+.3f} s in mid-trial",
            where=trial.folder,
            cause="the machine slept or stood still, or the source's clock was set",
            next_step="what came before is kept as interrupted; start again, the trial comes up once more",
        )


def _words(task: Task) -> str:
    style = f" ({task.style})" if task.style else ""
    return "the empty hand" if task.action == "nothing" else f"{task.thing}, {task.action}{style}"
