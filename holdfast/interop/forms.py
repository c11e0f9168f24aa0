"""Logs of one form: their map, what was understood of them in words, and what is asked.

A form is a set of columns. Folders of a study often hold logs of two forms, such as those of two
hands, or those before and after a change of the firmware. Each form gets a map of its own.

The order in which a map is made: time and sensors, then the columns that name trials, then labels,
then unit and signs, then the words of the paths. Each needs what comes before it: a label says when
the hand is empty, and the unit says how far a reading is from rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from msgspec.structs import replace as changed

from holdfast.core.column_map import SensorColumns
from holdfast.core.contract import AXES, NORMAL_AXIS, UNIT_OF, valid_names
from holdfast.core.errors import listed
from holdfast.core.hand_card import too_many
from holdfast.data.datasets.trials import action_of
from holdfast.interop.evidence import Evidence, best
from holdfast.interop.labels import (
    FoundLabels,
    action_of_sentence,
    labels_of,
    rules_of_table,
    timed,
)
from holdfast.interop.logs import SCALARS, other_word, paired
from holdfast.interop.map import NAMES, EventRules, Facts, ImportMap, TrialRules
from holdfast.interop.names import names_of_paths
from holdfast.interop.sensors import moved_most, oriented
from holdfast.interop.streams import LOG_TIME, ForeignLog, merged, text_cells
from holdfast.interop.tables import pd
from holdfast.interop.understood import Answers, Sample, Understood
from holdfast.interop.words import NAMED, says

HOW_MANY_ROWS = "how many rows a second have the logs? nothing says it: a number in Hz"
WHAT_HAPPENS = (
    "what happens in these trials? nothing in the logs says it: slip, hold, pull, fall, pass, "
    "put-down, nothing, .."
)


@dataclass
class Form:
    """Logs of one form, to be understood.

    found: where lines and questions are added. source: the folder or the file that was given.
    samples: the logs, without their readings. tables: what lies beside them and holds none.
    fingers: the words of the files of one trial, () where a trial is one file. answers: of the
    command line.
    """

    found: Understood
    source: Path
    samples: list[Sample]
    tables: list[ForeignLog]
    fingers: tuple[str, ...]
    answers: Answers

    def understand(self) -> None:
        """Add the map of the logs, its lines and its questions.

        No map is added while the time or the unit is asked for: it could not be written down.
        """
        first, answers, add = self.samples[0], self.answers, self.found.add
        names, time = first.names, first.time
        if time is None:
            self.found.ask("--rate", HOW_MANY_ROWS)
        add("time", time or "not known")
        spelled = f"{', '.join(names[:3])} to {', '.join(names[-3:])}"
        add("sensors", f"{len(names) // 3}, {first.sensors}: {spelled}")
        wrong = too_many(len(names) // 3)
        if wrong:
            add("note", f"{wrong}: take those out of the map that do not matter")
        trials, actions = self._trial_rules()
        labels = self._labels(trials)
        unit, sensors = self._hand(labels)
        of_paths = names_of_paths([one.log.name for one in self.samples], answers)
        for key, words in of_paths.names.items():
            add("names", f"{key}: {listed(words, 6)}")
        for question in of_paths.questions:
            self.found.ask(*question)
        for word in of_paths.names.get("action", ()):
            actions[word] = answers.actions.get(word) or str(action_of_sentence(word))

        about = all(one.log.about.get("action") for one in self.samples)
        if not (labels or answers.whole_action or about or actions):
            self.found.ask("--action", WHAT_HAPPENS)
        rules = labels.rules if labels else EventRules(column=LOG_TIME)
        used = {
            time.value.column if time else "",
            *(rules.column, rules.start, rules.end, rules.label, rules.trial),
            *(trials.column, trials.person, trials.object, trials.action),
            *valid_names(len(names) // 3),
        }
        there = merged(first.log) | first.columns
        unused = [name for name in there if name not in (*used, LOG_TIME)]
        if unused:
            add("not used", listed(unused, most=12))
        if time is None or not unit:
            return
        facts = {}
        for key in NAMES[:2]:
            facts[key] = "" if f"{{{key}}}" in of_paths.path else getattr(answers, key)
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
            facts=Facts(action=answers.whole_action, **facts),  # type: ignore[arg-type]
            actions=dict(sorted(others.items())) | given,
            events=labels.rules if labels else None,
            unwrap=answers.unwrap,
        )
        files = {one.log.name: one.files for one in self.samples}
        self.found.plans.append((plan, files))

    def _hand(self, labels: FoundLabels | None) -> tuple[str, list[SensorColumns]]:
        """(unit, "" where it is not known; the sensors with their signs), and what is asked."""
        first, answers, ask = self.samples[0], self.answers, self.found.ask
        effects = np.median([one.effects for one in self.samples], axis=0)
        cells = first.columns.get(labels.rules.column) if labels else None
        begin = "" if cells is None else text_cells(cells[:1])[0]
        if labels and labels.rules.labels.get(begin, "") not in ("", "nothing"):
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
            ask("--normal", f"{most}: which axis is normal? x, y, z")

        unit = best(
            Evidence(answers.unit, "as given") if answers.unit else None,
            first.unit if isinstance(first.unit, Evidence) else None,
        )
        if unit is None:
            what = f"what unit have the readings ({first.unit})"
            ask("--unit", f"{what}? nothing says it: {', '.join(UNIT_OF)}")
            return "", sensors

        self.found.add("unit", f"{unit.value}, {unit}")
        signed = oriented(sensors, effects, unit.value, axis)
        if signed != sensors:
            self.found.add("signs", "turned where a press lowers the normal reading")
        return unit.value, signed

    # -- trials

    def _trial_rules(self) -> tuple[TrialRules, dict[str, str]]:
        """(the columns of names and of trials, what the words of actions in them mean)."""
        rules: dict[str, str] = {}
        actions: dict[str, str] = {}
        for name, column in self.samples[0].columns.items():
            key = next((key for key, words in NAMED.items() if says(name, words)), "")
            if not key or key in rules or (key in NAMES and getattr(self.answers, key)):
                continue
            with_it = [one.columns[name] for one in self.samples if name in one.columns]
            kinds = {word for one in with_it for word in text_cells(pd.unique(one))} - {
                ""
            }
            if key == "action":
                meant = {
                    word: self.answers.actions.get(word) or action_of_sentence(word)
                    for word in kinds
                }
                if None in meant.values() or not meant:
                    continue
                actions = {word: str(action) for word, action in meant.items()}
            if len(kinds) <= max(1, len(column) // 20):
                rules[key] = name
        return TrialRules(fingers=self.fingers, **rules), actions

    # -- labels

    def _labels(self, trials: TrialRules) -> FoundLabels | None:
        """Labels from a table of events, else from a column; what is not clear is asked."""
        columns = [*self._of_tables(trials), *self._of_columns(trials)]
        # those that say all first, then those that mark a slip
        found = min(columns, key=_rank, default=None)
        if found is None:
            return None
        rules = found.rules
        where = f"column {rules.column}"
        if rules.file:
            named = filter(None, [rules.start, rules.end, rules.label, rules.trial])
            times = f"in {rules.unit}, checked: the last event lies within a log"
            where = f"{rules.file}: {listed([*named])}, {times}"
        self.found.add("labels", f"{where}; {found.text}")
        if found.unknown:
            words = listed([repr(one) for one in found.unknown], most=8)
            answer = ",".join(f"{one}=slip" for one in found.unknown[:1])
            what = f"what is {words} in {where}? nothing in the logs says it: "
            self.found.ask("--action", f'{what}"{answer}" (or pass, hold, nothing, ..)')
        return found

    def _of_columns(self, trials: TrialRules) -> list[FoundLabels]:
        """What the columns of labels mean."""
        names = {trials.column, trials.person, trials.object, trials.action}
        labels: list[FoundLabels] = []
        for name in dict.fromkeys(key for one in self.samples for key in one.marks):
            with_it = [one for one in self.samples if name in one.columns]
            cells = [cell for one in with_it for cell in text_cells(one.columns[name])]
            found = labels_of(name, cells, self.answers.situations)
            labels += [found] if found and name not in names else []
        return labels

    def _of_tables(self, trials: TrialRules) -> list[FoundLabels]:
        """What tables of events mean; tables that hold none, or pair with no log, are named.

        A table is a file beside the logs, or a stream of the log that has no readings. It is that
        of all logs where it names its trials: by what the logs are called by, or by what stands in
        their column of trials. Tables beside a log each are one, with the labels of all.
        """
        first = self.samples[0]
        root = self.source if self.source.is_dir() else self.source.parent
        keys = {key for sample in self.samples for key in sample.log.keys}
        if trials.column:
            keys |= set(map(str.casefold, text_cells(first.columns[trials.column])))
        pairs = paired(
            [one.log.name for one in self.samples], [one.name for one in self.tables]
        )
        log_of = {table: log for log, table in pairs.items()}
        parts: dict[tuple[str, str], list[pd.DataFrame]] = {}
        for log in [*self.tables, first.log]:
            file = log.path.relative_to(root).as_posix()
            if log.name in log_of:
                word = other_word(log_of[log.name], log.name)
                file = f"*{word}*{log.path.suffix}".replace("**", "*")
            for stream in log.streams:
                if stream.t_ns is None:
                    table = pd.DataFrame(stream.columns)
                    parts.setdefault((file, stream.name), []).append(table)
        labels: list[FoundLabels] = []
        for (file, title), tables in parts.items():
            whole = pd.concat(tables, join="inner")
            columns = {str(name): cells.to_numpy() for name, cells in whole.items()}
            found = rules_of_table(columns, keys, file, self.answers.situations)
            is_paired = "*" in file or (root / file) == first.log.path
            if found and (found.rules.trial or is_paired):
                spans_s = [one.span_s for one in self.samples]
                rules = timed(found.rules, columns, spans_s)
                if rules is None:
                    what = f"{found.rules.start} of {file} lies in no log in {found.rules.unit}"
                    self.found.ask("--map", f"{what}: write unit and zero of [events]")
                labels.append(replace(found, rules=rules or found.rules))
            elif title or not file.endswith(SCALARS):
                # facts are columns of their log
                self.found.add("not used", f"{file} (columns {listed([*columns])})")
        return labels


def _rank(found: FoundLabels) -> tuple[bool, int, bool]:
    return (
        not any(found.rules.labels.values()),
        len(found.unknown),
        "risky_slip" not in found.rules.labels.values(),
    )
