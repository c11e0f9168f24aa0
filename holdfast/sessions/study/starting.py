"""From the options of `holdfast study` to a run: checks, the folder, the console, the report."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

from holdfast.core.errors import CardError, DataNotFound, UsageError
from holdfast.core.lines import stream_sink
from holdfast.core.trial_layout import checked_name
from holdfast.core.writing import require_writable, write_whole
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.live.running import RunClock, say, stop_signals
from holdfast.live.sources import is_hand, is_standard_input
from holdfast.sessions.recorder.display import StatusLine, columns_of
from holdfast.sessions.recorder.folder import alone, require_ours, reserved
from holdfast.sessions.recorder.keys import Keys, listening
from holdfast.sessions.recorder.plan import RecordOptions
from holdfast.sessions.recorder.recording import kind_of
from holdfast.sessions.recorder.session import Display, RunContext
from holdfast.sessions.study.console import HELP, Console, Rehearsal
from holdfast.sessions.study.journal import (
    JOURNAL,
    Event,
    Journal,
    held,
    opened_journal,
    read_journal,
    require_not_withdrawn,
    withdraw,
)
from holdfast.sessions.study.protocol import StudyProtocol
from holdfast.sessions.study.runner import Ending, Runner
from holdfast.sessions.study.trials import Trials

PROTOCOL = "protocol.toml"
"""The copy in the person's folder; the study goes on with this text only."""


@dataclass(frozen=True)
class StudyOptions:
    """How one person's study runs.

    recording: of every trial, and the study's folder and person. rehearse: a virtual participant,
    no operator.
    """

    recording: RecordOptions
    rehearse: bool = False

    @classmethod
    def of(cls, args: Any) -> StudyOptions:
        """From the words on a command line."""
        # The protocol of the study is not one of the recorder.
        recording = replace(RecordOptions.of(args), protocol=None)
        return cls(recording, args.rehearse)

    @property
    def home(self) -> Path:
        """The person's folder."""
        return self.recording.out / self.recording.person

    def require_consistent(self, protocol: StudyProtocol) -> None:
        """Raise UsageError, OutputError or CardError for a run that cannot be."""
        recording = self.recording
        checked_name(recording.person, "pseudonym")
        require_ours(recording.out)
        # A person who withdrew must not come back under the same name by mistake.
        require_not_withdrawn(recording.out, recording.person)
        recording.camera.require_usable()
        if is_standard_input(recording.source):
            raise UsageError(
                "a study is led by keys, and standard input is its source",
                next_step="let the samples come by unix:// or serial://",
            )
        if self.rehearse:
            self._require_rehearsal()
        _require_same_protocol(self.home, protocol)

    def _require_rehearsal(self) -> None:
        """Raise UsageError where a rehearsal has no virtual participant."""
        recording = self.recording
        if kind_of(recording.source) != "simulated" or recording.camera.camera:
            raise UsageError(
                "--rehearse is for a virtual participant without a camera",
                cause="its clock jumps, which neither a hand nor a camera can follow",
                next_step="--source sim://p1, without --camera",
            )

        if is_hand(recording.source) and recording.seconds is None:
            raise UsageError(
                "a virtual hand has no end of its own, and no operator ends its trials",
                next_step="add --seconds 12, or take --source sim://SCENE",
            )


def _require_same_protocol(home: Path, protocol: StudyProtocol) -> None:
    """Raise CardError where the person began with another protocol."""
    for entry in read_journal(home / JOURNAL):
        if entry.event == Event.OPENED and entry.sha256 != protocol.sha256:
            raise CardError(
                "the protocol is not the one that this person began with",
                where=home,
                cause="it was edited in between, or it is another protocol",
                next_step=f"go on with {home / PROTOCOL}, or take a new pseudonym",
            )


def run_study(
    options: StudyOptions, protocol: StudyProtocol, keyboard: TextIO
) -> Ending:
    """Run the study with an operator, or as a rehearsal. Raises a HoldfastError."""
    options.require_consistent(protocol)
    status = _status_line(options.recording.seconds)

    with ExitStack() as stack:
        stopped = stack.enter_context(stop_signals())
        console: Console
        if options.rehearse:
            console = Rehearsal(status.report, VirtualClock(), stopped)
        else:
            keys = stack.enter_context(listening(keyboard.fileno()))
            console = _console(keys, status, stopped)
        return run_parts(options, protocol, console, status)


def _status_line(seconds: float | None = None) -> StatusLine:
    return StatusLine(stream_sink(sys.stderr), lambda: columns_of(sys.stderr), seconds)


def _console(keys: Keys, status: StatusLine, stopped: Callable[[], bool]) -> Console:
    """The operator's console. Raises UsageError where no key can be pressed."""
    # Without keys nothing could be confirmed, and no adverse event reported.
    if keys.ended():
        raise UsageError(
            "a study needs an operator, and no key can be pressed",
            cause="standard input is at its end (</dev/null), or it is in the background",
            next_step="run it in a terminal; --rehearse runs a virtual participant alone",
        )
    return Console(keys, status.report, status.draw, RunClock(), stopped)


def run_parts(
    options: StudyOptions,
    protocol: StudyProtocol,
    console: Console,
    display: Display,
) -> Ending:
    """Run the study on any console; returns how it ended. Raises a HoldfastError.

    display: of the trials.
    """
    root = options.recording.out
    home = options.home
    clock = console.clock
    context = RunContext(clock, console.keys, display, console.stopped)
    trials = Trials(options.recording, protocol, context)
    # A folder that cannot be written to is found out before the hand is opened.
    require_writable(root)
    # Another study there is a reason to stop before the hand is opened.
    with alone(root):
        pass
    # Before the person's folder is made: a hand that does not answer leaves nothing behind.
    trials.require_hand()

    # For the whole study: between two trials another program would take numbers and time.
    with (
        reserved(root),
        opened_journal(home, len(protocol.parts), clock.now_ns) as journal,
    ):
        # Before the first part: a trial that a kill left is recorded again, and must not count.
        trials.repair()
        _open(home, protocol, console, journal)
        return Runner(protocol, journal, console, trials).run()


def _open(
    home: Path, protocol: StudyProtocol, console: Console, journal: Journal
) -> None:
    """Begin a run: the first one keeps the protocol, a later one reports where it goes on."""
    is_first = not journal.entries
    if is_first:
        write_whole(home / PROTOCOL, protocol.text)
    # A rehearsal is marked in its journal, so that no report can take it for a person.
    journal.append(
        Event.OPENED,
        card=protocol.name,
        sha256=protocol.sha256,
        rehearsal=console.rehearsal,
    )
    console.report(f"{protocol.title} ({home.name})")

    if journal.part == len(protocol.parts):
        console.report("every step of this person's study is done")
    elif is_first:
        for line in protocol.before:
            console.report(f"  before: {line}")
    else:
        console.report("this person's study goes on where it ended")

    if not console.rehearsal:
        console.report(HELP)


# -- after a study


def require_person(root: Path, person: str) -> Path:
    """The folder of a person who has one. Raises UsageError, OutputError, DataNotFound."""
    checked_name(person, "pseudonym")
    require_ours(root)
    home = root / person
    if not home.is_dir():
        raise DataNotFound(
            "no such person in this folder",
            where=home,
            next_step="check --out and --person",
        )

    return home


def write_participant_report(
    root: Path, person: str, protocol: StudyProtocol, model: Path
) -> list[str]:
    """Write the report of a person; returns it in a few lines.

    Raises CardError, LabelError, OutputError.
    """
    from holdfast.sessions.study.outcome import (
        outcome_of,
        summary_lines,
        write_report,
    )

    home = require_person(root, person)
    _require_same_protocol(home, protocol)
    say("writing the report")
    outcome = outcome_of(root, person, protocol, model)
    return summary_lines(outcome, write_report(home, outcome))


def withdraw_person(root: Path, person: str, keyboard: TextIO) -> bool:
    """Delete a person once the operator has typed the pseudonym; returns whether that was done."""
    home = require_person(root, person)
    # The operator types the pseudonym: one wrong --person must not delete a person.
    with stop_signals() as stopped, listening(keyboard.fileno()) as keys:
        console = _console(keys, _status_line(), stopped)
        typed = console.text(
            f"everything of {person} is deleted; type {person} to confirm"
        )
        if typed != person:
            console.report("nothing is deleted")
            return False
        # Another terminal that runs this person's study would write the files again.
        with held(home / JOURNAL):
            withdraw(root, person, console.report)

    return True
