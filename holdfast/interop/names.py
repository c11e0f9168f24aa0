"""Who does what with which object, by the paths of logs, where all are built alike.

A word of a path is an action, a person or a number only as a whole; words of objects are known. Of
others is asked, where that changes what is held out together.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from holdfast.core.errors import listed
from holdfast.core.trial_layout import named_mass
from holdfast.interop.labels import action_of_word
from holdfast.interop.map import NAMES, NUMBERED, PERSON, TOGETHER
from holdfast.interop.understood import Answers

OBJECT = re.compile(
    "(?i)can|cup|.*(ball|block|book|bottle|bowl|box|cube|cylinder|egg|glass|mug|object|pen|sponge)"
)
"""Words of objects in paths; others may be people."""
WORD = re.compile(rf"(?<![^/_ .-])({TOGETHER}(?=[/_ .-]|$)|[^/_ .-]+)")


@dataclass
class PathNames:
    """path: the pattern of [trials], "" where it says nothing. actions: the words of actions.

    names: key -> its words. questions: what is not clear, with the option that answers it.
    """

    path: str = ""
    actions: list[str] = field(default_factory=list)
    names: dict[str, list[str]] = field(default_factory=dict)
    questions: list[tuple[str, str]] = field(default_factory=list)


def names_of_paths(paths: Sequence[str], answers: Answers) -> PathNames:
    """What the paths of logs say of their trials.

    >>> names_of_paths(["p3/ball/slip_1", "p4/ball/pass_2"], Answers()).path
    '{person}/{object}/{action}_{trial}'
    """
    found = PathNames()
    split = [_words(one) for one in paths]
    marks = split[0][::2]
    if any(one[::2] != marks for one in split):
        return found
    words = [*zip(*(one[1::2] for one in split), strict=True)]
    fields: dict[str, int] = {}
    unclear = []
    for k, of_place in enumerate(words):
        kind = _kind(of_place, answers)
        first = fields.setdefault(kind, k)
        # a study's name may hold an action too: that which differs says what happens
        if kind == "action" and len({*words[first]}) < 2:
            fields[kind] = k
        elif kind == "action" and first != k and len({*of_place}) > 1:
            both = [one for of_both in (words[first], of_place) for one in of_both]
            what = f"which of {listed([*dict.fromkeys(both)])} happens? one action is right"
            found.questions.append(("--action", what))
        fields[kind] = k if kind == "trial" else fields[kind]
        unclear += [k] if kind == "unclear" else []

    if fields.get("trial") != len(words) - 1:
        fields.pop("trial", None)
    fields.pop("unclear", None)
    fields.pop("", None)
    for k in unclear:
        seen = [*dict.fromkeys(words[k])]
        # held out by trial, or by people with a trial each, is the same
        is_same = len(seen) in (1, len(words[k]))
        if not is_same and "person" not in fields and not answers.person:
            what = f"are {listed(seen, most=6)} people or objects? nothing says it"
            names = ",".join(seen)
            what += f": --person {names} or --object {names}"
            found.questions.append(("--person", what))
    if (
        len(unclear) == 1
        and fields.keys() & {"person", "action"}
        and not answers.object
    ):
        # what is left beside a person or an action is what was held
        fields.setdefault("object", unclear[0])
    if not fields.keys() - {"trial"}:
        return found

    parts = [one[0] if len(set(one)) == 1 else "*" for one in words]
    for key, k in sorted(fields.items(), key=lambda one: one[1]):
        parts[k] = f"{{{key}}}"
        found.names[key] = [*dict.fromkeys(words[k])]
    found.path = "".join(map("".join, zip(marks, [*parts, ""], strict=True)))
    found.actions = found.names.get("action", [])
    return found


def _kind(words: Sequence[str], answers: Answers) -> str:
    """What words at one place of paths are: a key of NAMES, trial, unclear, or "" for nothing."""
    for key in NAMES:
        if {*words} <= {*getattr(answers, key).split(",")}:
            return key
    if all(answers.actions.get(word) or action_of_word(word) for word in words):
        return "" if answers.whole_action else "action"
    if all(map(PERSON.fullmatch, words)):
        return "" if answers.person else "person"
    if all(map(NUMBERED.fullmatch, words)):
        return "trial"
    if answers.object:
        return ""
    are_things = all(OBJECT.match(word) or named_mass(word) for word in words)
    return "object" if are_things else "unclear"


def _words(path: str) -> list[str]:
    """The words of a path, with what stands before, between and behind them.

    Words with a dash between them are one, unless one is a person, a number or an action.
    """
    first, *rest = WORD.split(path)
    words = [first, *rest[:2]]
    for word, mark in zip(rest[2::2], rest[3::2], strict=True):
        if words[-1] == "-" and not (_is_name(words[-2]) or _is_name(word)):
            words[-2:] = [f"{words[-2]}-{word}", mark]
        else:
            words += [word, mark]
    return words


def _is_name(word: str) -> bool:
    """Whether a word is a person, a number or an action."""
    is_other = PERSON.fullmatch(word) or NUMBERED.fullmatch(word)
    return bool(is_other or action_of_word(word))
