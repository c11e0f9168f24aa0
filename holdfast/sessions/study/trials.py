"""The recording steps: each trial is one run of the recorder, with its own code and layout."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from holdfast.sessions.recorder.folder import (
    KEPT,
    RECORDING,
    discard,
    done,
    folder_lock,
    number,
    recording_folder,
    repair,
    task_folder,
    trials_of,
)
from holdfast.sessions.recorder.plan import RecordOptions, Task
from holdfast.sessions.recorder.recording import Plan, kind_of, open_source, record_plan
from holdfast.sessions.recorder.terminal import RunContext
from holdfast.sessions.study.console import ADVERSE
from holdfast.sessions.study.protocol import StudyProtocol


@dataclass
class Trials:
    """Records and counts the trials of one person. options: of every trial."""

    options: RecordOptions
    protocol: StudyProtocol
    context: RunContext

    def __post_init__(self) -> None:
        self.root = self.options.out
        self.person = self.options.person
        self.report = self.context.display.report

    def require_hand(self) -> None:
        """Open the source once, so that a hand that does not answer is seen before the person is.

        It also makes the folder of recordings. Raises the errors of the source.
        """
        source = open_source(self.options, self.context)
        kind = kind_of(self.options.source)
        # Closed at once: every trial opens the hand for itself.
        with closing(source), recording_folder(self.root, source.unit, kind):
            n_sensors = source.n_channels // 3
            self.report(f"the hand answers: {n_sensors} sensors, in {source.unit}")

    def repair(self) -> None:
        """Mark trials that a kill left as interrupted. Raises a DataError or OutputError."""
        for folder, meta in trials_of(self.root, self.person):
            if meta.get("state") == RECORDING:
                repaired = ", ".join(repair(folder))
                self.report(f"{folder}: {repaired}; it is recorded again")

    def kept(self, task: Task) -> int:
        """How many trials of a task are kept."""
        return done(self.root, self.person).count(task)

    def record(self, task: Task) -> None:
        """Record one trial. Raises a HoldfastError; the study may go on after it."""
        options = replace(
            self.options, protocol=self.protocol.name, trials=1, at_once=True
        )
        stopped = self.context.stopped
        keys = self.context.keys
        # An adverse event stops a trial at once, as a signal does; and after a redo the operator
        # says when the next one begins.
        context = replace(
            self.context, stopped=lambda: stopped() or keys.last in (ADVERSE, "r")
        )
        plan = Plan(self.protocol, [task], self.kept(task))
        record_plan(options, plan, context)

    def discard_last(self, task: Task) -> Path:
        """Move the last kept trial of a task to the discarded ones; returns its new path."""
        place = task_folder(self.root, self.person, task)
        kept = []
        with folder_lock(self.root):
            for folder, meta in trials_of(self.root, self.person):
                if folder.parent == place and meta.get("state") == KEPT:
                    kept.append(folder)
            # The highest number is the newest.
            return discard(self.root, self.person, max(kept, key=number))
