"""One run of a study: part after part, by the operator's keys, every step in the journal first."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from holdfast.core.errors import HoldfastError
from holdfast.sessions.recorder.protocol import Task
from holdfast.sessions.study.console import ADVERSE, Console, Key, clock_text
from holdfast.sessions.study.journal import Event, Journal, withdraw
from holdfast.sessions.study.protocol import StudyPart, StudyProtocol
from holdfast.sessions.study.trials import Trials

NO_NAMES = "no names: write p01, not a name"
SEVERITIES = {"1": "mild", "2": "moderate", "3": "severe"}
LATER = "the study goes on here with the same command"


class Ending(StrEnum):
    """How a run ended; or what a part left: nothing, or another part to do."""

    GOES_ON = ""
    MOVED = "moved"
    QUIT = "quit"
    WITHDRAWN = "withdrawn"
    FINISHED = "finished"


@dataclass
class Runner:
    """Runs the parts of a protocol with one person."""

    protocol: StudyProtocol
    journal: Journal
    console: Console
    trials: Trials

    def run(self) -> Ending:
        """Until the last part is done, or the operator quits: FINISHED, QUIT or WITHDRAWN."""
        while self.journal.part < len(self.protocol.parts):
            number = self.journal.part
            part = self.protocol.parts[number]
            self._begin(number, part)
            ending = self._part(part)
            if ending == Ending.QUIT:
                # A step that was left keeps its time, so that the next run goes on with what is
                # left.
                self.journal.append(Event.QUIT, part=number)
                self.console.report(LATER)
            if ending != Ending.MOVED:
                return ending

        self.journal.append(Event.FINISHED)
        return Ending.FINISHED

    # -- one part

    def _begin(self, number: int, part: StudyPart) -> None:
        # How many trials were kept before, so that a part that is resumed still asks for its own.
        kept = self.trials.kept(part.task) if part.task else 0
        self.journal.append(
            Event.BEGUN, part=number, step=part.step, title=part.title, kept=kept
        )
        # A part that takes too long uses up no time of the parts after it.
        left_s = max(0.0, self._left_s())
        left_s += 60.0 * self.protocol.minutes_after(number)
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
        """Do the part under way; returns MOVED, QUIT or WITHDRAWN."""
        ending = Ending.GOES_ON
        while not ending:
            # Counted from the disk each time: a trial that failed or was discarded is asked for
            # again.
            missing = self._missing(part)
            self._prompt(part, missing)
            key = self.console.key(self._left_s(), ends_part=not missing)
            if key != Key.NEXT:
                ending = self._operator(key, part)
            # Space means "begin the trial" until all repetitions are kept, then "go on".
            elif part.task and missing:
                ending = self._trial(part.task)
            else:
                ending = self._move(Event.DONE, 1)

        return ending

    def _missing(self, part: StudyPart) -> int:
        """Repetitions of a recording step that are not kept yet."""
        if part.task is None:
            return 0
        # Trials of the same task may be kept from an earlier part; those do not count here.
        before = self.journal.progress.kept_before[self.journal.part]
        return max(0, before + part.repetitions - self.trials.kept(part.task))

    def _prompt(self, part: StudyPart, missing: int) -> None:
        if missing:
            nth = f"repetition {part.repetitions - missing + 1} of {part.repetitions}"
            self.console.report(f"{nth}: space begins it; a in it: adverse event")
        elif part.task:
            self.console.report("all kept: space goes on, r repeats the last one")

    def _left_s(self) -> float:
        """Planned time that is left of the part under way, s; below 0: it takes longer."""
        planned_s = 60.0 * self.protocol.parts[self.journal.part].minutes
        return planned_s - self.journal.spent_s

    def _move(self, event: Event, by: int) -> Ending:
        number = self.journal.part
        # Before the first part there is none: back stays there.
        following = max(0, number + by)
        self.journal.append(event, part=number, next=following)
        return Ending.MOVED

    # -- keys

    def _operator(self, key: Key, part: StudyPart) -> Ending:
        """What a key other than NEXT does."""
        if key == Key.QUIT:
            return Ending.QUIT
        if key == Key.SKIP:
            return self._move(Event.SKIPPED, 1)
        if key == Key.REPEAT:
            return self._repeat(part)
        actions = {
            Key.NOTE: self._note,
            Key.PAUSE: self._pause,
            Key.WITHDRAW: self._withdraw,
            Key.ADVERSE: self._adverse,
        }
        return actions[key]()

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
            self.journal.append(Event.NOTE, part=self.journal.part, text=text)
        return Ending.GOES_ON

    def _pause(self) -> Ending:
        self.journal.append(Event.PAUSED, part=self.journal.part)
        self.console.report("paused: space goes on")

        key = None
        # Any other key is ignored: a note or a skip during a pause would blur its time.
        while key not in (Key.NEXT, Key.PAUSE, Key.QUIT):
            key = self.console.key(0.0, ends_part=False, paused=True)

        if key == Key.QUIT:
            return Ending.QUIT

        self.journal.append(Event.RESUMED, part=self.journal.part)
        return Ending.GOES_ON

    def _withdraw(self) -> Ending:
        person = self.trials.person
        everything = f"withdraw deletes everything of {person}"
        typed = self.console.text(f"{everything}; type {person} to confirm")
        # Nothing brings the files back, so a slip of a key must not delete them.
        if typed != person:
            self.console.report("nothing is deleted")
            return Ending.GOES_ON
        withdraw(self.trials.root, person, self.console.report)
        return Ending.WITHDRAWN

    def _adverse(self) -> Ending:
        """Write it down at once, then ask; the operator says whether the study goes on."""
        number = self.journal.part
        step = self.protocol.parts[number].step
        # Before any question: the operator may have no hand free for a keyboard.
        self.journal.append(Event.ADVERSE, part=number, step=step)
        self.console.report(
            "adverse event: look after the person first; nothing is being recorded"
        )
        # Where the terminal is gone the event stays, without a description.
        text = self.console.text(f"what happened? ({NO_NAMES})") or ""
        choice = self._choice("how severe? 1 mild, 2 moderate, 3 severe", "123")

        severity = SEVERITIES.get(choice)
        self.journal.append(Event.DETAIL, part=number, text=text, severity=severity)
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
            self.journal.append(Event.FAILED, part=self.journal.part, error=name)
            self.console.failed(error)
        return self._adverse() if keys.last == ADVERSE else Ending.GOES_ON
