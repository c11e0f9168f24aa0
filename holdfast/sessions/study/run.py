"""One person's study: checks, then part after part by the operator's keys.

Every step is in the journal before the next one. A study whose source is simulated is a rehearsal,
which its journal and its report say.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TextIO

from holdfast.core.errors import CardError, DataNotFound, HoldfastError, UsageError
from holdfast.core.trial_layout import checked_name
from holdfast.core.writing import require_writable, write_whole
from holdfast.live.running import StopRequest, stop_signals
from holdfast.live.sources import is_standard_input
from holdfast.sessions.recorder.folder import folder_lock, program_lock, require_ours
from holdfast.sessions.recorder.plan import RecordOptions, Task
from holdfast.sessions.recorder.recording import kind_of
from holdfast.sessions.recorder.terminal import RunContext, context_of, listening
from holdfast.sessions.study.console import ADVERSE, HELP, Console, Key, clock_text
from holdfast.sessions.study.journal import (
    JOURNAL,
    Event,
    Journal,
    opened_journal,
    read_journal,
    require_not_withdrawn,
    torn_in_words,
    torn_lines,
    withdraw,
)
from holdfast.sessions.study.protocol import StudyPart, StudyProtocol
from holdfast.sessions.study.trials import Trials

PROTOCOL = "protocol.toml"
"""The copy in the person's folder; the study goes on with this text only."""
NO_NAMES = "no names: write p01, not a name"
SEVERITIES = {"1": "mild", "2": "moderate", "3": "severe"}
LATER = "the study goes on here with the same command"
FAILED = "space tries again, s skips this step, q quits and goes on later"


class Ending(StrEnum):
    """How a run ended; or what a part left: nothing, or another part to do."""

    GOES_ON = ""
    MOVED = "moved"
    QUIT = "quit"
    FINISHED = "finished"


# -- a run


def run_study(
    options: RecordOptions, protocol: StudyProtocol, keyboard: TextIO
) -> tuple[Ending, int]:
    """Run the study at the terminal; how it ended, and the exit code. Raises a HoldfastError."""
    require_consistent(options, protocol)
    with (
        stop_signals() as stopped,
        _terminal(keyboard, stopped, options.seconds) as context,
    ):
        ending = run_parts(options, protocol, context)
    return ending, stopped.exit_code


@contextmanager
def _terminal(
    keyboard: TextIO, stopped: StopRequest, seconds: float | None = None
) -> Iterator[RunContext]:
    """The operator's terminal. Raises UsageError where no key can be pressed."""
    with listening(keyboard.fileno()) as keys:
        # Without keys nothing could be confirmed, and no adverse event reported.
        if keys.ended():
            raise UsageError(
                "a study needs an operator, and no key can be pressed",
                cause="standard input is at its end (</dev/null), or it is in the background",
                next_step="run it in a terminal",
            )
        yield context_of(keys, stopped, seconds)


def require_consistent(options: RecordOptions, protocol: StudyProtocol) -> None:
    """Raise UsageError, OutputError or CardError for a run that cannot be."""
    checked_name(options.person, "pseudonym")
    require_ours(options.out)
    # A person who withdrew must not come back under the same name by mistake.
    require_not_withdrawn(options.out, options.person)
    options.require_camera()
    if is_standard_input(options.source):
        raise UsageError(
            "a study is led by keys, and standard input is its source",
            next_step="let the samples come by unix:// or serial://",
        )
    _require_same_protocol(options.out / options.person, protocol)


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


def run_parts(
    options: RecordOptions, protocol: StudyProtocol, context: RunContext
) -> Ending:
    """Run the parts that are left; returns FINISHED or QUIT. Raises a HoldfastError."""
    root = options.out
    trials = Trials(options, protocol, context)
    # A folder that cannot be written to is found out before the hand is opened.
    require_writable(root)
    # Another study there is a reason to stop before the hand is opened.
    with folder_lock(root):
        pass
    # Before the person's folder is made: a hand that does not answer leaves nothing behind.
    trials.require_hand()

    home = root / options.person
    # For the whole study: between two trials another program would take numbers and time.
    with program_lock(root):
        journal = opened_journal(home, context.clock.now_ns)
        # Before the first part: a trial that a kill left is recorded again, and must not count.
        trials.repair()
        console = Console(context)
        if torn_lines(home):
            console.report(torn_in_words(torn_lines(home)))
        _open(home, protocol, console, journal, kind_of(options.source) == "simulated")
        return Runner(protocol, journal, console, trials).run()


def _open(
    home: Path,
    protocol: StudyProtocol,
    console: Console,
    journal: Journal,
    rehearsal: bool,
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
        rehearsal=rehearsal,
    )
    console.report(f"{protocol.title} ({home.name})")

    if journal.part == len(protocol.parts):
        console.report("every step of this person's study is done")
    elif is_first:
        for line in protocol.before:
            console.report(f"  before: {line}")
    else:
        console.report("this person's study goes on where it ended")
    console.report(HELP)


@dataclass
class Runner:
    """Runs the parts of a protocol with one person."""

    protocol: StudyProtocol
    journal: Journal
    console: Console
    trials: Trials

    def run(self) -> Ending:
        """Until the last part is done, or the operator quits: FINISHED or QUIT."""
        if self._interrupted_event() and self._describe() == Ending.QUIT:
            return self._quit()
        while self.journal.part < len(self.protocol.parts):
            part = self.protocol.parts[self.journal.part]
            self._begin(part)
            if self._part(part) == Ending.QUIT:
                return self._quit()

        self.journal.append(Event.FINISHED)
        return Ending.FINISHED

    def _quit(self) -> Ending:
        # A step that was left keeps its time, so that the next run goes on with what is left.
        self._note_down(Event.QUIT)
        self.console.report(LATER)
        return Ending.QUIT

    def _interrupted_event(self) -> bool:
        """Whether the run before ended while an adverse event was described."""
        # the last line is that of this run's begin
        before = [entry.event for entry in self.journal.entries[-2:-1]]
        return before in ([Event.ADVERSE], [Event.DETAIL])

    def _note_down(self, event: Event, **more: object) -> None:
        """A line of the journal about the part under way. Raises OutputError."""
        self.journal.append(event, part=self.journal.part, **more)

    # -- one part

    def _begin(self, part: StudyPart) -> None:
        # Keys that were typed early must not skip what is to be said now.
        self.console.keys.drop()
        number = self.journal.part
        # How many trials were kept before, so that a part that is resumed still asks for its own.
        kept = self.trials.kept(part.task) if part.task else 0
        self._note_down(Event.BEGUN, step=part.step, title=part.title, kept=kept)
        # A part that takes too long uses up no time of the parts after it.
        left_s = max(0.0, self._left_s())
        after = self.protocol.parts[number + 1 :]
        left_s += 60.0 * sum(one.minutes for one in after)
        self.console.report("")
        self.console.report(
            f"step {part.step} of {self.protocol.last_step}, {part.title}: "
            f"{clock_text(60.0 * part.minutes)} planned; {clock_text(left_s)} left in all"
        )

        # The operator prepares the next part while this one is under way.
        titles = [one.title for one in self.protocol.parts] + ["the end"]
        rows = {
            "room": part.room_before,
            "show": part.show,
            "say": part.say and f'"{part.say}"',
            "hand over": part.hand_over,
            "room, at the end": part.room_after,
            "next": titles[number + 1],
        }
        for name, text in rows.items():
            if text:
                self.console.report(f"  {name}: {text}")

    def _part(self, part: StudyPart) -> Ending:
        """Do the part under way; returns MOVED or QUIT."""
        ending = Ending.GOES_ON
        while not ending:
            # Counted from the disk each time: a trial that failed or was discarded is asked for
            # again.
            missing = self._missing(part)
            # What the operator may do now.
            if missing:
                nth = (
                    f"repetition {part.repetitions - missing + 1} of {part.repetitions}"
                )
                self.console.report(f"{nth}: space begins it; a in it: adverse event")
            elif part.task:
                self.console.report("all kept: space goes on, r repeats the last one")
            key = self.console.key(self._left_s())
            if key != Key.NEXT:
                ending = self._operator(key, part)
            # Space means "begin the trial" until all repetitions are kept, then "go on".
            elif part.task and missing:
                ending = self._trial(part.task)
            else:
                ending = self._move(Event.DONE, 1)
            self.console.keys.drop()

        return ending

    def _missing(self, part: StudyPart) -> int:
        """Repetitions of a recording step that are not kept yet."""
        if part.task is None:
            return 0
        # Trials of the same task may be kept from an earlier part; those do not count here.
        before = self.journal.progress.kept_before[self.journal.part]
        return max(0, before + part.repetitions - self.trials.kept(part.task))

    def _left_s(self) -> float:
        """Planned time that is left of the part under way, s; below 0: it takes longer."""
        planned_s = 60.0 * self.protocol.parts[self.journal.part].minutes
        return planned_s - self.journal.progress.spent_until(self.journal.t_s)

    def _move(self, event: Event, by: int) -> Ending:
        # Before the first part there is none: back stays there.
        self._note_down(event, next=max(0, self.journal.part + by))
        return Ending.MOVED

    # -- keys

    def _operator(self, key: Key, part: StudyPart) -> Ending:
        """What a key other than NEXT does."""
        if key == Key.SKIP:
            return self._move(Event.SKIPPED, 1)
        if key == Key.REPEAT:
            return self._repeat(part)
        if key == Key.NOTE:
            return self._note()
        return self._adverse() if key == Key.ADVERSE else Ending.QUIT

    def _repeat(self, part: StudyPart) -> Ending:
        """The last trial of this step again; without one, the part before."""
        if part.task and self._missing(part) < part.repetitions:
            moved = self.trials.discard_last(part.task)
            self.console.report(f"moved to {moved}")
            return Ending.GOES_ON
        return self._move(Event.BACK, -1)

    def _note(self) -> Ending:
        prompt = f"note ({NO_NAMES}; Enter keeps it, Escape drops it)"
        text = self.console.text(prompt)
        if text:
            self._note_down(Event.NOTE, text=text)
        return Ending.GOES_ON

    def _adverse(self) -> Ending:
        """Write it down at once, then ask; the operator says whether the study goes on."""
        step = self.protocol.parts[self.journal.part].step
        # Before any question: the operator may have no hand free for a keyboard.
        self._note_down(Event.ADVERSE, step=step)
        self.console.report(
            "adverse event: look after the person first; nothing is being recorded"
        )
        return self._describe()

    def _describe(self) -> Ending:
        """Ask what happened, and whether the study goes on; again after a run that was cut off."""
        # Where the terminal is gone the event stays, without a description.
        text = self.console.text(f"what happened? ({NO_NAMES})") or ""
        choice = self._choice("how severe? 1 mild, 2 moderate, 3 severe", "123")
        self._note_down(Event.DETAIL, text=text, severity=SEVERITIES.get(choice))
        goes_on = self._choice("does the study go on? y or n", "yn")

        # No answer ends the study: safety does not wait for a key.
        return Ending.GOES_ON if goes_on == "y" else Ending.QUIT

    def _choice(self, prompt: str, letters: str) -> str:
        """One of the letters; "" where no key can be pressed any more."""
        while (typed := self.console.text(prompt)) is not None:
            if len(typed) == 1 and typed.lower() in letters:
                return typed.lower()
        return ""

    def _trial(self, task: Task) -> Ending:
        # During a trial the keys are those of the recorder, and `a` for an adverse event.
        keys = self.console.keys
        keys.last = ""
        try:
            self.trials.record(task)
        except HoldfastError as error:
            # One failed trial does not end the study: the operator tries again or skips.
            name = type(error).__name__
            self._note_down(Event.FAILED, error=name)
            self.console.report(f"error: {name}: {error}")
            self.console.report(FAILED)
        return self._adverse() if keys.last == ADVERSE else Ending.GOES_ON


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
    root: Path, person: str, protocol: StudyProtocol
) -> list[str]:
    """Write the report of a person; returns it in a few lines.

    Raises CardError, LabelError, OutputError.
    """
    from holdfast.sessions.study.outcome import outcome_of, summary_lines, write_report

    home = require_person(root, person)
    _require_same_protocol(home, protocol)
    outcome = outcome_of(root, person, protocol)
    return summary_lines(outcome, write_report(home, outcome))


def withdraw_person(root: Path, person: str, keyboard: TextIO) -> bool:
    """Delete a person once the operator has typed the pseudonym; returns whether that was done."""
    require_person(root, person)
    # The operator types the pseudonym: one wrong --person must not delete a person.
    with stop_signals() as stopped, _terminal(keyboard, stopped) as context:
        console = Console(context)
        typed = console.text(
            f"everything of {person} is deleted; type {person} to confirm"
        )
        if typed != person:
            console.report("nothing is deleted")
            return False
        withdraw(root, person, console.report)
    return True
