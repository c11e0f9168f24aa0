"""A questionnaire on the terminal: item by item, every answer in the journal at once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from holdfast.edge_runtime.writing import write_whole
from holdfast.human_study import desk as keys
from holdfast.human_study import journal as log
from holdfast.human_study.card import QUESTIONNAIRE, StudyCard
from holdfast.human_study.desk import LEFT_OUT, AnyDesk
from holdfast.human_study.journal import Journal, Progress
from holdfast.human_study.questionnaires import Item, Questionnaire, read_questionnaire

ANSWERS = "questionnaires.json"
HELP = f"a number, or {LEFT_OUT} to leave it out; or a key and Enter: s, r, n, a, p, w, q"


def ask(name: str, journal: Journal, desk: AnyDesk) -> str:
    """Ask the items without an answer; returns NEXT, or the key that interrupts it.

    REPEAT asks the item before again, and is returned only at the first item.
    """
    of = read_questionnaire(name)
    desk.say(f"{of.title}. {of.ask}")
    desk.say(HELP)
    part = journal.progress.part
    at = sum((part, item.name) in journal.progress.answers for item in of.items)
    while at < len(of.items):
        answer = _answer(of, of.items[at], f"{at + 1} of {len(of.items)}", desk)
        if answer == keys.REPEAT and at > 0:
            at -= 1
        elif isinstance(answer, str):
            return answer
        else:
            journal.append(log.ANSWER, part=part, item=of.items[at].name, rating=answer)
            at += 1
    return keys.NEXT


def _answer(of: Questionnaire, item: Item, place: str, desk: AnyDesk) -> int | str | None:
    """A rating, None where it is left out, or a key."""
    scale = f"{of.lowest} {item.low} .. {of.highest} {item.high}"
    steps = f", in steps of {of.step}" if of.step > 1 else ""
    while True:
        typed = desk.text(f"{place}: {item.ask} ({scale}{steps})")
        if typed is None:
            return keys.QUIT
        if typed == LEFT_OUT:
            return None
        if typed.lower() in keys.KEYS and typed:
            return keys.KEYS[typed.lower()]
        if typed.isdecimal() and len(typed) < 9 and of.allows(int(typed)):
            return int(typed)
        desk.say(f"{typed[:20]!r} is not on the scale; {HELP}")


def scores(card: StudyCard, progress: Progress) -> list[dict[str, Any]]:
    """Every questionnaire with an answer: its ratings and its score, None if one is left out."""
    found = []
    for number, part in enumerate(card.parts):
        if part.kind != QUESTIONNAIRE:
            continue
        of = read_questionnaire(part.questionnaire)
        key = [(number, item.name) for item in of.items]
        answers = {
            name: progress.answers[number, name]
            for _, name in key
            if (number, name) in progress.answers
        }
        if answers:
            found.append(
                {
                    "questionnaire": of.name,
                    "title": of.title,
                    "source": of.source,
                    "sha256": of.sha256,
                    "part": number,
                    "ratings": answers,
                    "score": of.score(answers),
                }
            )
    return found


def write_answers(home: Path, card: StudyCard, progress: Progress) -> Path:
    """Write questionnaires.json of a person. Raises OutputError."""
    text = json.dumps({"questionnaires": scores(card, progress)}, indent=1, allow_nan=False)
    return write_whole(home / ANSWERS, text + "\n")
