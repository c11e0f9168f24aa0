"""Logs of one form: their map, what was understood of them in words, and what is asked.

A form is a set of columns. Folders of a study often hold logs of two forms, such as those of two
hands, or those before and after a change of the firmware. Each form gets a map of its own.

The order in which a map is made: time and sensors, then the columns that name trials, then labels,
then unit and signs, then the words of the paths. Each needs what comes before it: a label says when
the hand is empty, and the unit says how far a reading is from rest.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace as changed

from holdfast.core.column_map import SensorColumns
from holdfast.core.contract import AXES, NORMAL_AXIS, UNIT_OF
from holdfast.core.errors import listed
from holdfast.core.trial_layout import SITUATION_OF_ACTION, named_mass
from holdfast.interop.columns import (
    Touch,
    normal_axis,
    oriented,
    sensor_of,
    unit_of_names,
    words_of,
)
from holdfast.interop.labels import (
    FoundLabels,
    action_of_word,
    labels_of,
    rules_of_table,
    unit_and_zero,
)
from holdfast.interop.map import NAMES, EventRules, Facts, ImportMap, TrialRules
from holdfast.interop.streams import (
    LOG_TIME,
    text_cells,
)
from holdfast.interop.understood import Answers, Sample, Understood
from holdfast.training.datasets.trials import action_of

PERSON = re.compile(r"(?i)(p|s|vp|sub|subj|subject|person|participant|user)[- ]?\d+")
NUMBERED = re.compile(
    r"(?i)(trial|run|rep|take|t|r|episode|rec|recording|log|test|nr|no|file|data|session|day|set)?"
    r"([- ]?\d+)+"
)
NAMED = {
    "person": {"person", "subject", "participant", "user"},
    "object": {"object", "item", "obj"},
    "action": {"action", "condition", "task"},
    "column": {"trial", "run", "episode", "rep", "repetition", "recording", "sheet"},
}
"""Words of columns that hold what a trial is called by, or its number."""
OBJECTS = {
    "ball", "block", "book", "bottle", "bowl", "box", "can", "cube", "cup", "cylinder", "egg",
    "glass", "mug", "object", "pen", "sponge",
}  # fmt: skip
"""Words of objects in paths; others may be people."""
SOME_ACTIONS = "slip, hold, pull, fall, pass, put-down, nothing, .."


# -- one form of log


@dataclass
class Form:
    """Logs of one form, to be understood.

    found: where lines and questions are added. source: the folder or the file that was given.
    samples: the logs, shortened. tables: what lies beside them and holds no readings. fingers: the
    words of the files of one trial, () where a trial is one file. answers: of the command line.
    """

    found: Understood
    source: Path
    samples: list[Sample]
    tables: list[Sample]
    fingers: tuple[str, ...]
    answers: Answers

    def understand(self) -> None:
        """Add the map of the logs, its lines and its questions.

        No map is added while the time or the unit is asked for: it could not be written down.
        """
        first, answers, found = self.samples[0], self.answers, self.found
        found.add("time", first.time.why if first.time else "not known")
        names = f"{', '.join(first.form[:3])} to {', '.join(first.form[-3:])}"
        found.add("sensors", f"{len(first.sensors)}, {first.why}: {names}")
        rules = self._trial_rules()
        self.touched = [one.touched for one in self.samples]
        events = self._events(rules)
        unit, sensors = self._hand(events)
        path, actions = self._path(has_events=events is not None)
        for sample in self.samples if rules.action else ():
            for word in set(text_cells(sample.columns[rules.action])):
                actions[word] = action_of_word(word) or word

        rules = changed(rules, path=path)
        about = all(one.log.about.get("action") for one in self.samples)
        if not (
            events or answers.action or about or rules.action or "{action}" in path
        ):
            what = "what happens in these trials? nothing in the logs says it"
            found.ask("--action", f"{what}: {SOME_ACTIONS}")

        used = {
            *first.form,
            events.column if events else "",
            *self._named_columns(rules),
        }
        used |= {first.time.time.column if first.time else ""}
        unused = [
            name
            for one in first.log.streams
            for name in one.columns
            if name not in used
        ]
        if unused:
            found.add("not used", listed(unused, most=12))
        if not first.time or not unit:
            return
        facts = {
            key: getattr(answers, key) for key in NAMES if f"{{{key}}}" not in path
        }
        plan = ImportMap(
            unit=unit,  # type: ignore[arg-type]
            time=first.time.time,
            sensors=tuple(sensors),
            trials=rules,
            facts=Facts(**{**facts, "action": answers.whole_action}),
            actions={**actions, **answers.actions},
            events=events,
        )
        found.plans.append((plan, {one.log.name: one.files for one in self.samples}))

    def _hand(self, events: EventRules | None) -> tuple[str, list[SensorColumns]]:
        """(unit, "" where it is not known; the sensors with their signs), and what is asked."""
        first, answers, found = self.samples[0], self.answers, self.found
        if first.time is None:
            what = "how many rows a second have the logs? nothing says it"
            found.ask("--rate", f"{what}: a number in Hz")

        effects = np.median([one.effects for one in self.touched], axis=0)
        if self._begins_held(events):
            # what a touch changes is not seen
            effects[1:] = 0.0

        returns = all(one.returns for one in self.touched)
        of_all = Touch(effects, self.touched[0].rows, returns)
        sensors = first.sensors
        axis = normal_axis(of_all)
        if answers.normal:
            axis = AXES.index(answers.normal)
            order = [(axis + 1) % 3, (axis + 2) % 3, axis]
            sensors = [sensor_of([one.axes[k] for k in order]) for one in sensors]
            effects = effects.reshape(3, -1, 3)[:, :, order].reshape(3, -1)
            of_all = replace(of_all, effects=effects)
        elif axis != NORMAL_AXIS:
            what = f"a touch moves {AXES[axis]} most, the names say z: which axis is normal?"
            found.ask("--normal", f"{what} x, y, z")

        unit, why = self._unit()
        if not unit:
            what = f"what unit have the readings ({why})? nothing says it"
            found.ask("--unit", f"{what}: {', '.join(UNIT_OF)}")
            return "", sensors

        found.add("unit", f"{unit}, {why}")
        signed = oriented(sensors, of_all, unit)
        if signed != sensors:
            found.add("signs", "turned where a press lowers the normal reading")
        return unit, signed

    def _begins_held(self, events: EventRules | None) -> bool:
        """Whether labels say that the hand is closed in the first rows."""
        column = self.samples[0].columns.get(events.column) if events else None
        if events is None or column is None:
            return False
        return events.labels.get(text_cells(column[:1])[0], "") not in ("", "nothing")

    def _unit(self) -> tuple[str, str]:
        """(unit, why), or ("", what is seen)."""
        first = self.samples[0]
        if self.answers.unit:
            return self.answers.unit, "as given"
        if first.log.about.get("unit") in UNIT_OF:
            return str(first.log.about["unit"]), "as the log says"
        named = unit_of_names(first.form)
        if named:
            return named, "by the names"
        return first.size

    # -- trials

    def _trial_rules(self) -> TrialRules:
        """Columns of names and of trials."""
        columns = self.samples[0].columns
        rules: dict[str, Any] = {"fingers": self.fingers}
        for key, words in NAMED.items():
            for name, column in columns.items():
                is_said = bool(getattr(self.answers, key, ""))
                if is_said or not words_of(name) & words:
                    continue
                kinds = set(text_cells(column[::7]))
                means = key != "action" or all(map(action_of_word, kinds))
                few = len(kinds) <= max(1, len(column) // 20)
                if means and few:
                    rules.setdefault(key, name)

        return TrialRules(**rules)

    def _named_columns(self, rules: TrialRules) -> set[str]:
        return {rules.column, rules.person, rules.object, rules.action} - {""}

    # -- labels

    def _events(self, rules: TrialRules) -> EventRules | None:
        """Labels from a table of events, else from a column; what only the action says is asked.

        Of several columns that may hold labels, the one with the fewest labels without a meaning
        is taken. One label without a meaning is what the action says, where that is given.
        """
        events = self._of_tables(rules)
        if events is not None:
            return events
        known = self._known()
        first = self.samples[0]
        taken = {*first.form, LOG_TIME, first.time.time.column if first.time else ""}
        labels: list[FoundLabels] = []
        for name in dict.fromkeys(key for one in self.samples for key in one.columns):
            is_name = any(words_of(name) & words for words in NAMED.values())
            is_mark = any(name in one.marks for one in self.samples)
            if name not in taken and not is_name and is_mark:
                cells, touched = self._cells(name)
                one = labels_of(name, cells, touched, known)
                labels += [one] if one else []

        if not labels:
            return None
        best = min(labels, key=lambda one: len(one.unknown))
        self.found.add("labels", best.why)
        if not best.unknown:
            return best.rules
        situation = SITUATION_OF_ACTION.get(
            action_of(self.answers.whole_action or "-") or ""
        )
        if situation is None or len(best.unknown) > 1:
            words = listed([repr(one) for one in best.unknown], most=6)
            what = f"what is {words} in column {best.rules.column}? nothing in the logs says it"
            self.found.ask(
                "--action", f'{what}: "{best.unknown[0]}=slip" (or pass, hold, ..)'
            )

        of_action = {best.unknown[0]: situation or ""}
        return changed(best.rules, labels={**best.rules.labels, **of_action})

    def _known(self) -> dict[str, str]:
        """Label -> situation, as the command line says."""
        known = {}
        for word, action in self.answers.actions.items():
            known[word] = SITUATION_OF_ACTION.get(action_of(action) or "", "")
        return known

    def _cells(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """(cells, whether something is touched) of a column of all logs, one after the other."""
        cells, touched = [], []
        for sample, found in zip(self.samples, self.touched, strict=True):
            if name in sample.columns:
                cells += text_cells(sample.columns[name])
                touched.append(found.rows)

        return np.array(cells, dtype=object), np.concatenate(touched)

    def _of_tables(self, rules: TrialRules) -> EventRules | None:
        """Rules of the first table of events; tables that hold none are named.

        A table is a file beside the logs, or a stream of the log that has no readings. Its trials
        are called by what the logs are called by, or by what stands in their column of trials.
        """
        first, root = self.samples[0], self.source
        root = root if root.is_dir() else root.parent
        keys: set[str] = set()
        for sample in self.samples:
            keys |= sample.log.keys
        if rules.column:
            keys |= set(map(str.casefold, text_cells(first.columns[rules.column])))
        others = []
        for table in [*self.tables, first]:
            for stream in table.log.streams:
                is_readings = bool({*first.form} & stream.columns.keys())
                if not is_readings and stream.t_ns is None:
                    others.append((table.log.path, stream))

        chosen: EventRules | None = None
        for path, stream in others:
            file = path.relative_to(root).as_posix()
            if first.log.path.stem in path.name:
                file = path.name.replace(first.log.path.stem, "{name}")
            events = rules_of_table(stream.columns, keys, file, self._known())
            if events is None or chosen:
                if not chosen or chosen.start not in stream.columns:
                    names = listed(list(stream.columns), most=8)
                    self.found.add("not used", f"{path.name} (columns {names})")
                continue
            latest = float(np.nanmax(stream.columns[events.start].astype(np.float64)))
            first_s, last_s = float(first.stamps_s[0]), float(first.stamps_s[-1])
            unit, zero = unit_and_zero(events, latest, first_s, last_s)
            chosen = changed(events, unit=unit, zero=zero)
            what = [events.start, events.end, events.label, events.trial]
            self.found.add(
                "labels", f"{path.name}: {listed([*filter(None, what)])}, in {unit}"
            )

        return chosen

    # -- names

    def _path(self, *, has_events: bool) -> tuple[str, dict[str, str]]:
        """([trials] path where all names are built alike and say something, [actions]).

        >>> # p3/ball/slip_1 and p4/ball/pass_2 give "{person}/{object}/{action}_{trial}"
        """
        actions: dict[str, str] = {}
        split = [re.split(r"([/_ .]+)", one.log.name) for one in self.samples]
        first = split[0]
        if any(len(one) != len(first) or one[1::2] != first[1::2] for one in split):
            return "", actions
        tokens = [[one[k] for one in split] for k in range(0, len(first), 2)]
        fields, unclear = _fields(tokens, self.answers, has_events=has_events)
        for k in unclear:
            is_folder = "/" in "".join(first[2 * k :])
            if is_folder or k in fields.values():
                self._ask_person(tokens[k], fields)

        if not set(fields) - {"trial"}:
            return "", actions
        at = {k: key for key, k in fields.items()}
        parts = []
        for k, values in enumerate(tokens):
            same = values[0] if len(set(values)) == 1 else "*"
            parts.append(f"{{{at[k]}}}" if k in at else same)

        for key, k in fields.items():
            names = list(dict.fromkeys(tokens[k]))
            self.found.add("names", f"{key}: {listed(names, most=6)}")
            for word in names if key == "action" else []:
                meant = action_of_word(word, has_events=has_events) or word
                if action_of(word) != meant:
                    actions[word] = meant

        path = "".join(a + b for a, b in zip(parts, [*first[1::2], ""], strict=True))
        return path, actions

    def _ask_person(self, words: list[str], fields: dict[str, int]) -> None:
        """Ask whether words of the paths are people, where that changes what is held out."""
        names = list(dict.fromkeys(words))
        is_known = "person" in fields or self.answers.person or self.answers.object
        if is_known or len(names) < 2 or all(map(_is_object, names)):
            return
        shown, answer = listed(names, most=6), ",".join(names)
        options = f"--person {answer} or --object {answer}"
        # held out by trial or by people with a trial each is the same
        if len(names) == len(words):
            self.found.add("names", f"{shown}: taken as no people; {options}")
            return

        what = f"are {shown} people or objects? nothing in the logs says it"
        self.found.ask("--person", f"{what}: {options}")


def _is_object(word: str) -> bool:
    """Whether a word of a path is an object that is known."""
    return bool(words_of(word) & OBJECTS) or named_mass(word) is not None


def tokens_of(name: str) -> list[str]:
    """The words of a path."""
    return re.split(r"[/_ .]+|-(?=[A-Za-z])", name)


def _fields(
    tokens: list[list[str]], answers: Answers, *, has_events: bool
) -> tuple[dict[str, int], list[int]]:
    """(person, object, action and trial -> which of the words of the paths it is; unclear ones).

    tokens: for each place in the paths, the words of all logs there. What the command line names
    comes first, then actions, then people such as `p07`, then the number of the trial; one place
    that is left may be the object.
    """
    fields: dict[str, int] = {}
    unclear = []
    free = [key for key in NAMES if not getattr(answers, key)]
    for k, values in enumerate(tokens):
        said = [
            key for key in NAMES if {*values} <= {*getattr(answers, key).split(",")}
        ]
        words = [
            answers.actions.get(word) or action_of_word(word, has_events=has_events)
            for word in values
        ]
        if said:
            fields.setdefault(said[0], k)
        elif all(words) and not answers.whole_action:
            fields.setdefault("action", k)
        elif all(map(PERSON.fullmatch, values)) and "person" in free:
            fields.setdefault("person", k)
        elif k == len(tokens) - 1 and all(map(NUMBERED.fullmatch, values)):
            fields["trial"] = k
        elif k and tokens[k - 1] and all(map(NUMBERED.fullmatch, values)):
            continue
        elif values[0] and "object" in free:
            # what is left beside a person or an action is what was held
            fields.setdefault("object", k)
            unclear.append(k)

    if not {"action", "person"} & fields.keys() and "object" in free:
        fields.pop("object", None)
    return fields, unclear
