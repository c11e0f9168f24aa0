"""One run of a study: part after part, by the operator's keys, every step in the journal first."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from holdfast.core.errors import HoldfastError
from holdfast.sessions.recorder.protocol import Task
from holdfast.sessions.study import console as keys
from holdfast.sessions.study import journal as log
from holdfast.sessions.study.console import AnyDesk, clock_text
from holdfast.sessions.study.journal import Journal
from holdfast.sessions.study.questionnaires import ask
from holdfast.sessions.study.steps import QUESTIONNAIRE, RECORD, Part, StudyCard
from holdfast.sessions.study.trials import Trials
from holdfast.sessions.study.withdrawal import withdraw

MOVED, WITHDRAWN, FINISHED = "moved", "withdrawn", "finished"
NO_NAMES = "no names: write p01, not a name"
SEVERITIES = {"1": "mild", "2": "moderate", "3": "severe"}
LATER = "the study goes on here with the same command"


class Runner:
    """Runs the parts of a card with one person. utc: the time now as text."""

    def __init__(
        self,
        root: Path,
        person: str,
        card: StudyCard,
        journal: Journal,
        desk: AnyDesk,
        trials: Trials,
        utc: Callable[[], str],
    ) -> None:
        self.root, self.person, self.card = root, person, card
        self.journal, self.desk, self.trials, self._utc = journal, desk, trials, utc

    def run(self) -> str:
        """Until the last part is done, or the operator quits: FINISHED, QUIT or WITHDRAWN."""
        while self.journal.progress.part < len(self.card.parts):
            number = self.journal.progress.part
            part = self.card.parts[number]
            self._begin(number, part)
            ended = self._part(part)
            if ended == keys.QUIT:
                self.journal.append(log.QUIT, part=number)
                self.desk.say(LATER)
            if ended in (keys.QUIT, WITHDRAWN):
                return ended
        self.journal.append(log.FINISHED)
        return FINISHED

    # -- one part

    def _begin(self, number: int, part: Part) -> None:
        kept = {"kept": self.trials.kept(part.task)} if part.task else {}
        self.journal.append(
            log.BEGUN, part=number, step=part.step, title=part.title, **kept
        )
        for line in self._announced(number, part):
            self.desk.say(line)

    def _announced(self, number: int, part: Part) -> list[str]:
        """What the operator reads when a part begins."""
        card, spent_s = self.card, self.journal.progress.spent_s
        behind_s = sum(
            spent_s.get(k, 0.0) - 60.0 * card.parts[k].minutes for k in range(number)
        )
        left_s = max(0.0, self._left_s()) + 60.0 * card.minutes_after(number)
        of = "" if part.step is None else f"step {part.step} of {card.last_step}, "
        planned = f": {clock_text(60.0 * part.minutes)} planned" if part.minutes else ""
        lines = [f"{of}{part.title}{planned}; {clock_text(left_s)} left in all"]
        if abs(behind_s) >= 30.0:
            lines[0] += (
                f", {clock_text(abs(behind_s))} {'behind' if behind_s > 0 else 'ahead'}"
            )
        after = (
            card.parts[number + 1].title if number + 1 < len(card.parts) else "the end"
        )
        rows = {
            "room": part.first,
            "show": part.show,
            "say": part.say and f'"{part.say}"',
            "hand over": part.hand_over,
            "room, at the end": part.last,
            "next": after,
        }
        return [
            "",
            *lines,
            *(f"  {name}: {text}" for name, text in rows.items() if text),
        ]

    def _part(self, part: Part) -> str:
        """Do the part under way; returns MOVED, QUIT or WITHDRAWN."""
        if part.kind == QUESTIONNAIRE:
            return self._questionnaire(part)
        while True:
            missing = self._missing(part)
            self._prompt(part, missing)
            key = self.desk.key(self._left_s(), ends_part=not missing)
            if key == keys.NEXT and part.task and missing:
                ended = self._trial(part.task)
            elif key == keys.NEXT:
                ended = self._move(log.DONE, 1)
            else:
                ended = self._operator(key, part)
            if ended:
                return ended

    def _missing(self, part: Part) -> int:
        """Repetitions of a recording step that are not kept yet."""
        if part.task is None or part.kind != RECORD:
            return 0
        before = self.journal.progress.kept_before[self.journal.progress.part]
        return max(0, before + part.repetitions - self.trials.kept(part.task))

    def _prompt(self, part: Part, missing: int) -> None:
        if part.task is None:
            return
        if missing:
            nth = part.repetitions - missing + 1
            self.desk.say(
                f"repetition {nth} of {part.repetitions}: space begins it; a in it: adverse event"
            )
        else:
            self.desk.say(
                f"{part.repetitions} trials kept: space goes on, r repeats the last one"
            )

    def _left_s(self) -> float:
        """Planned time that is left of the part under way, s; below 0: it takes longer."""
        planned_s = 60.0 * self.card.parts[self.journal.progress.part].minutes
        return planned_s - self.journal.spent_s

    def _move(self, event: str, by: int) -> str:
        number = self.journal.progress.part
        self.journal.append(event, part=number, next=max(0, number + by))
        return MOVED

    # -- keys

    def _operator(self, key: str, part: Part) -> str:
        """What a key other than NEXT does; "" where the part goes on."""
        if key == keys.QUIT:
            return keys.QUIT
        if key == keys.SKIP:
            return self._move(log.SKIPPED, 1)
        if key == keys.REPEAT:
            return self._repeat(part)
        if key == keys.NOTE:
            return self._note()
        if key == keys.PAUSE:
            return self._pause()
        if key == keys.WITHDRAW:
            return self._withdraw()
        return self._adverse()

    def _repeat(self, part: Part) -> str:
        """The last trial of this step again; without one, the part before."""
        if part.task and self._missing(part) < part.repetitions:
            self.desk.say(f"moved to {self.trials.discard_last(part.task)}")
            return ""
        return self._move(log.BACK, -1)

    def _note(self) -> str:
        text = self.desk.text(f"note ({NO_NAMES}; Enter keeps it, Escape drops it)")
        if text:
            self.journal.append(log.NOTE, part=self.journal.progress.part, text=text)
        return ""

    def _pause(self) -> str:
        self.journal.append(log.PAUSED, part=self.journal.progress.part)
        self.desk.say("paused: space goes on")
        key = ""
        while key not in (keys.NEXT, keys.PAUSE, keys.QUIT):
            key = self.desk.key(0.0, ends_part=False, paused=True)
        if key == keys.QUIT:
            return keys.QUIT
        self.journal.append(log.RESUMED, part=self.journal.progress.part)
        return ""

    def _withdraw(self) -> str:
        typed = self.desk.text(
            f"withdraw deletes everything of {self.person}; type {self.person} to confirm"
        )
        if typed != self.person:
            self.desk.say("nothing is deleted")
            return ""
        withdraw(self.root, self.person, self.desk.say, self._utc)
        return WITHDRAWN

    def _adverse(self) -> str:
        """Write it down at once, then ask; the operator says whether the study goes on."""
        number = self.journal.progress.part
        self.journal.append(log.ADVERSE, part=number, step=self.card.parts[number].step)
        self.desk.say(
            "adverse event: look after the person first; nothing is being recorded"
        )
        text = self.desk.text(f"what happened? ({NO_NAMES})")
        choice = self._choice(
            "how severe? 1 mild, 2 moderate, 3 severe", tuple(SEVERITIES)
        )
        severity = SEVERITIES.get(choice or "")
        self.journal.append(log.DETAIL, part=number, text=text or "", severity=severity)
        goes_on = self._choice("does the study go on? y or n", ("y", "n"))
        return "" if goes_on == "y" else keys.QUIT

    def _choice(self, prompt: str, allowed: tuple[str, ...]) -> str | None:
        """One of the allowed answers; None where no key can be pressed any more."""
        while (typed := self.desk.text(prompt)) is not None:
            if typed.lower() in allowed:
                return typed.lower()
        return None

    # -- trials and questionnaires

    def _trial(self, task: Task) -> str:
        trial_keys = self.desk.trial_keys()
        try:
            self.trials.record(task, trial_keys)
        except HoldfastError as error:
            number = self.journal.progress.part
            self.journal.append(log.FAILED, part=number, error=type(error).__name__)
            self.desk.failed(error)
        return self._adverse() if trial_keys.adverse else ""

    def _questionnaire(self, part: Part) -> str:
        while True:
            key = ask(part.questionnaire, self.journal, self.desk)
            if key == keys.NEXT:
                return self._move(log.DONE, 1)
            if ended := self._operator(key, part):
                return ended
