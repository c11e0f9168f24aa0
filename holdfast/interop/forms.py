"""Logs of one form: their map, what was understood of them in words, and what is asked.

A form is a set of columns. Folders of a study often hold logs of two forms, such as those of two
hands, or those before and after a change of the firmware. Each form gets a map of its own.

The order in which a map is made: time and sensors, then the columns that name trials, then labels,
then unit and signs, then the words of the paths. Each needs what comes before it: a label says when
the hand is empty, and the unit says how far a reading is from rest.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from msgspec.structs import replace as changed

from holdfast.core.column_map import SensorColumns
from holdfast.core.contract import AXES, NORMAL_AXIS, UNIT_OF, valid_names
from holdfast.core.errors import listed
from holdfast.core.hand_card import too_many
from holdfast.core.trial_layout import named_mass
from holdfast.data.datasets.trials import action_of
from holdfast.interop.columns import normal_axis, oriented, words_of
from holdfast.interop.labels import (
    FoundLabels,
    action_of_word,
    labels_of,
    rules_of_table,
    timed,
)
from holdfast.interop.map import (
    NAMES,
    NUMBERED,
    PERSON,
    TOGETHER,
    EventRules,
    Facts,
    ImportMap,
    TrialRules,
)
from holdfast.interop.streams import ForeignLog, first_stream, merged, text_cells
from holdfast.interop.tables import pd
from holdfast.interop.understood import Answers, Sample, Understood, situation_of

NAMED = {
    "person": {"person", "subject", "participant", "user"},
    "object": {"object", "item", "obj"},
    "action": {"action", "condition", "task"},
    "column": {"trial", "run", "episode", "rep", "repetition", "recording", "sheet"},
}
"""Words of columns that hold what a trial is called by, or its number."""
OBJECT = re.compile(
    "(?i)can|cup|.*(ball|block|book|bottle|bowl|box|cube|cylinder|egg|glass|mug|object|pen|sponge)"
)
"""Words of objects in paths; others may be people."""
WORD = re.compile(rf"({TOGETHER}(?=[/_ .]|$)|[^/_ .]+)")
PART = re.compile(rf"({TOGETHER}(?=-|$)|[^-]+)")
"""A word of a path, and a part of one: no-slip and subject 7 are one."""
MOST_SENSORS = 0.8
"""So many of them must say that the normal axis is another one than the names say."""
HOW_MANY_ROWS = "how many rows a second have the logs? nothing says it: a number in Hz"
WHAT_HAPPENS = (
    "what happens in these trials? nothing in the logs says it: slip, hold, pull, fall, pass, "
    "put-down, nothing, .."
)


@dataclass
class Form:
    """Logs of one form, to be understood.

    found: where lines and questions are added. source: the folder or the file that was given.
    samples: the logs, shortened. tables: what lies beside them and holds no readings. fingers: the
    words of the files of one trial, () where a trial is one file. answers: of the command line.
    events: where labels come from, once that is found. is_told: whether they say what happens.
    """

    found: Understood
    source: Path
    samples: list[Sample]
    tables: list[ForeignLog]
    fingers: tuple[str, ...]
    answers: Answers
    events: EventRules | None = None
    is_told: bool = False

    def understand(self) -> None:
        """Add the map of the logs, its lines and its questions.

        No map is added while the time or the unit is asked for: it could not be written down.
        """
        first, answers, add = self.samples[0], self.answers, self.found.add
        add("time", first.time_text)
        names = f"{', '.join(first.form[:3])} to {', '.join(first.form[-3:])}"
        add("sensors", f"{len(first.sensors)}, {first.why}: {names}")
        wrong = too_many(len(first.sensors))
        if wrong:
            add("note", f"{wrong}: take those out of the map that do not matter")
        long = first_stream(first.log).long
        if long:
            add("layout", f"a row for each {' and '.join(long)}: made columns")
        trials = self._trial_rules()
        self.events = events = self._events(trials)
        unit, sensors = self._hand()
        path, words = self._path()
        for sample in self.samples if trials.action else ():
            words += text_cells(sample.columns[trials.action])

        about = all(one.log.about.get("action") for one in self.samples)
        if not (self.is_told or answers.action or about or words):
            self.found.ask("--action", WHAT_HAPPENS)

        used = {*first.form, trials.column, trials.person, trials.object, trials.action}
        used.add(first.time.column if first.time else "")
        used.add(events.column if events else "")
        used.update(valid_names(len(first.sensors)))
        unused = [name for name in merged(first.log) if name not in used]
        if unused:
            add("not used", listed(unused, most=12))
        if first.time is None or not unit:
            return
        actions = {}
        for word in {*words}:
            meant = self._action(word)
            if meant and action_of(word) != meant:
                actions[word] = meant
        facts = {}
        for key in NAMES[:2]:
            facts[key] = "" if f"{{{key}}}" in path else getattr(answers, key)
        plan = ImportMap(
            unit=unit,  # type: ignore[arg-type]
            time=first.time,
            sensors=tuple(sensors),
            trials=changed(trials, path=path),
            facts=Facts(action=answers.whole_action, **facts),  # type: ignore[arg-type]
            actions=dict(sorted(actions.items())) | answers.actions,
            events=events,
        )
        files = {one.log.name: one.files for one in self.samples}
        self.found.plans.append((plan, files))

    def _hand(self) -> tuple[str, list[SensorColumns]]:
        """(unit, "" where it is not known; the sensors with their signs), and what is asked."""
        first, answers, ask = self.samples[0], self.answers, self.found.ask
        events = self.events
        if first.time is None:
            ask("--rate", HOW_MANY_ROWS)
        effects = np.median([one.effects for one in self.samples], axis=0)
        cells = first.columns.get(events.column) if events else None
        begin = "" if cells is None else text_cells(cells[:1])[0]
        if events and events.labels.get(begin, "") not in ("", "nothing"):
            # the hand is closed in the first rows: what a touch changes is not seen
            effects[1:] = 0.0

        sensors = first.sensors
        axis, share = normal_axis(effects[1].reshape(-1, 3))
        axis = axis if share >= MOST_SENSORS else NORMAL_AXIS
        if answers.normal:
            axis = AXES.index(answers.normal)
            order = [(axis + 1) % 3, (axis + 2) % 3, axis]
            axes = [[one.axes[k] for k in order] for one in sensors]
            sensors = [SensorColumns(*one) for one in axes]  # type: ignore[arg-type]
        elif axis != NORMAL_AXIS:
            most = f"a touch moves {AXES[axis]} most, the names say z"
            ask("--normal", f"{most}: which axis is normal? x, y, z")

        unit, why = first.size
        of_log = first.log.about.get("unit")
        if of_log in UNIT_OF:
            unit, why = str(of_log), "as the log says"
        if answers.unit:
            unit, why = answers.unit, "as given"
        if not unit:
            what = f"what unit have the readings ({why})"
            ask("--unit", f"{what}? nothing says it: {', '.join(UNIT_OF)}")
            return "", sensors

        self.found.add("unit", f"{unit}, {why}")
        returns = not any(one.touched[-10:].any() for one in self.samples)
        signed = oriented(sensors, effects, unit, axis, returns=returns)
        if signed != sensors:
            self.found.add("signs", "turned where a press lowers the normal reading")
        return unit, signed

    # -- trials

    def _trial_rules(self) -> TrialRules:
        """Columns of names and of trials."""
        rules: dict[str, str] = {}
        for name, column in self.samples[0].columns.items():
            key = _key_of(name)
            kinds = set(text_cells(column[::7])) if key else set()
            means = key != "action" or all(map(action_of_word, kinds))
            is_name = means and len(kinds) <= max(1, len(column) // 20)
            if key and is_name and not getattr(self.answers, key, ""):
                rules.setdefault(key, name)

        for name in self.samples[0].marks:
            if self._is_action(name, rules.get("column", "")):
                rules.setdefault("action", name)
        return TrialRules(fingers=self.fingers, **rules)

    def _is_action(self, name: str, trials: str) -> bool:
        """Whether a column says what each trial is: words of actions that change with it alone.

        trials: the column of their numbers; "" where a log is a trial.
        """
        words: set[str] = set()
        for columns in (one.columns for one in self.samples if name in one.columns):
            kinds = pd.Series(text_cells(columns[name]))
            of_trial = columns.get(trials, np.zeros(len(kinds)))
            if kinds.groupby(of_trial).nunique().max() > 1:
                return False
            words |= {*kinds}
        actions = {*map(action_of_word, words)}
        return len(actions) > 1 and None not in actions and not self.answers.action

    # -- labels

    def _events(self, trials: TrialRules) -> EventRules | None:
        """Labels from a table of events, else from a column; what only the action says is asked.

        Of several columns that may hold labels, the one with the fewest labels without a meaning
        is taken, of equal ones the first that marks a slip. One label without a meaning is what
        the action says, where that is given.
        """
        known = {}
        for word, action in self.answers.actions.items():
            known[word] = situation_of(action)
        found = self._of_tables(trials, known)
        if found is None:
            found = min(self._of_columns(trials, known), key=_rank, default=None)
            if found is None:
                return None
            self.found.add("labels", f"column {found.rules.column}, {found.text}")
        rules, unknown = found.rules, found.unknown
        self.is_told = not found.is_contact
        if not unknown:
            return rules
        situation = situation_of(self.answers.whole_action)
        if not situation or len(unknown) > 1:
            words = listed([repr(one) for one in unknown], most=6)
            where = f"column {rules.column}" if rules.column else rules.file
            answer = f'"{unknown[0]}=slip" (or pass, hold, ..)'
            what = f"what is {words} in {where}? nothing in the logs says it: {answer}"
            self.found.ask("--action", what)

        return changed(rules, labels={**rules.labels, unknown[0]: situation})

    def _of_columns(
        self, trials: TrialRules, known: dict[str, str]
    ) -> list[FoundLabels]:
        """What the columns of labels mean."""
        labels: list[FoundLabels] = []
        for name in dict.fromkeys(key for one in self.samples for key in one.marks):
            if _key_of(name) or name == trials.action:
                continue
            with_it = [one for one in self.samples if name in one.columns]
            cells = [cell for one in with_it for cell in text_cells(one.columns[name])]
            touched = np.concatenate([one.touched for one in with_it])
            found = labels_of(name, np.array(cells, object), touched, known)
            labels += [found] if found else []

        return labels

    def _of_tables(
        self, trials: TrialRules, known: dict[str, str]
    ) -> FoundLabels | None:
        """What the first table of events means; tables that hold none are named.

        A table is a file beside the logs, or a stream of the log that has no readings. Its trials
        are called by what the logs are called by, or by what stands in their column of trials.
        """
        first = self.samples[0]
        root = self.source if self.source.is_dir() else self.source.parent
        keys = {key for sample in self.samples for key in sample.log.keys}
        if trials.column:
            keys |= set(map(str.casefold, text_cells(first.columns[trials.column])))
        chosen: FoundLabels | None = None
        place = ""
        labels: dict[str, str] = {}
        for log in [*self.tables, first.log]:
            name = log.path.name
            file = log.path.relative_to(root).as_posix()
            for one in self.samples:
                stem = rf"(?<![^\W_]){re.escape(one.log.path.stem)}(?![^\W_])"
                file = re.sub(stem, "{name}", name) if re.search(stem, name) else file
            for stream in log.streams:
                columns = stream.columns
                if stream.t_ns is not None or {*first.form} & columns.keys():
                    continue
                found = rules_of_table(columns, keys, file, known)
                if found and chosen is None:
                    rules = timed(found.rules, columns, first.stamps_s)
                    chosen, place = replace(found, rules=rules), name
                is_used = chosen is not None and chosen.rules.start in columns
                if found and is_used:
                    # other logs have labels of their own
                    labels = found.rules.labels | labels
                elif not is_used:
                    names = listed(list(columns), most=8)
                    self.found.add("not used", f"{name} (columns {names})")

        if chosen:
            rules = changed(chosen.rules, labels=labels)
            chosen = replace(chosen, rules=rules)
            what = listed(
                [*filter(None, [rules.start, rules.end, rules.label, rules.trial])]
            )
            self.found.add("labels", f"{place}: {what}, in {rules.unit}; {chosen.text}")
        return chosen

    # -- names

    def _path(self) -> tuple[str, list[str]]:
        """([trials] path where all names are built alike and say something, words of actions).

        >>> # p3/ball/slip_1 and p4/ball/pass_2 give "{person}/{object}/{action}_{trial}"
        """
        split = [_words(one.log.name) for one in self.samples]
        marks = split[0][::2]
        if any(one[::2] != marks for one in split):
            return "", []
        words = [*zip(*(one[1::2] for one in split), strict=True)]
        fields: dict[str, int] = {}
        unclear = []
        for k, of_place in enumerate(words):
            kind = self._kind(of_place)
            first = fields.setdefault(kind, k)
            # grasp_cup_slip and grasp_cup_hold differ in the last one
            is_more = len({*of_place}) >= len({*words[first]})
            if kind == "trial" or (kind == "action" and is_more):
                fields[kind] = k
            unclear += [k] if kind == "unclear" else []

        if fields.get("trial") != len(words) - 1:
            fields.pop("trial", None)
        # what is left beside a person or an action is what was held
        left = fields.pop("unclear", -1)
        is_left = fields.keys() & {"action", "person"}
        thing = fields.pop("thing", left if is_left else -1)
        fields.pop("", None)
        if thing >= 0:
            fields.setdefault("object", thing)
        for k in unclear:
            if "/" in "".join(marks[k + 1 :]) or k in fields.values():
                self._ask_person(words[k], fields)

        if not fields.keys() - {"trial"}:
            return "", []
        parts = [one[0] if len(set(one)) == 1 else "*" for one in words]
        for key, k in sorted(fields.items(), key=lambda one: one[1]):
            parts[k] = f"{{{key}}}"
            shown = listed(list(dict.fromkeys(words[k])), 6)
            self.found.add("names", f"{key}: {shown}")

        path = "".join(map("".join, zip(marks, [*parts, ""], strict=True)))
        return path, list(words[fields["action"]]) if "action" in fields else []

    def _kind(self, words: Sequence[str]) -> str:
        """What words at one place of paths are: a key of NAMES, trial, thing, unclear, or ""."""
        answers = self.answers
        for key in NAMES:
            if {*words} <= {*getattr(answers, key).split(",")}:
                return key
        # an empty-bottle is a thing, although empty says that nothing is held
        are_things = all(OBJECT.match(word) or named_mass(word) for word in words)
        if all(map(self._action, words)) and not are_things:
            return "" if answers.whole_action else "action"
        if all(map(PERSON.fullmatch, words)):
            return "" if answers.person else "person"
        if all(map(NUMBERED.fullmatch, words)):
            return "trial"
        if answers.object:
            return ""
        return "thing" if are_things else "unclear"

    def _action(self, word: str) -> str | None:
        """The action that a word of a path or a column means; None for another word."""
        known = self.answers.actions.get(word)
        return known or action_of_word(word, has_events=self.events is not None)

    def _ask_person(self, words: Sequence[str], fields: dict[str, int]) -> None:
        """Ask whether words of the paths are people, where that changes what is held out."""
        names = list(dict.fromkeys(words))
        # held out by trial or by people with a trial each is the same
        is_same = len(names) in (1, len(words))
        if is_same or "person" in fields or self.answers.person:
            return
        what = f"are {listed(names, most=6)} people or objects? nothing in the logs says it"
        answer = ",".join(names)
        self.found.ask("--person", f"{what}: --person {answer} or --object {answer}")


def _rank(found: FoundLabels) -> tuple[int, bool]:
    return len(found.unknown), "risky_slip" not in found.rules.labels.values()


def _words(path: str) -> list[str]:
    """The words of a path, with what stands before, between and behind them."""
    words = WORD.split(path)
    has_action = any(map(action_of_word, (one for one in words if "-" not in one)))
    parted: list[str] = []
    for word in words:
        # put-down and no-slip are one word
        is_one = action_of(word) or re.fullmatch(TOGETHER, word)
        parted += [word] if is_one else _ends_parted(word, has_action)
    return parted


def _ends_parted(word: str, has_action: bool) -> list[str]:
    """People, an action and numbers at the ends of words joined by dashes, and what is between.

    p01-slip-1 are three words and pass-empty-bottle two, but soft-ball is one. has_action: whether
    another word of the path is the action.
    """

    def is_name(part: str) -> bool:
        is_action = not has_action and action_of_word(part) not in (None, "nothing")
        return is_action or bool(PERSON.fullmatch(part))

    parts = PART.split(word)[1:-1]
    if not any(map(is_name, parts)):
        return [word]
    before: list[str] = []
    after: list[str] = []
    while len(parts) > 1 and (is_name(parts[0]) or NUMBERED.fullmatch(parts[0])):
        before += parts[:2]
        parts = parts[2:]
    while len(parts) > 1 and (is_name(parts[-1]) or NUMBERED.fullmatch(parts[-1])):
        after = parts[-2:] + after
        parts = parts[:-2]
    return [*before, "".join(parts), *after]


def _key_of(column: str) -> str:
    """What a column names by its heading: a key of NAMED, or ""."""
    return next((key for key, words in NAMED.items() if words_of(column) & words), "")
