"""A session: trials from one source, one after another, by the operator's keys.

Between trials nothing is recorded. In a trial the k-th sample is due at start + k periods, as in
holdfast/live/loop.py. A sample that could not be read in time is a gap in `sequence`, and so is a
repeated reading; nothing is filled in, moved or sorted. A clock that jumps by a second or more ends
the trial as interrupted. Where the source or its scene ends, a trial is kept only if it is
complete: the hand closed and was empty again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.core.contract import FloatArray
from holdfast.core.errors import EmptyRecording, TimeError
from holdfast.core.reading import Json
from holdfast.core.source import Source, SourceReading
from holdfast.core.trial_layout import META
from holdfast.core.writing import write_whole
from holdfast.drivers.replay import PacedReplay
from holdfast.edge_runtime.intent import IntentMonitor
from holdfast.live.loop import ANOTHER_CLOCK_NS, Stamps
from holdfast.sessions.recorder.about import Quality, in_words
from holdfast.sessions.recorder.camera import Beside
from holdfast.sessions.recorder.folder import (
    INTERRUPTED,
    KEPT,
    REDONE,
    discard,
    new_trial,
)
from holdfast.sessions.recorder.keys import HELP_READY, HELP_TRIAL, Keys
from holdfast.sessions.recorder.labels import MARKS, read_meta
from holdfast.sessions.recorder.protocol import Task
from holdfast.sessions.recorder.trial import ClosedTrial, TrialRecorder

READY_WAIT_S = 0.1
CAMERA_EVERY = 30
"""Samples between checks of the camera's process."""
TIME_OVER, SOURCE_OVER = "time over", "source over"


@dataclass(frozen=True)
class SessionOptions:
    """Options of a session.

    seconds: length of a trial; None: until a key. at_once: begin a trial without a key. endless:
    the source has no end of its own.
    """

    root: Path
    person: str
    rate_hz: float
    seconds: float | None
    at_once: bool
    mass_g: dict[str, float]
    endless: bool = False

    @property
    def only_a_key_ends(self) -> bool:
        """Whether a trial goes on until a key is pressed."""
        return self.endless and self.seconds is None


def show_nothing(trial: TrialRecorder, measured: SourceReading, now_ns: int) -> None:
    """For sessions without a terminal."""


def announce_nothing(task: str, left: int) -> None:
    """For sessions without a live page."""


HostClock = Callable[[], int]
"""CLOCK_MONOTONIC, ns, which also stamps a camera's frames."""
Show = Callable[[TrialRecorder, SourceReading, int], None]
Announce = Callable[[str, int], None]
"""Gets the next trial in words, and how many are left with it."""


class Session:
    """Records the trials of one run.

    about: content of every trial's meta.json. truth: events of a scene between two times. show:
    gets every sample of a trial when it is written, and must return at once. intent: the wearer's
    own command, recorded beside the samples. announce: gets each
    trial before it begins.
    """

    def __init__(
        self,
        options: SessionOptions,
        source: Source,
        clock: Any,
        keys: Keys,
        say: Callable[[str], None],
        *,
        bias: FloatArray,
        about: Json,
        camera: Beside | None = None,
        intent: IntentMonitor | None = None,
        truth: Callable[[int, int], list[Json]] | None = None,
        show: Show = show_nothing,
        announce: Announce = announce_nothing,
        host_ns: HostClock = time.monotonic_ns,
    ) -> None:
        self.options, self.source, self.clock = options, source, clock
        self.keys, self.say = keys, say
        self.bias, self.about, self.camera, self.truth, self.show = (
            bias,
            about,
            camera,
            truth,
            show,
        )
        self.host_ns, self.announce = host_ns, announce
        self.period_ns = 1e9 / options.rate_hz
        self.intent, self.kept = intent, 0
        self._last: tuple[Path, Task] | None = None

    def run(self, tasks: Sequence[Task], stopped: Callable[[], bool]) -> int:
        """Record the tasks in order; returns the number of trials kept.

        Raises the errors of the source and the disk.
        """
        still = list(tasks)
        while still and not stopped():
            self.say(
                f"next: {in_words_of(still[0])} ({len(still)} left){self._help_ready}"
            )
            self.announce(in_words_of(still[0]), len(still))
            begins = "begin" if self.options.at_once else self._ready(stopped)
            if begins == "stop":
                break
            if begins == "redo":
                self._discard_last(still)
                continue
            outcome = self._record(still[0], stopped)
            if self._last is not None:
                still.pop(0)
            elif outcome in (TIME_OVER, SOURCE_OVER) and self.options.at_once:
                raise EmptyRecording(
                    "a trial cannot be kept",
                    cause="the line above",
                    next_step="use longer trials",
                )
            if outcome in ("stop", "signal"):
                break
        return self.kept

    @property
    def _help_ready(self) -> str:
        """The keys between trials, where one is needed."""
        return "" if self.options.at_once else f"; {HELP_READY}"

    def _ready(self, stopped: Callable[[], bool]) -> str:
        """The next key of begin, redo or stop."""
        while not stopped():
            if self.keys.closed:
                self.say(
                    "no key can be pressed any more; --at-once begins trials without a key"
                )
                return "stop"
            key = self.keys.pressed(READY_WAIT_S)
            if key in ("begin", "redo", "stop"):
                return key
        return "stop"

    def _discard_last(self, still: list[Task]) -> None:
        if self._last is None:
            self.say("this session has no trial to repeat yet")
            return
        folder, task = self._last
        self.say(f"moved to {discard(self.options.root, self.options.person, folder)}")
        still.insert(0, task)
        self.kept, self._last = self.kept - 1, None

    # -- one trial

    def _record(self, task: Task, stopped: Callable[[], bool]) -> str:
        """Record one trial; returns how it ended.

        That is keep, redo, stop, signal, TIME_OVER or SOURCE_OVER.
        """
        self._last = None
        folder = new_trial(self.options.root, self.options.person, task)
        self._write_mass(folder, task)
        try:
            if self.camera is not None:
                self.camera.start(folder)
            trial = self._open(folder, task)
        except BaseException:
            if self.camera is not None:
                self.camera.stop()
            discard(self.options.root, self.options.person, folder)
            raise
        try:
            self.say(f"recording {folder.relative_to(self.options.root)}; {HELP_TRIAL}")
            outcome = self._samples(trial, stopped)
            self._end(trial, task, outcome)
        except BaseException as error:
            if self.camera is not None:
                self.camera.stop()
            trial.give_up(INTERRUPTED, str(error) or type(error).__name__)
            raise
        return outcome

    def _open(self, folder: Path, task: Task) -> TrialRecorder:
        if isinstance(self.source, PacedReplay):
            self.source.begin_anew()
        about = {
            "person": self.options.person,
            "object": task.thing,
            "action": task.action,
            "style": task.style,
            "started_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            **self.about,
        }
        quality = Quality(self.bias, self.period_ns, self.source.unit)
        after_ns = self.host_ns() - self.clock.now_ns()
        return TrialRecorder(
            folder, self.source.n_channels, about, quality, after_ns, self.intent
        )

    def _samples(self, trial: TrialRecorder, stopped: Callable[[], bool]) -> str:
        stamps, start_ns, turn = Stamps(self.period_ns), self.clock.now_ns(), 0
        end_ns = (
            None
            if self.options.seconds is None
            else start_ns + round(1e9 * self.options.seconds)
        )
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
            trial.write_intent()
            self.show(trial, measured, now_ns)
            key = self.keys.pressed()
            if key in ("keep", "redo", "stop"):
                return key
            if key in MARKS and trial.started:
                self.say(
                    f"{key.replace('_', ' ')} at {trial.mark(key, self.clock.now_ns()):.3f} s"
                )
            if self.keys.closed and self.options.only_a_key_ends:
                self.say(
                    "no key can be pressed any more; --seconds ends trials without a key"
                )
                return "signal"
            if self.camera is not None and turn % CAMERA_EVERY == 0:
                self._look_at_camera(trial, self.camera)
            turn += 1
            missed = max(
                0, int((self.clock.now_ns() - start_ns) / self.period_ns) - turn
            )
            trial.quality.lost += missed
            turn += missed
        return "signal"

    def _look_at_camera(self, trial: TrialRecorder, camera: Beside) -> None:
        why = camera.lost()
        if why:
            trial.note({"t_s": trial.t_s, "event": "camera_lost", "why": why})
            self.say(f"the camera failed, the hand is still recorded: {why}")

    def _end(self, trial: TrialRecorder, task: Task, outcome: str) -> None:
        filmed: Json | None = None
        if self.camera is not None:
            self._look_at_camera(trial, self.camera)
            filmed = self.camera.stop()
        events = (
            self.truth(*trial.span_ns)
            if self.truth is not None and trial.started
            else None
        )
        for event in events or ():
            trial.note(event)
        over = "the scene ended" if _is_over(events, trial) else ""
        over = "the source ended" if outcome == SOURCE_OVER else over
        state = {"redo": REDONE, "signal": INTERRUPTED}.get(outcome, KEPT)
        closed = trial.close(state, over, camera=filmed)
        self._report(closed, filmed or {})
        if closed.state == REDONE:
            self.say(
                f"moved to {discard(self.options.root, self.options.person, trial.folder)}"
            )
        if closed.state == KEPT:
            self.kept, self._last = self.kept + 1, (trial.folder, task)

    def _report(self, closed: ClosedTrial, camera: Json) -> None:
        """Tell the operator how a trial ended."""
        self.say(f"{closed.state}: {in_words(closed.quality)}")
        if closed.why and closed.state == INTERRUPTED:
            self.say(f"not kept, it will be recorded again: {closed.why}")
        if camera.get("void"):
            self.say(f"this trial has no camera recording: {camera['void']}")
        if camera.get("doubt"):
            self.say(
                f"warning: the camera's tags: {camera['doubt']}; the recording is kept"
            )

    def _write_mass(self, folder: Path, task: Task) -> None:
        """Write the card's mass to the object's meta.json; its other entries stay."""
        if task.thing in self.options.mass_g:
            home = folder.parent.parent
            meta = read_meta(home) | {"mass_g": self.options.mass_g[task.thing]}
            write_whole(home / META, json.dumps(meta) + "\n")


def _is_over(events: list[Json] | None, trial: TrialRecorder) -> bool:
    """Whether a scene's last phase ended before the trial's last sample; events None: no scene."""
    return events is not None and all(
        one["t1_s"] < trial.t_s for one in events if "label" in one
    )


def _require_one_clock(trial: TrialRecorder, trouble: str, t_ns: int) -> None:
    """Raise TimeError where time stamps jump by a second or more, as after a suspend."""
    if trouble == "restarts" or (
        trial.started and t_ns - trial.quality.times_ns[-1] > ANOTHER_CLOCK_NS
    ):
        raise TimeError(
            f"the clock jumped by {1e-9 * (t_ns - trial.quality.times_ns[-1]):+.3f} s in a trial",
            where=trial.folder,
            cause="the machine was suspended, or the source's clock was set",
            next_step="the samples before are kept as interrupted; start again with this trial",
        )


def in_words_of(task: Task) -> str:
    """A trial for people."""
    style = f" ({task.style})" if task.style else ""
    return (
        "the empty hand"
        if task.action == "nothing"
        else f"{task.thing}, {task.action}{style}"
    )
