"""Who does what with which object, by the paths of logs, where all are built alike.

A word of a path is an action, a person or a number only as a whole; words of objects are known. Of
others is asked, where that changes what is held out together.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from os.path import commonpath, dirname

from holdfast.core.errors import listed
from holdfast.core.trial_layout import named_mass
from holdfast.interop.labels import action_of_word
from holdfast.interop.map import NAMES
from holdfast.interop.proposal import Answers
from holdfast.interop.words import NUMBERED, PERSON, TOGETHER

OBJECT = re.compile(
    r"(?i)(.*(ball|block|book|bottle|bowl|box|cube|cylinder|glass|object|sponge)"
    r"|(.*[^a-z])?(can|cup|egg|mug|pen))(e?s)?([-_ ]?\d+)?"
)
"""Words of objects in paths; others may be people."""
WORD = re.compile(rf"(?<![^/_ .-])({TOGETHER}(?=[/_ .-]|$)|[^/_ .-]+)")


@dataclass
class PathNames:
    """path: the pattern of [trials], "" where it says nothing. names: key -> its words.

    questions: what is not clear, with the option that answers it.
    """

    path: str = ""
    names: dict[str, list[str]] = field(default_factory=dict)
    questions: list[tuple[str, str]] = field(default_factory=list)


def names_of_paths(paths: Sequence[str], answers: Answers) -> PathNames:
    """What the paths of logs say of their trials; of several forms of paths a pattern each.

    >>> names_of_paths(["p3/ball/slip_1", "p4/ball/pass_2"], Answers()).path
    '{person}/{object}/{action}_{trial}'
    """
    found = PathNames()
    forms: dict[tuple[str, ...], list[list[str]]] = {}
    for path in paths:
        words = words_of_path(path)
        forms.setdefault(tuple(words[::2]), []).append(words[1::2])
    # of a long path a short pattern would take several words for one
    longest_first = sorted(forms.items(), key=lambda form: -len(form[0]))
    title = _title_words(paths, answers)
    patterns = [_pattern(found, *form, title, answers) for form in longest_first]
    found.path = " | ".join(patterns) if found.names else ""
    return found


def _pattern(
    found: PathNames,
    marks: Sequence[str],
    paths: Sequence[Sequence[str]],
    title: set[int],
    answers: Answers,
) -> str:
    """The pattern of paths of one form; adds its names and questions.

    marks: what stands before, between and behind the words. paths: their words. title: places of
    words that say nothing.
    """
    words = [*zip(*paths, strict=True)]
    seen = [[*dict.fromkeys(one)] for one in words]
    kinds = [kind_of(one, answers) for one in seen]
    fields: dict[str, int] = {}
    for key in NAMES:
        places = [k for k, kind in enumerate(kinds) if kind == key]
        # a study's name may hold a word of an action too: that which differs counts
        places = [k for k in places if len(seen[k]) > 1] or places
        if key == "action":
            places = [k for k in places if k not in title]
        if places:
            fields[key] = places[0]
        meanings = {tuple(map(answers.meaning, words[k])) for k in places}
        if key == "action" and len(meanings) > 1:
            both = listed([word for k in places for word in seen[k]])
            question = (
                f"which of {both} happens? {seen[places[0]][0]}= for one that does not"
            )
            found.questions.append(("--action", question))

    unclear = [k for k, kind in enumerate(kinds) if kind == "unclear"]
    is_person_known = "person" in fields or bool(answers.person)
    # held out by trial, or by people with a trial each, is the same
    several = [k for k in unclear if 1 < len(seen[k]) < len(paths)]
    for k in () if is_person_known else several:
        what = f"are {listed(seen[k], most=6)} people or objects? nothing says it"
        one_of = ",".join(seen[k])
        what += f": --person {one_of} or --object {one_of}"
        found.questions.append(("--person", what))
    if len(unclear) == 1 and is_person_known:
        # what is left beside a person is what was held
        fields.setdefault("object", unclear[0])
    if fields and kinds[-1] == "trial":
        fields["trial"] = len(kinds) - 1
    parts = [one[0] if len(one) == 1 else "*" for one in seen]
    for key, k in sorted(fields.items(), key=lambda one: one[1]):
        parts[k] = f"{{{key}}}"
        known = found.names.setdefault(key, [])
        known += [word for word in seen[k] if word not in known]
    return "".join(map("".join, zip(marks, [*parts, ""], strict=True)))


def _title_words(paths: Sequence[str], answers: Answers) -> set[int]:
    """Places of words in the name of a folder of all logs that has a word of its own.

    As in `slip_detection_dataset/cup_1`, which says nothing of its trials.
    """
    folders = commonpath([*map(dirname, paths)]).split("/")
    places: set[int] = set()
    n_words = 0
    for folder in folders:
        words = words_of_path(folder)[1::2]
        if any(kind_of([word], answers) == "unclear" for word in words):
            places |= {*range(n_words, n_words + len(words))}
        n_words += len(words)
    return places


def kind_of(words: Sequence[str], answers: Answers) -> str:
    """What words at one place of paths are: a key of NAMES, trial, unclear, or "" for nothing."""
    for key in NAMES:
        if {*words} <= {*getattr(answers, key).split(",")}:
            return key
    if all(map(PERSON.fullmatch, words)):
        return "" if answers.person else "person"
    # codes of labels may be answered, too
    if all(map(NUMBERED.fullmatch, words)):
        return "trial"
    if all(answers.actions.get(word) == "" for word in words):
        return ""
    if all(map(answers.meaning, words)):
        return "" if answers.whole_action else "action"
    if answers.object:
        return ""
    are_things = all(OBJECT.fullmatch(word) or named_mass(word) for word in words)
    return "object" if are_things else "unclear"


def words_of_path(path: str) -> list[str]:
    """The words of a path, with what stands before, between and behind them.

    Words with a dash between them are one, unless one is a person, a number or an action.
    """
    words: list[str] = []
    for part in WORD.split(path):
        is_dashed = words[-1:] == ["-"] and len(words) > 2
        if is_dashed and part and not (_is_name(words[-2]) or _is_name(part)):
            words[-2:] = [f"{words[-2]}-{part}"]
        else:
            words.append(part)
    return words


def _is_name(word: str) -> bool:
    """Whether a word is a person, a number or an action."""
    is_other = PERSON.fullmatch(word) or NUMBERED.fullmatch(word)
    return bool(is_other or action_of_word(word))
