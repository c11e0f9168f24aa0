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
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from holdfast.core.contract import FloatArray, Json
from holdfast.core.errors import EmptyRecording, TimeError
from holdfast.core.hand_card import HandCard
from holdfast.core.source import Source, Turns
from holdfast.core.trial_layout import META
from holdfast.core.writing import write_whole
from holdfast.drivers.replay import PacedReplay
from holdfast.edge_runtime.wearer import IntentMonitor
from holdfast.live.loop import ANOTHER_CLOCK_NS, Stamps
from holdfast.sessions.camera import CameraProcess
from holdfast.sessions.recorder.folder import (
    INTERRUPTED,
    KEPT,
    REDONE,
    discard,
    new_trial,
)
from holdfast.sessions.recorder.labels import MARKS, TruthEvents, read_meta
from holdfast.sessions.recorder.plan import NOTHING, RecordOptions, Task
from holdfast.sessions.recorder.terminal import (
    HELP_READY,
    HELP_TRIAL,
    KEYS,
    TEXT,
    TEXT_IS_NO_KEY,
    RunContext,
)
from holdfast.sessions.recorder.trial import Quality, TrialRecorder

READY_WAIT_S = 0.1
"""Between trials: how long a look at the keys waits, so a signal is seen at once."""
TIME_OVER = "time over"
"""The trial has lasted for --seconds."""
SOURCE_OVER = "source over"
"""The source has no further sample."""
SIGNAL = "signal"
"""SIGINT, SIGTERM or SIGHUP, or no key can be pressed any more."""
NO_KEY = "no key can be pressed any more"


@dataclass
class Session:
    """Records the trials of one run.

    about: content of every trial's meta.json. mass_g: of objects, as the protocol gives it. intent:
    the wearer's command, recorded beside the samples. truth: events of a scene between two times.
    hand: its card, where one is known.
    """

    options: RecordOptions
    context: RunContext
    source: Source
    rate_hz: float
    bias: FloatArray
    about: Json
    mass_g: dict[str, float] = field(default_factory=dict)
    intent: IntentMonitor | None = None
    truth: TruthEvents | None = None
    hand: HandCard | None = None
    kept: int = 0
    _last: tuple[Path, Task] | None = None

    def __post_init__(self) -> None:
        self.clock = self.context.clock
        self.keys = self.context.keys
        self.report = self.context.display.report
        self.stopped = self.context.stopped
        self.period_ns = 1e9 / self.rate_hz
        self.camera = CameraProcess(self.options)

    def run(self, tasks: Iterable[Task]) -> int:
        """Record the tasks in order; returns the number of trials kept.

        Raises the errors of the source and the disk.
        """
        left = list(tasks)
        at_once = self.options.at_once
        while left and not self.stopped():
            task = task_in_words(left[0])
            # A key before the question belongs to what was on the screen then.
            self.keys.drop()
            help_ready = "" if at_once else f"; {HELP_READY}"
            self.report(f"next: {task} ({len(left)} left){help_ready}")
            key = "begin" if at_once else self._wait_for_key()
            if key == "stop":
                break
            # Between trials, redo takes back the one that was just kept.
            if key == "redo":
                self._discard_last(left)
                continue
            outcome = self._record(left[0])
            if self._last is not None:
                # Kept: only then is the task off the list.
                left.pop(0)
            elif at_once and outcome in (TIME_OVER, SOURCE_OVER):
                # No operator looks on: the same would happen again without end.
                raise EmptyRecording(
                    "a trial cannot be kept",
                    cause="the line above",
                    next_step="use longer trials",
                )
            if outcome in ("stop", SIGNAL):
                break
        return self.kept

    def _wait_for_key(self) -> str:
        """The next key of begin, redo or stop."""
        key = ""
        while key not in ("begin", "redo", "stop"):
            if self.keys.closed:
                self.report(f"{NO_KEY}; --at-once begins trials without a key")
            if self.keys.closed or self.stopped():
                return "stop"
            letter = self.keys.choice(KEYS, READY_WAIT_S)
            key = KEYS.get(letter, "")
            if letter == TEXT:
                self.report(TEXT_IS_NO_KEY)
        return key

    def _discard_last(self, left: list[Task]) -> None:
        if self._last is None:
            self.report("this session has no trial to repeat yet")
            return
        folder, task = self._last
        self._discard(folder)
        left.insert(0, task)
        self.kept = self.kept - 1
        self._last = None

    def _discard(self, folder: Path) -> None:
        moved = discard(self.options.out, self.options.person, folder)
        self.report(f"moved to {moved}")

    # -- one trial

    def _record(self, task: Task) -> str:
        """Record one trial; returns how it ended.

        That is keep, redo, stop, SIGNAL, TIME_OVER or SOURCE_OVER.
        """
        self._last = None
        out = self.options.out
        folder = new_trial(out, self.options.person, task)
        # While the object is at hand: the protocol's mass goes into the object's meta.json. Without
        # its mass no weight is learned.
        if task.object in self.mass_g:
            home = folder.parent.parent
            # What a person wrote there, such as a colour, is not the recorder's to remove.
            meta = read_meta(home) | {"mass_g": self.mass_g[task.object]}
            write_whole(home / META, json.dumps(meta) + "\n")
        trial = None
        try:
            self.camera.start(folder)
            trial = self._open(folder, task)
            self.keys.drop()
            self.report(f"recording {folder.relative_to(out)}; {HELP_TRIAL}")
            outcome = self._samples(trial)
            self._end(trial, task, outcome)
        except BaseException as error:
            # Also for an interrupt: what was written stays, and the trial says how it ended.
            self.camera.stop()
            if trial is None:
                # Nothing was recorded: the folder is no trial, and its number is free again.
                discard(out, self.options.person, folder)
            else:
                trial.give_up(str(error) or type(error).__name__)
            raise
        return outcome

    def _open(self, folder: Path, task: Task) -> TrialRecorder:
        # A recording comes again from its start with every trial; a hand goes on.
        if isinstance(self.source, PacedReplay):
            self.source.begin_anew()
        about = {
            "person": self.options.person,
            "object": task.object,
            "action": task.action,
            "style": task.style,
            "started_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            **self.about,
        }
        quality = Quality(self.bias, self.period_ns, self.source.unit)
        after_ns = self.context.host_ns() - self.clock.now_ns()

        return TrialRecorder(
            folder,
            self.source.n_channels,
            about,
            quality,
            after_ns,
            self.intent,
            self.hand,
        )

    def _samples(self, trial: TrialRecorder) -> str:
        """Record until a key, a signal, the time or the source ends the trial."""
        stamps = Stamps(self.period_ns)
        turns = Turns(self.source, self.clock, self.period_ns)
        seconds = self.options.seconds
        longest_ns = float("inf") if seconds is None else round(1e9 * seconds)
        while not self.stopped():
            turns.wait()
            now_ns = self.clock.now_ns()
            if now_ns - turns.start_ns >= longest_ns:
                return TIME_OVER
            measured = self.source.read()
            if measured is None:
                return SOURCE_OVER
            trouble, t_ns = stamps.judge(measured.t_ns)
            # As after a suspend.
            step_ns = t_ns - trial.quality.times_ns[-1] if trial.started else 0
            if trouble == "restarts" or step_ns > ANOTHER_CLOCK_NS:
                raise TimeError(
                    f"the clock jumped by {1e-9 * step_ns:+.3f} s in a trial",
                    where=trial.folder,
                    cause="the machine was suspended, or the source's clock was set",
                    next_step="the samples before are kept as interrupted; "
                    "start again with this trial",
                )
            if trouble:
                trial.quality.lost += 1
            else:
                trial.write(t_ns, turns.number, measured)
            # After the sample: a command is never what a sample waits for.
            trial.write_intent()
            self.context.display.show(trial, measured, now_ns)
            ends = self._take_key(trial)
            if ends:
                return ends
            trial.quality.lost += turns.end()

        return SIGNAL

    def _take_key(self, trial: TrialRecorder) -> str:
        """Mark an event by its key; returns how the trial ends, if it does."""
        key = self.keys.pressed()
        if key in ("keep", "redo", "stop"):
            return key
        # Without a sample there is no time to count from.
        if key in MARKS and trial.started:
            at_s = trial.mark(key, self.clock.now_ns())
            self.report(f"{key.replace('_', ' ')} at {at_s:.3f} s")
        if self.keys.closed and self.options.only_a_key_ends:
            self.report(f"{NO_KEY}; --seconds ends trials without a key")
            return SIGNAL
        return ""

    def _end(self, trial: TrialRecorder, task: Task, outcome: str) -> None:
        # The camera films on until the last sample is written.
        filmed = self.camera.stop()
        # A scene's truth is cut to the span of the samples, so it is written at the end.
        over = self._note_truth(trial)
        if outcome == SOURCE_OVER:
            over = "the source ended"
        state = {"redo": REDONE, SIGNAL: INTERRUPTED}.get(outcome, KEPT)
        closed = trial.close(state, over, camera=filmed)

        self.report(f"{closed.state}: {closed.quality.in_words()}")
        if closed.why and closed.state == INTERRUPTED:
            self.report(f"not kept, it will be recorded again: {closed.why}")
        if filmed.get("void"):
            self.report(f"this trial has no camera recording: {filmed['void']}")
        if filmed.get("doubt"):
            doubt = filmed["doubt"]
            self.report(f"warning: the camera's tags: {doubt}; the recording is kept")
        # Moved only after it is closed: its files keep their content.
        if closed.state == REDONE:
            self._discard(trial.folder)
        if closed.state == KEPT:
            self.kept = self.kept + 1
            self._last = (trial.folder, task)

    def _note_truth(self, trial: TrialRecorder) -> str:
        """Write what a scene knows of the trial; returns why it is over, if the scene is."""
        if self.truth is None or not trial.started:
            return ""
        # The scene's last phase ended before the trial's last sample.
        end_s = -1.0
        for event in self.truth(*trial.span_ns):
            trial.note(event)
            end_s = max(end_s, event.get("t1_s", -1.0))
        return "the scene ended" if end_s < trial.t_s else ""


def task_in_words(task: Task) -> str:
    """The instruction that a person gets in a trial."""
    if task.action == NOTHING:
        return "the empty hand"
    style = f" ({task.style})" if task.style else ""
    return f"{task.object}, {task.action}{style}"
