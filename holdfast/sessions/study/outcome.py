"""What became of one person's study, from its journal and its trials, and the report of it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from holdfast.core.errors import DataNotFound, count_of
from holdfast.core.trial_layout import META
from holdfast.core.writing import write_whole
from holdfast.evaluation.style import write_page
from holdfast.sessions.recorder.folder import KEPT, REDONE
from holdfast.sessions.recorder.labels import read_meta
from holdfast.sessions.study.console import clock_text
from holdfast.sessions.study.journal import (
    JOURNAL,
    Entry,
    Event,
    Progress,
    progress_of,
    read_journal,
    torn_in_words,
    torn_lines,
)
from holdfast.sessions.study.protocol import StudyProtocol

NOT_REACHED = "not reached"


@dataclass(frozen=True)
class PartOutcome:
    """One row of the protocol. spent_s: None where it was not reached. begun: how often.

    state: of STATES, or NOT_REACHED.
    """

    step: int
    title: str
    planned_s: float
    spent_s: float | None
    begun: int
    state: str


@dataclass(frozen=True)
class Remark:
    """A note or an adverse event. at: UTC. severity: mild, moderate, severe, or None."""

    at: str
    step: int
    title: str
    text: str
    severity: str | None = None


@dataclass
class TrialCounts:
    """Trials of one object and action by how they ended. filmed: kept, with a whole video.

    interrupted: also void and cut off ones.
    """

    object: str
    action: str
    planned: int = 0
    kept: int = 0
    filmed: int = 0
    redone: int = 0
    interrupted: int = 0


@dataclass(frozen=True)
class StudyOutcome:
    """All of one person.

    rehearsal: the source was simulated. began, ended: UTC. torn_lines: of the journal, not in here.
    """

    person: str
    title: str
    rehearsal: bool
    finished: bool
    runs: int
    began: str
    ended: str
    parts: list[PartOutcome]
    adverse: list[Remark]
    notes: list[Remark]
    trials: list[TrialCounts]
    torn_lines: int

    @property
    def kept(self) -> int:
        """Kept trials that the plan asks for; further ones do not make up for other tasks."""
        return sum(min(one.planned, one.kept) for one in self.trials)

    @property
    def planned(self) -> int:
        """Trials that the plan asks for."""
        return sum(one.planned for one in self.trials)


def outcome_of(root: Path, person: str, protocol: StudyProtocol) -> StudyOutcome:
    """Read everything of one person.

    Raises DataNotFound without a journal, LabelError for one that cannot be read.
    """
    home = root / person
    journal = home / JOURNAL
    # The journal is written line by line, so it also shows a study that was cut off.
    entries = read_journal(journal)
    if not entries:
        raise DataNotFound(
            "no study of this person",
            where=journal,
            cause="recorded with holdfast record alone",
            next_step="holdfast evaluate MODEL --data FOLDER --report OUT scores such recordings",
        )

    progress = progress_of(entries)
    return StudyOutcome(
        person=person,
        title=protocol.title,
        rehearsal=any(entry.rehearsal for entry in entries),
        finished=progress.finished,
        runs=progress.runs,
        began=entries[0].at,
        ended=entries[-1].at,
        parts=_parts(protocol, progress),
        adverse=_remarks(protocol, entries, Event.ADVERSE),
        notes=_remarks(protocol, entries, Event.NOTE),
        trials=_trials(protocol, home),
        torn_lines=torn_lines(home),
    )


def _parts(protocol: StudyProtocol, progress: Progress) -> list[PartOutcome]:
    outcomes = []
    for number, part in enumerate(protocol.parts):
        spent_s = None
        if number in progress.states:
            spent_s = round(progress.spent_s.get(number, 0.0), 1)
        outcome = PartOutcome(
            part.step,
            part.title,
            60.0 * part.minutes,
            spent_s,
            progress.begun[number],
            progress.states.get(number, NOT_REACHED),
        )
        outcomes.append(outcome)
    return outcomes


def _remarks(
    protocol: StudyProtocol, entries: list[Entry], event: Event
) -> list[Remark]:
    """All of one event; an adverse event has the description that follows it, if it was given."""
    remarks: list[Remark] = []
    for entry in entries:
        if entry.event == event:
            part = protocol.parts[entry.part]
            remarks.append(Remark(entry.at, part.step, part.title, entry.text))
        elif entry.event == Event.DETAIL and event == Event.ADVERSE:
            remarks[-1] = replace(remarks[-1], text=entry.text, severity=entry.severity)
    return remarks


def _trials(protocol: StudyProtocol, home: Path) -> list[TrialCounts]:
    """Trials on the disk, by the tasks of the protocol first."""
    counts: dict[tuple[str, str], TrialCounts] = {}
    for part in protocol.parts:
        if part.task:
            of_task = part.task.object, part.task.action
            counts.setdefault(
                of_task, TrialCounts(*of_task)
            ).planned += part.repetitions

    # From the disk and not from the journal: the disk shows what was kept in the end.
    for path in home.rglob(f"trial_*/{META}"):
        meta = read_meta(path.parent)
        of_trial = str(meta.get("object")), str(meta.get("action"))
        trials = counts.setdefault(of_trial, TrialCounts(*of_trial))
        state = meta.get("state")
        if state == KEPT:
            trials.kept += 1
            # A video that is void has gaps, or ended before the trial.
            trials.filmed += "camera" in meta and not meta["camera"].get("void")
        elif state == REDONE:
            trials.redone += 1
        else:
            trials.interrupted += 1
    return list(counts.values())


# -- the report


def write_report(home: Path, outcome: StudyOutcome) -> Path:
    """Write report.json and report.html of a person; returns the page. Raises OutputError."""
    text = json.dumps(asdict(outcome), indent=1, allow_nan=False)
    write_whole(home / "report.json", text + "\n")
    return write_page(
        home / "report.html",
        "participant_report.html",
        outcome=outcome,
        clock=clock_text,
    )


def summary_lines(outcome: StudyOutcome, page: Path) -> list[str]:
    """The outcome as lines for the operator."""
    trials = f"{outcome.kept} of {count_of(outcome.planned, 'trial')} kept"
    adverse = count_of(len(outcome.adverse), "adverse event")
    lines = [f"{outcome.person}: {trials}, {adverse}", f"report: {page}"]
    if outcome.torn_lines:
        lines.insert(1, torn_in_words(outcome.torn_lines))
    return lines
