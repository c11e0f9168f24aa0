"""What became of one person's study, from its journal and its trials: all that a report shows."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.errors import DataError, DataNotFound, ModelError
from holdfast.core.reading import Json
from holdfast.core.trial_layout import META
from holdfast.sessions.recorder.folder import KEPT, REDONE
from holdfast.sessions.recorder.labels import read_meta
from holdfast.sessions.study import journal as log
from holdfast.sessions.study.journal import JOURNAL, progress_of, read_journal
from holdfast.sessions.study.questionnaires import scores
from holdfast.sessions.study.steps import StudyCard

if TYPE_CHECKING:
    from holdfast.evaluation.participant import ParticipantFigures

NOT_REACHED = "not reached"


@dataclass(frozen=True)
class PartOutcome:
    """One row of the protocol. spent_s: None where it was not reached. begun: how often.

    state: done, skipped, under way, or not reached.
    """

    step: int | None
    title: str
    planned_s: float
    spent_s: float | None
    begun: int
    state: str


@dataclass(frozen=True)
class AdverseEvent:
    """at: UTC. severity: mild, moderate, severe, or None where it was not given."""

    at: str
    step: int | None
    title: str
    severity: str | None
    text: str


@dataclass(frozen=True)
class TrialCounts:
    """Trials of one object and action by how they ended. filmed: kept, with a whole video."""

    object: str
    action: str
    planned: int
    kept: int
    filmed: int
    redone: int
    interrupted: int

    @property
    def of_plan(self) -> int:
        """Kept trials that the plan asks for; further ones do not make up for other tasks."""
        return min(self.planned, self.kept)


@dataclass(frozen=True)
class StudyOutcome:
    """All of one person. answers: the model's figures, None where `no_answers` says why not."""

    person: str
    title: str
    rehearsal: bool
    finished: bool
    runs: int
    began: str
    ended: str
    parts: list[PartOutcome]
    adverse: list[AdverseEvent]
    notes: list[Json]
    trials: list[TrialCounts]
    questionnaires: list[dict[str, Any]]
    figures: ParticipantFigures | None
    no_figures: str

    def to_json(self) -> Json:
        """As it stands in report.json."""
        own = {name: value for name, value in vars(self).items() if name != "figures"}
        rows = ("parts", "adverse", "trials")
        lists = {name: [asdict(one) for one in own[name]] for name in rows}
        figures = None if self.figures is None else self.figures.to_json()
        return {**own, **lists, "answers": figures}


def outcome_of(root: Path, person: str, card: StudyCard, model: Path) -> StudyOutcome:
    """Read everything of one person.

    Raises DataNotFound without a journal, LabelError for one that cannot be read.
    """
    home = root / person
    entries = read_journal(home / JOURNAL)
    if not entries:
        raise DataNotFound(
            "no study of this person",
            where=home / JOURNAL,
            cause="recorded with holdfast record alone",
            next_step="holdfast evaluate MODEL --data FOLDER --report OUT scores such recordings",
        )
    progress = progress_of(entries, home / JOURNAL, len(card.parts))
    figures, why = _figures(home, model)
    return StudyOutcome(
        person,
        card.title,
        any(entry.get("rehearsal") for entry in entries),
        progress.finished,
        progress.runs,
        str(entries[0]["at"]),
        str(entries[-1]["at"]),
        _parts(card, entries, progress),
        _adverse(card, entries),
        [_note(card, entry) for entry in entries if entry["event"] == log.NOTE],
        _trials(card, home),
        scores(card, progress),
        figures,
        why,
    )


def _figures(home: Path, model: Path) -> tuple[ParticipantFigures | None, str]:
    """The model's figures, or why there are none."""
    from holdfast.edge_runtime.engine import ModelChoice
    from holdfast.evaluation.participant import participant_figures

    try:
        return participant_figures(ModelChoice(str(model)).open(), home), ""
    except (DataError, ModelError) as error:
        return None, f"{type(error).__name__}: {error}"


def _parts(
    card: StudyCard, entries: list[Json], progress: log.Progress
) -> list[PartOutcome]:
    begun = Counter(entry["part"] for entry in entries if entry["event"] == log.BEGUN)
    last = {
        entry["part"]: entry["event"]
        for entry in entries
        if entry["event"] in (log.BEGUN, log.DONE, log.SKIPPED)
    }
    words = {log.BEGUN: "under way", None: NOT_REACHED}
    return [
        PartOutcome(
            part.step,
            part.title,
            60.0 * part.minutes,
            round(progress.spent_s.get(k, 0.0), 1) if k in last else None,
            begun[k],
            words.get(last.get(k), str(last.get(k))),
        )
        for k, part in enumerate(card.parts)
    ]


def _adverse(card: StudyCard, entries: list[Json]) -> list[AdverseEvent]:
    """Every adverse event, with the description that follows it, if it was given."""
    events: list[AdverseEvent] = []
    for entry in entries:
        if entry["event"] == log.ADVERSE:
            part = card.parts[entry["part"]]
            events.append(AdverseEvent(entry["at"], part.step, part.title, None, ""))
        elif entry["event"] == log.DETAIL and events:
            before = asdict(events.pop())
            events.append(
                AdverseEvent(**before | {k: entry[k] for k in ("severity", "text")})
            )
    return events


def _note(card: StudyCard, entry: Json) -> Json:
    part = card.parts[entry["part"]]
    return {
        "at": entry["at"],
        "step": part.step,
        "title": part.title,
        "text": entry["text"],
    }


def _trials(card: StudyCard, home: Path) -> list[TrialCounts]:
    """Trials on the disk by the tasks of the card; interrupted: also void and cut off ones."""
    planned: Counter[tuple[str, str]] = Counter()
    for part in card.parts:
        if part.task:
            planned[part.task.thing, part.task.action] += part.repetitions
    states: dict[tuple[str, str], Counter[str]] = {key: Counter() for key in planned}
    filmed: Counter[tuple[str, str]] = Counter()
    for path in home.rglob(f"trial_*/{META}"):
        meta = read_meta(path.parent)
        key = str(meta.get("object")), str(meta.get("action"))
        states.setdefault(key, Counter())[str(meta.get("state"))] += 1
        filmed[key] += meta.get("state") == KEPT and _is_whole(meta.get("camera"))
    return [
        TrialCounts(
            thing,
            action,
            planned[thing, action],
            of[KEPT],
            filmed[thing, action],
            of[REDONE],
            of.total() - of[KEPT] - of[REDONE],
        )
        for (thing, action), of in states.items()
    ]


def _is_whole(camera: Any) -> bool:
    """Whether a trial's entry on its camera is one of a whole video."""
    return isinstance(camera, dict) and not camera.get("void")
