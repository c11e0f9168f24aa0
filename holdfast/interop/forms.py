"""Logs of one form: their map, what was understood of them in words, and what is asked.

A form is a set of columns. Folders of a study often hold logs of two forms, such as those of two
hands, or those before and after a change of the firmware. Each form gets a map of its own.

The order in which a map is made: time and sensors, then the columns that name trials, then labels,
then unit and signs, then the words of the paths. Each needs what comes before it: a label says when
the hand is empty, and the unit says how far a reading is from rest.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from msgspec.structs import astuple
from msgspec.structs import replace as changed

from holdfast.core.column_map import SensorColumns
from holdfast.core.contract import AXES, NORMAL_AXIS, UNIT_OF, valid_names
from holdfast.core.errors import listed
from holdfast.core.hand_card import too_many
from holdfast.data.datasets.trials import action_of
from holdfast.interop.evidence import Evidence
from holdfast.interop.formats.streams import LOG_TIME, Columns, ForeignLog, text_cells
from holdfast.interop.formats.tables import pd
from holdfast.interop.formats.writing import thumb_sensors
from holdfast.interop.joining import columns_of
from holdfast.interop.labels import LabelMeanings, labels_of, rules_of_table, zeros_of
from holdfast.interop.map import NAMES, EventRules, Facts, ImportMap, TrialRules
from holdfast.interop.names import names_of_paths, words_of_path
from holdfast.interop.proposal import Answers, Proposal, Sample
from holdfast.interop.sensors import moved_most, oriented
from holdfast.interop.words import NAMED, is_called

HOW_MANY_ROWS = "how many rows a second have the logs? nothing says it: a number in Hz"
WHAT_HAPPENS = (
    "what happens in these trials? nothing in the logs says it: slip, hold, pull, fall, pass, "
    "put-down, nothing, .."
)
ZEROS = {"log": "their begin", "clock": "0 of their clock"}
"""From where the times of events may count."""


@dataclass
class Form:
    """Logs of one form, to be understood.

    found: where lines and questions are added. source: the folder or the file that was given.
    samples: the logs, without their readings. tables: what lies beside them and holds none.
    fingers: the words of the files of one trial, () where a trial is one file. answers: of the
    command line.
    """

    found: Proposal
    source: Path
    samples: list[Sample]
    tables: list[ForeignLog]
    fingers: tuple[str, ...]
    answers: Answers
    _unclear: str = ""

    def understand(self) -> None:
        """Add the map of the logs, its lines and its questions.

        No map is added while the time or the unit is asked for: it could not be written down.
        """
        first, answers, found = self.samples[0], self.answers, self.found
        names, time = first.names, first.time
        n_sensors = len(first.sensors.value)
        if time is None:
            found.ask("--rate", HOW_MANY_ROWS)
        found.add("time", time or "not known")
        spelled = f"{', '.join(names[:3])} to {', '.join(names[-3:])}"
        found.add("sensors", f"{n_sensors}, {first.sensors}: {spelled}")
        wrong = too_many(n_sensors)
        if wrong:
            found.add("note", f"{wrong}: take those out of the map that do not matter")
        n_thumb = thumb_sensors(first.sensors.value)
        if n_thumb:
            sides = f"the first {n_thumb} on the thumb's side"
            found.add("hand", f"proposed, {sides}: correct hand.toml of the set")
        trials, actions = self._trial_rules()
        labels = self._labels(trials)
        unit, sensors = self._hand(labels)
        of_paths = names_of_paths([one.log.name for one in self.samples], answers)
        for key, words in of_paths.names.items():
            found.add(
                "names", f"{key}: {listed(words, 6)}{self._not(key, words, trials)}"
            )
        for question in of_paths.questions:
            found.ask(*question)
        for word in of_paths.names.get("action", ()):
            actions[word] = str(answers.meaning(word))

        for word in self._unmet():
            found.ask("--action", f"{word!r} stands nowhere in these logs: take it out")
        is_said = labels or answers.whole_action or actions
        if not (is_said or all(one.log.about.get("action") for one in self.samples)):
            found.ask("--action", self._unclear or WHAT_HAPPENS)
        self._name_unused(trials, labels)
        if time is None or not unit:
            return
        said = {
            key: getattr(answers, key) for key in NAMES[:2] if key not in of_paths.names
        }
        given = {word: action for word, action in answers.actions.items() if action}
        # what is called as we call it needs no line
        others = {
            word: meant for word, meant in actions.items() if action_of(word) != meant
        }
        plan = ImportMap(
            unit=unit,  # type: ignore[arg-type]
            time=time.value,
            sensors=tuple(sensors),
            trials=changed(trials, path=of_paths.path),
            facts=Facts(action=answers.whole_action, **said),
            actions=dict(sorted(others.items())) | given,
            events=labels.rules if labels else None,
            unwrap=answers.unwrap,
        )
        found.plans.append((plan, {one.log.name: one.files for one in self.samples}))

    def _unmet(self) -> list[str]:
        """Words that were answered and stand in no path and no column."""
        if not self.answers.actions:
            return []
        met = {word for one in self.samples for word in words_of_path(one.log.name)}
        names = dict.fromkeys(name for one in self.samples for name in one.columns)
        met |= {cell for name in names for cell in self._cells(name, only_once=True)}
        for table in self._tables().values():
            met |= {
                cell
                for cells in columns_of(table).values()
                for cell in text_cells(cells)
            }
        return [word for word in self.answers.actions if word not in met]

    def _not(self, key: str, words: Sequence[str], trials: TrialRules) -> str:
        """What a column says that names trials, where their paths say something else."""
        column = getattr(trials, key, "")
        cells = [*filter(None, dict.fromkeys(self._cells(column, only_once=True)))]
        if {*map(str.casefold, cells)} <= {*map(str.casefold, words)}:
            return ""
        return f"; taken is column {column}: {listed(cells, 6)}"

    def _name_unused(self, trials: TrialRules, labels: LabelMeanings | None) -> None:
        """Add a line of the columns that are neither readings nor names, time or labels."""
        first = self.samples[0]
        rules = labels.rules if labels else EventRules(column=LOG_TIME)
        used = [LOG_TIME, *first.names, *valid_names(len(first.sensors.value))]
        used += [*astuple(trials), *astuple(rules)]
        used += [first.time.value.column] if first.time else []
        own = [one for one in first.log.streams if "*" not in one.name]
        there = [*(name for one in own for name in one.columns), *first.columns]
        unused = [name for name in dict.fromkeys(there) if name not in used]
        if unused:
            self.found.add("not used", listed(unused, most=12))

    def _hand(self, labels: LabelMeanings | None) -> tuple[str, list[SensorColumns]]:
        """(unit, "" where it is asked; the sensors with their signs)."""
        first, answers, found = self.samples[0], self.answers, self.found
        effects = np.median([one.effects for one in self.samples], axis=0)
        if labels and labels.rules.column in first.columns:
            begin = text_cells(first.columns[labels.rules.column][:1])[0]
            if labels.rules.labels.get(begin, "") not in ("", "nothing"):
                # the hand is closed in the first rows: what a touch changes is not seen
                effects[1:] = 0.0

        sensors = first.sensors.value
        axis = moved_most(effects[1].reshape(-1, 3))
        if answers.normal:
            axis = AXES.index(answers.normal)
            order = [(axis + 1) % 3, (axis + 2) % 3, axis]
            axes = [[one.axes[k] for k in order] for one in sensors]
            sensors = [SensorColumns(*one) for one in axes]  # type: ignore[arg-type]
        elif axis != NORMAL_AXIS:
            most = f"a touch moves {AXES[axis]} most, the names say z"
            found.ask("--normal", f"{most}: which axis is normal? x, y, z")

        sure = {one.unit.value for one in self.samples if not one.unit.check}
        differ = sure - {"", first.unit.value}
        unit = Evidence("", "not the same in all logs") if differ else first.unit
        unit = Evidence(answers.unit, "as given") if answers.unit else unit
        if not unit.value:
            what = f"what unit have the readings ({unit})"
            found.ask("--unit", f"{what}? one of {', '.join(UNIT_OF)}")
            return "", sensors

        found.add("unit", f"{unit.value}, {unit}")
        signed = oriented(sensors, effects, unit.value, axis)
        if signed != sensors:
            found.add("signs", "turned where a press lowers the normal reading")
        return unit.value, signed

    # -- trials

    def _trial_rules(self) -> tuple[TrialRules, dict[str, str]]:
        """(the columns of names and of trials, what the words of actions in them mean)."""
        rules: dict[str, str] = {}
        actions: dict[str, str] = {}
        columns = {
            name: one for sample in self.samples for name, one in sample.columns.items()
        }
        for name, column in columns.items():
            key = next(
                (key for key, words in NAMED.items() if is_called(name, words)), ""
            )
            given = {"action": self.answers.whole_action, "column": ""}
            if (
                not key
                or key in rules
                or given.get(key, getattr(self.answers, key, ""))
            ):
                continue
            if key == "column" and not self._is_in_turn(name):
                continue
            kinds = {*self._cells(name, only_once=True)} - {""}
            meant = {word: self.answers.meaning(word) for word in kinds}
            if key == "action" and (None in meant.values() or not meant):
                self._unclear = self._unclear or _what_is(kinds, f"column {name}")
                continue
            if len(kinds) <= max(1, len(column) // 20):
                rules[key] = name
            if key == "action":
                actions = {word: str(action) for word, action in meant.items()}
        return TrialRules(fingers=self.fingers, **rules), actions

    def _is_in_turn(self, name: str) -> bool:
        """Whether each value of a column has its rows in one piece, as a trial has."""
        for sample in self.samples:
            cells = pd.Series(sample.columns.get(name)).replace("", None).dropna()
            if (cells != cells.shift()).sum() > cells.nunique():
                return False
        return True

    def _cells(self, name: str, only_once: bool = False) -> list[str]:
        """The cells of a column of all logs that have it, one after the other."""
        columns = [one.columns[name] for one in self.samples if name in one.columns]
        whole = [pd.unique(one) for one in columns] if only_once else columns
        return [cell for one in whole for cell in text_cells(one)]

    # -- labels

    def _labels(self, trials: TrialRules) -> LabelMeanings | None:
        """Labels from a table of events, else from a column; what is not clear is asked."""
        columns = [*self._of_tables(trials), *self._of_columns(trials)]
        columns = [
            one for one in columns if self.answers.labels in ("", one.rules.place)
        ]
        # those that say all first, then those that mark a slip
        found = min(columns, key=self._rank, default=None)
        if found is None:
            return None
        rules = found.rules
        same = {
            self._said(one): one
            for one in columns
            if self._rank(one) == self._rank(found)
        }
        if len(same) > 1:
            both = listed([one.rules.place for one in same.values()])
            self.found.ask(
                "--labels", f"{both} say when it slips, and differ: which is true?"
            )
        where = f"column {rules.column}"
        if rules.file:
            named = filter(None, [rules.start, rules.end, rules.label, rules.trial])
            where = f"{rules.file}: {listed([*named])}, in {rules.unit}{found.check}"
        self.found.add("labels", f"{where}; {found.text}".removesuffix("; "))
        if found.unknown:
            self.found.ask("--action", _what_is(found.unknown, where))
        return found

    def _rank(self, found: LabelMeanings) -> tuple[bool, int, bool, bool]:
        """The smallest first: labels that mean something, all of them, and say when it slips."""
        labels, name = found.rules.labels.values(), found.rules.column
        columns = [one.columns[name] for one in self.samples if name in one.columns]
        is_same = bool(columns) and all(len(pd.unique(one)) < 2 for one in columns)
        return not any(labels), len(found.unknown), "risky_slip" not in labels, is_same

    def _said(self, found: LabelMeanings) -> tuple[str, ...]:
        """What labels say, to find those that differ."""
        rules = found.rules
        if rules.file:
            return (rules.file,)
        return tuple(rules.labels.get(cell, "") for cell in self._cells(rules.column))

    def _of_columns(self, trials: TrialRules) -> list[LabelMeanings]:
        """What the columns of labels mean."""
        labels: list[LabelMeanings] = []
        for name in dict.fromkeys(key for one in self.samples for key in one.marks):
            # what names an action is of the whole trial
            is_name = trials.action and is_called(name, NAMED["action"])
            if is_name or name in astuple(trials):
                continue
            found = labels_of(name, self._cells(name), self.answers.situations)
            labels += [found] if found else []
        return labels

    def _of_tables(self, trials: TrialRules) -> list[LabelMeanings]:
        """What tables of events mean; tables that hold none, or pair with no log, are named.

        A table is a file beside the logs, or a stream of the log that has no readings. It is that
        of all logs where it names its trials: by what the logs are called by, or by what stands in
        their column of trials. Tables beside a log each are one, with the labels of all.
        """
        first = self.samples[0]
        keys = {key for sample in self.samples for key in sample.log.keys}
        keys |= {*map(str.casefold, self._cells(trials.column, only_once=True))}
        labels: list[LabelMeanings] = []
        for (file, *_), whole in self._tables().items():
            columns = columns_of(whole)
            found = rules_of_table(columns, keys, file, self.answers.situations)
            is_own = "*" in file or file == first.log.path.name
            if found and (found.rules.trial or is_own):
                labels.append(self._checked(found, columns))
            elif not columns.keys() <= first.columns.keys():
                # facts are columns of their log
                self.found.add("not used", f"{file} (columns {listed([*columns])})")
        return labels

    def _checked(self, found: LabelMeanings, columns: Columns) -> LabelMeanings:
        """A table of events whose times lie in the logs; what else is possible is asked."""
        rules, file, ask = found.rules, found.rules.file, self.found.ask
        # a table in each folder is of the logs there
        is_of_all = rules.trial and "*" not in file
        for key in dict.fromkeys(text_cells(columns[rules.trial]) if is_of_all else ()):
            same = [
                one.log.name for one in self.samples if key.casefold() in one.log.keys
            ]
            if len(same) > 1:
                what = f"trial {key!r} of {file} is {listed(same, most=2)}"
                ask("SOURCE", f"{what}: name the logs there by their paths")
                break
        if found.starts:
            what = f"{', '.join(found.starts)} of {file} may be when it begins"
            ask("--map", f"{what}: write start of [events]")
        zeros = zeros_of(rules, columns, [one.span_s for one in self.samples])
        if len(zeros) == 1:
            (zero,) = zeros
            check = f", checked: all lie within the logs, from {ZEROS[zero]}"
            return replace(found, rules=changed(rules, zero=zero), check=check)
        both = f"both from {' and from '.join(ZEROS.values())}"
        where = (
            f"the logs in {rules.unit}, {both}" if zeros else f"no log in {rules.unit}"
        )
        what = f"{rules.start} of {file} lies in {where}"
        ask("--map", f"{what}: write unit and zero of [events]")
        return found

    def _tables(self) -> dict[tuple[str, ...], pd.DataFrame]:
        """The file, or what the files beside all logs are called, and columns -> a table."""
        root = self.source if self.source.is_dir() else self.source.parent
        parts: dict[tuple[str, ...], list[pd.DataFrame]] = {}
        for log in [*self.tables, *(one.log for one in self.samples)]:
            for stream in log.streams:
                file = log.path.relative_to(root).as_posix()
                place = (stream.name if "*" in stream.name else file, *stream.columns)
                if stream.t_ns is None:
                    parts.setdefault(place, []).append(pd.DataFrame(stream.columns))
        return {place: pd.concat(tables) for place, tables in parts.items()}


def _what_is(words: Collection[str], where: str) -> str:
    """The question what words mean."""
    shown = listed([repr(one) for one in sorted(words)], most=8)
    answer = f'"{min(words)}=slip" (or pass, hold, nothing, ..)' if words else ""
    return f"what is {shown} in {where}? nothing in the logs says it: {answer}"
