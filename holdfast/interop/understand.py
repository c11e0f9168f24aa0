"""What the logs of a folder are: a map for each form of log, a short table, and one question.

Everything is taken from what columns hold, then from names. What nothing in the logs says, and no
answer on the command line, is asked.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from holdfast.core.column_map import SensorColumns
from holdfast.core.contract import AXES, NORMAL_AXIS, UNIT_OF
from holdfast.core.errors import (
    DataError,
    EmptyRecording,
    listed,
)
from holdfast.core.trial_layout import SITUATION_OF_ACTION
from holdfast.interop.columns import (
    FoundTime,
    Touch,
    channels,
    find_sensors,
    find_time,
    normal_axis,
    oriented,
    touch,
    unit_of_names,
    unit_of_sizes,
    words_of,
)
from holdfast.interop.labels import (
    FoundLabels,
    LabelledRows,
    action_of_word,
    is_mark,
    labels_of,
    rules_of_table,
    unit_and_zero,
)
from holdfast.interop.logs import LogPlace, counted, find_logs, read_log, table_of
from holdfast.interop.map import NAMES, EventRules, Facts, ImportMap, TrialRules
from holdfast.interop.streams import (
    LOG_TIME,
    Columns,
    ForeignLog,
    is_text,
    text_cells,
)
from holdfast.interop.trials import by_trial, read_joined, without_finger
from holdfast.training.datasets.trials import action_of
from holdfast.training.progress import Part, ignored

PERSON = re.compile(
    r"(?i)(p|s|vp|sub|subj|subject|person|participant|user)[- ]?\d+|(person|subject|user)[- ]?\w+"
)
NUMBERED = re.compile(
    r"(?i)(trial|run|rep|take|t|r|episode|rec|recording|log|test|nr|no|file|data)?[- ]?\d+"
)
NAMED = {
    "person": {"person", "subject", "participant", "user"},
    "object": {"object", "item", "obj"},
    "action": {"action", "condition", "task"},
    "column": {"trial", "run", "episode", "rep", "repetition", "recording"},
}
"""Words of columns that hold what a trial is called by, or its number."""
FINGERS = ("thumb", "index", "middle", "ring", "little", "pinky", "palm", "finger")
JUDGED_ROWS = 200_000
"""Of a log; what it holds is seen from so many."""
JUDGED_LOGS = 8
LONG_GAP_S, LONG_GAP_STEPS = 0.5, 20.0
"""A step may be a gap between trials from so many seconds and so many usual steps on."""
OVERLAP = 0.7
"""Of the spans of files that belong to one trial."""


@dataclass(frozen=True)
class Answers:
    """What the command line says. action: a word for all trials, or `word=action,word=action`.

    person, object: a name, or several of those in the paths. normal: x, y or z.
    """

    action: str = ""
    person: str = ""
    object: str = ""
    unit: str = ""
    rate_hz: float | None = None
    normal: str = ""

    @property
    def actions(self) -> dict[str, str]:
        """Words of the logs -> actions."""
        pairs = [one.split("=", 1) for one in self.action.split(",") if "=" in one]
        return {word.strip(): action.strip() for word, action in pairs}

    @property
    def whole_action(self) -> str:
        """The action of all trials; "" where words are mapped."""
        return "" if "=" in self.action else self.action


@dataclass(frozen=True)
class Question:
    """What nothing in the logs says. option: of `holdfast import` that answers it."""

    option: str
    text: str


@dataclass
class Understood:
    """Maps, each with its logs, in words, and what is left to be asked."""

    plans: list[tuple[ImportMap, list[LogPlace]]] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)

    def add(self, name: str, text: str) -> None:
        """A line of the table."""
        line = f"{name:<11}{text}"
        if line not in self.lines:
            self.lines.append(line)


@dataclass
class _Sample:
    """A log and what it is: its columns on one clock, its time and sensors; none of a table."""

    place: LogPlace
    log: ForeignLog
    columns: Columns
    time: FoundTime | None
    sensors: list[SensorColumns]
    why: str

    @property
    def form(self) -> tuple[str, ...]:
        """What logs of one program have in common."""
        return tuple(name for sensor in self.sensors for name in sensor.axes)

    @property
    def stamps_s(self) -> np.ndarray:
        """[T] on the log's clock; rows where they are counted."""
        if self.time is None:
            return np.arange(
                len(next(iter(self.columns.values()), ())), dtype=np.float64
            )
        time = self.time.time
        rows = self.columns.get(time.column)
        if rows is None:
            rows = np.arange(len(next(iter(self.columns.values()))))
        return rows.astype(np.float64) * (time.unit_ns * 1e-9)

    @property
    def taken(self) -> set[str]:
        """Columns of time and sensors."""
        return {*self.form, self.time.time.column if self.time else "", LOG_TIME}


def understand(source: Path, answers: Answers, part: Part = ignored) -> Understood:
    """What the logs of a source are. Raises a DataError where no log can be read at all."""
    places, others = find_logs(source)
    found = Understood()
    samples: list[_Sample] = []
    tables: list[_Sample] = []
    for number, place in enumerate(places, 1):
        try:
            sample = _sample(place, read_log(place), answers)
        except DataError:
            # the import itself names it
            continue
        (samples if sample.sensors else tables).append(sample)
        part(number / len(places))
    if not samples and not tables:
        read_log(places[0])
        raise EmptyRecording("no log with a sample", where=source)
    unread = f"; not read: {listed(others, most=6)}" if others else ""
    found.add("logs", f"{len(places)}{unread}")
    if not samples:
        found.questions.append(_no_sensors(tables[0]))
        return found
    fingers = _fingers(samples)
    if fingers:
        words = listed(list(fingers), most=6)
        found.add("joined", f"the files {words} of each trial, on the slowest clock")
        samples = _joined(samples, fingers, answers)
    forms: dict[tuple[str, ...], list[_Sample]] = {}
    for sample in samples:
        forms.setdefault(sample.form, []).append(sample)
    for of_form in forms.values():
        _add_plan(
            found,
            source,
            of_form,
            tables,
            fingers,
            answers,
            [one.place for one in samples],
        )
    hands = {(plan.unit_of_values, len(plan.sensors)) for plan, _ in found.plans}
    if len(hands) > 1:
        words = " and ".join(f"{n} sensors in {unit}" for unit, n in sorted(hands))
        found.questions.append(
            Question("SOURCE", f"logs of {words}: import each hand on its own")
        )
    return found


def _sample(place: LogPlace, log: ForeignLog, answers: Answers) -> _Sample:
    """A log with its time and its sensors, by names over all streams, else by count in one."""
    merged = {
        name: column for one in log.streams for name, column in one.columns.items()
    }
    sensors, why = (
        find_sensors(merged, _marks(merged)) if len(log.streams) > 1 else ([], "")
    )
    if not why.startswith("by"):
        longest = max(log.streams, key=lambda one: one.rows)
        time = find_time(table_of(log, longest.columns), answers.rate_hz)
        taken = {*_marks(longest.columns), time.time.column if time else ""}
        sensors, why = find_sensors(longest.columns, taken)
        is_list = (
            any(is_text(column) for column in longest.columns.values())
            or longest.rows < 100
        )
        if why.startswith("no axes") and time is None and is_list:
            sensors = []
    names = [name for sensor in sensors for name in sensor.axes] or list(merged)
    columns = {name: one[:JUDGED_ROWS] for name, one in table_of(log, names).items()}
    return _Sample(
        place, log, columns, find_time(columns, answers.rate_hz), sensors, why
    )


def _marks(columns: Columns) -> set[str]:
    return {name for name, column in columns.items() if is_mark(name, column)}


def _no_sensors(table: _Sample) -> Question:
    names = listed(list(table.columns), most=24)
    what = f"which columns of {table.place.path.name} are x, y and z of each sensor? ({names})"
    return Question("--map", f"{what}; a map names them (docs/your-data.md)")


# -- files of one trial


def _fingers(samples: Sequence[_Sample]) -> tuple[str, ...]:
    """The words by which the files of one trial differ, a file for each finger; () for none."""
    if len(samples) < 2 or any(len(one.sensors) > 1 for one in samples):
        return ()
    tokens = [_tokens(one.place.name) for one in samples]
    if len({len(one) for one in tokens}) != 1:
        return ()
    for k in range(len(tokens[0])):
        words = list(dict.fromkeys(one[k] for one in tokens))
        rest = Counter(tuple(one[:k] + one[k + 1 :]) for one in tokens)
        is_word = any(finger in word.lower() for word in words for finger in FINGERS)
        is_number = all(NUMBERED.fullmatch(word) for word in words)
        if len(words) < 2 or set(rest.values()) != {len(words)}:
            continue
        if (is_word or not is_number) and _is_one_trial(samples, tokens, k):
            return tuple(sorted(words, key=_finger_order))
    return ()


def _finger_order(word: str) -> tuple[int, list[tuple[int, int, str]]]:
    at = next(
        (k for k, finger in enumerate(FINGERS) if finger in word.lower()), len(FINGERS)
    )
    return at, counted(word)


def _is_one_trial(samples: Sequence[_Sample], tokens: list[list[str]], k: int) -> bool:
    """Whether the files that differ in the k-th word alone run at the same time."""
    groups: dict[tuple[str, ...], list[_Sample]] = {}
    for sample, words in zip(samples, tokens, strict=True):
        groups.setdefault(tuple(words[:k] + words[k + 1 :]), []).append(sample)
    for group in groups.values():
        firsts = [float(np.nanmin(one.stamps_s)) for one in group]
        lasts = [float(np.nanmax(one.stamps_s)) for one in group]
        common = min(lasts) - max(firsts)
        if common < OVERLAP * (max(lasts) - min(firsts)):
            return False
    return True


def _joined(
    samples: Sequence[_Sample], fingers: tuple[str, ...], answers: Answers
) -> list[_Sample]:
    joined = []
    groups = by_trial([one.place for one in samples], fingers)
    for name, places in groups.items():
        log = read_joined(places, fingers, name)
        joined.append(_sample(replace(places[0], name=name), log, answers))
    return joined


# -- one form of log


def _add_plan(
    found: Understood,
    source: Path,
    samples: list[_Sample],
    tables: Sequence[_Sample],
    fingers: tuple[str, ...],
    answers: Answers,
    all_places: Sequence[LogPlace],
) -> None:
    """The map of logs of one form, its lines and questions."""
    first = samples[0]
    if first.time is None:
        what = f"how many rows a second have the logs ({first.place.path.name})? nothing says it"
        found.questions.append(Question("--rate", f"{what}: a number in Hz"))
    else:
        found.add("time", first.time.why)
    found.add("sensors", f"{len(first.sensors)}, {first.why}: {_ends(first.sensors)}")
    touches = _touches(samples)
    trials = _trial_rules(samples, answers, fingers)
    known = {
        word: SITUATION_OF_ACTION.get(action_of(action) or "", "")
        for word, action in answers.actions.items()
    }
    events = _events(found, source, samples, tables, touches, known, all_places)
    if _begins_held(samples, events):
        # what a touch changes is not seen
        touches = [
            replace(one, pressed=0.0 * one.pressed, onset=0.0 * one.onset)
            for one in touches
        ]
    sensors, axis = _with_normal(first.sensors, touches, answers)
    if axis != NORMAL_AXIS:
        what = f"a touch moves {AXES[axis]} most, the names say z: which axis is the normal one?"
        found.questions.append(Question("--normal", f"{what} (x, y, z)"))
    unit, why = _unit(first, touches[0], answers)
    if unit:
        found.add("unit", why)
        sensors = oriented(sensors, _turned_touch(sensors, first, touches), unit)
        if any("-" in name[:1] or one.z_zero for one in sensors for name in one.axes):
            found.add("signs", "turned where a press lowers the normal reading")
    else:
        what = f"what unit have the readings ({why})? nothing says it"
        found.questions.append(Question("--unit", f"{what}: {', '.join(UNIT_OF)}"))
    path, actions = _path(
        found, [one.place for one in samples], answers, has_events=bool(events)
    )
    rules, events = _with_action(found, events, answers, path, trials)
    facts = Facts(
        person="" if "{person}" in path else answers.person,
        object="" if "{object}" in path else answers.object,
        action=answers.whole_action,
    )
    if not (rules or events or answers.action or _says_action(samples, trials, path)):
        what = "what happens in these trials? nothing in the logs says it"
        some = "slip, hold, pull, fall, pass, put-down, nothing, .."
        found.questions.append(Question("--action", f"{what}: {some}"))
    not_used = _not_used(samples, events, trials)
    if not_used:
        found.add("not used", listed(not_used, most=12))
    for sample in samples if trials.action else ():
        for word in dict.fromkeys(text_cells(sample.columns[trials.action])):
            actions[word] = action_of_word(word) or word
    words = {**actions, **answers.actions}
    if first.time is not None and unit:
        plan = ImportMap(
            unit=unit,  # type: ignore[arg-type]
            time=first.time.time,
            sensors=tuple(sensors),
            trials=_replaced(trials, path=path),
            facts=facts,
            actions=words,
            events=events,
        )
        found.plans.append((plan, _places_of(samples, fingers, all_places, source)))


def _places_of(
    samples: Sequence[_Sample],
    fingers: tuple[str, ...],
    all_places: Sequence[LogPlace],
    source: Path,
) -> list[LogPlace]:
    """The files of the logs; of joined ones, all files."""
    if not fingers:
        return [one.place for one in samples]
    names = {one.place.name for one in samples}
    found, _ = find_logs(source)
    return [one for one in found if without_finger(one.name, fingers)[0] in names]


def _replaced(rules: TrialRules, **changes: object) -> TrialRules:
    import msgspec

    return msgspec.structs.replace(rules, **changes)


def _ends(sensors: Sequence[SensorColumns]) -> str:
    first, last = sensors[0], sensors[-1]
    names = ", ".join(first.axes)
    return names if first is last else f"{names} to {', '.join(last.axes)}"


def _touches(samples: Sequence[_Sample]) -> list[Touch]:
    chosen = samples[:JUDGED_LOGS]
    return [touch(channels(one.columns, one.sensors)) for one in chosen]


def _begins_held(samples: Sequence[_Sample], events: FoundLabels | None) -> bool:
    """Whether labels say that the hand is closed in the first rows."""
    if events is None or events.rules.column not in samples[0].columns:
        return False
    cells = [
        text_cells(one.columns[events.rules.column][:1])[0]
        for one in samples
        if one.columns
    ]
    first = Counter(cells).most_common(1)[0][0]
    return events.rules.labels.get(first, "") not in ("", "nothing")


def _with_normal(
    sensors: list[SensorColumns], touches: Sequence[Touch], answers: Answers
) -> tuple[list[SensorColumns], int]:
    """(sensors with their normal axis last as the answer says, the axis that contradicts)."""
    if answers.normal:
        axis = AXES.index(answers.normal)
        turned = [one.axes[axis + 1 :] + one.axes[: axis + 1] for one in sensors]
        return [SensorColumns(*axes) for axes in turned], NORMAL_AXIS
    votes = Counter(normal_axis(one) for one in touches)
    axis, count = votes.most_common(1)[0]
    return sensors, axis if count == len(touches) else NORMAL_AXIS


def _turned_touch(
    sensors: Sequence[SensorColumns], first: _Sample, touches: Sequence[Touch]
) -> Touch:
    """What a touch does in all logs together, in the order of the sensors."""
    order = [first.form.index(name) for sensor in sensors for name in sensor.axes]
    pressed = np.median([one.pressed for one in touches], axis=0)
    rest = np.median([one.rest for one in touches], axis=0)
    returns = all(one.returns for one in touches)
    return replace(
        touches[0], rest=rest[order], pressed=pressed[order], returns=returns
    )


def _unit(first: _Sample, found: Touch, answers: Answers) -> tuple[str, str]:
    """(unit, why), or ("", what is seen)."""
    if answers.unit:
        return answers.unit, f"{answers.unit}, as given"
    if first.log.about.get("unit") in UNIT_OF:
        unit = str(first.log.about["unit"])
        return unit, f"{unit}, as the log says"
    named = unit_of_names(first.form)
    if named:
        return named, f"{named}, by the names"
    unit, why = unit_of_sizes(first.form, channels(first.columns, first.sensors), found)
    return unit, f"{unit}, by size: {why}" if unit else why


def _trial_rules(
    samples: Sequence[_Sample], answers: Answers, fingers: tuple[str, ...]
) -> TrialRules:
    """Columns of names and of trials, and how long a pause between trials is."""
    columns = samples[0].columns
    found: dict[str, str] = {}
    for key, words in NAMED.items():
        for name, column in columns.items():
            is_name = is_text(column) or bool((np.nan_to_num(column) % 1 == 0).all())
            kinds = set(text_cells(column[::7]))
            is_said = bool(words_of(name) & words) and name not in samples[0].taken
            means = key != "action" or all(map(action_of_word, kinds))
            if (
                is_said
                and is_name
                and means
                and len(kinds) <= max(1, len(column) // 20)
            ):
                found.setdefault(key, name)
    for key in NAMES:
        if getattr(answers, key):
            found.pop(key, None)
    gap_s = 0.0 if "column" in found else max(map(_gap_s, samples[:JUDGED_LOGS]))
    if gap_s:
        return TrialRules(fingers=fingers, gap_s=gap_s, **found)
    return TrialRules(fingers=fingers, **found)


def _gap_s(sample: _Sample) -> float:
    """How long a gap between trials is: nothing is touched before and after it; 0 for none."""
    steps = np.diff(sample.stamps_s)
    if not len(steps) or sample.time is None:
        return 0.0
    long_s = max(LONG_GAP_S, LONG_GAP_STEPS * float(np.median(steps)))
    touched = touch(channels(sample.columns, sample.sensors)).rows
    idle, busy = [], []
    for at in np.flatnonzero(steps > long_s).tolist():
        around = touched[max(0, at - 5) : at + 6]
        (busy if around.mean() > 0.5 else idle).append(float(steps[at]))
    if not idle:
        return 0.0
    return float(f"{max(0.5 * min(idle), 1.01 * max(busy, default=0.0)):.2g}")


# -- labels


def _events(
    found: Understood,
    source: Path,
    samples: Sequence[_Sample],
    tables: Sequence[_Sample],
    touches: Sequence[Touch],
    known: Mapping[str, str],
    places: Sequence[LogPlace],
) -> FoundLabels | None:
    """Labels from a table of events, else from a column."""
    of_table = _from_tables(found, source, samples, tables, known, places)
    if of_table is not None:
        return of_table
    best: list[FoundLabels] = []
    first = samples[0]
    streams = {
        name: one
        for stream in first.log.streams
        for name, one in stream.columns.items()
    }
    for name, column in {**streams, **first.columns}.items():
        if name in first.taken or not is_mark(name, column) or _is_name(name):
            continue
        rows = [
            labelled
            for sample, one in zip(samples, touches, strict=False)
            if (labelled := _labelled(sample, name, one)) is not None
        ]
        values = _all_values(samples, name)
        labels = labels_of(name, [*rows, *values], known) if rows else None
        if labels is not None:
            best.append(labels)
    if not best:
        return None
    labels = min(best, key=lambda one: len(one.unknown))
    found.add("labels", labels.why)
    return labels


def _is_name(name: str) -> bool:
    return any(words_of(name) & words for words in NAMED.values())


def _labelled(sample: _Sample, name: str, found: Touch) -> LabelledRows | None:
    """The cells of a column beside the sensors, or of a stream on its own clock."""
    if name in sample.columns:
        return LabelledRows(tuple(text_cells(sample.columns[name])), found.rows)
    for stream in sample.log.streams:
        if (
            name in stream.columns
            and stream.t_ns is not None
            and LOG_TIME in sample.columns
        ):
            at = np.searchsorted(sample.columns[LOG_TIME], stream.t_ns)
            at = np.clip(at, 0, len(found.rows) - 1)
            cells = text_cells(stream.columns[name])
            return LabelledRows(tuple(cells), found.rows[at])
    return None


def _all_values(samples: Sequence[_Sample], name: str) -> list[LabelledRows]:
    """The labels of the logs whose rows are not judged."""
    found = []
    for sample in samples[JUDGED_LOGS:]:
        column = sample.columns.get(name)
        if column is not None and len(column):
            cells = tuple(dict.fromkeys(text_cells(column)))
            found.append(LabelledRows(cells, np.zeros(len(cells), dtype=np.bool_)))
    return found


def _from_tables(
    found: Understood,
    source: Path,
    samples: Sequence[_Sample],
    tables: Sequence[_Sample],
    known: Mapping[str, str],
    places: Sequence[LogPlace],
) -> FoundLabels | None:
    root = source if source.is_dir() else source.parent
    keys = {
        key
        for place in places
        for key in (place.name, place.path.name, place.path.stem)
    }
    keys |= {
        digits for place in places for digits in re.findall(r"(\d+)\D*$", place.name)
    }
    first = samples[0]
    if samples[0].columns:
        for name in first.columns:
            if words_of(name) & NAMED["column"]:
                keys |= set(text_cells(first.columns[name]))
    chosen: FoundLabels | None = None
    others = [(one.place.path, stream) for one in tables for stream in one.log.streams]
    others += [
        (first.place.path, stream)
        for stream in first.log.streams
        if stream.t_ns is None and not set(first.form) & stream.columns.keys()
    ]
    for path, stream in others:
        about = path.relative_to(root).as_posix()
        rules = rules_of_table(stream.columns, keys, about, known)
        if rules is None or chosen is not None:
            if chosen is None or "{name}" not in chosen.rules.file:
                names = listed(list(stream.columns), most=8)
                found.add("not used", f"{path.name} (columns {names})")
            continue
        stamps = first.stamps_s
        unit, zero = unit_and_zero(
            rules, stream.columns, float(stamps[0]), float(stamps[-1])
        )
        if rules.trial and zero == "log" and _is_cut(first):
            zero = "trial"
        stem = first.place.path.stem
        named = about
        if stem in path.name:
            named = path.name.replace(stem, "{name}")
        rules = EventRules(
            **{**_fields(rules), "unit": unit, "zero": zero, "file": named}
        )
        what = [
            one for one in (rules.start, rules.end, rules.label, rules.trial) if one
        ]
        found.add(
            "labels", f"{path.name}: {listed(what)}, in {unit} from the {zero}'s begin"
        )
        chosen = FoundLabels(rules, "")
    return chosen


def _fields(rules: EventRules) -> dict[str, object]:
    return {key: getattr(rules, key) for key in rules.__struct_fields__}


def _is_cut(sample: _Sample) -> bool:
    return any(words_of(name) & NAMED["column"] for name in sample.columns)


def _with_action(
    found: Understood,
    events: FoundLabels | None,
    answers: Answers,
    path: str,
    trials: TrialRules,
) -> tuple[bool, EventRules | None]:
    """(whether rules are there, the rules) with the one label that only the action explains."""
    if events is None:
        return False, None
    rules = events.rules
    if events.unknown:
        action = action_of(answers.whole_action) if answers.whole_action else None
        situation = SITUATION_OF_ACTION.get(action or "", "")
        if situation and len(events.unknown) == 1:
            labels = {**rules.labels, events.unknown[0]: situation}
            return True, EventRules(**{**_fields(rules), "labels": labels})
        words = listed([repr(one) for one in events.unknown], most=6)
        what = f"what is {words} in column {rules.column}? nothing in the logs says it"
        some = f'"{events.unknown[0]}=slip" (or pass, hold, nothing, ..)'
        found.questions.append(Question("--action", f"{what}: {some}"))
    return True, rules


# -- names


def _tokens(name: str) -> list[str]:
    return re.split(r"[/_ .]+|-(?=[A-Za-z])", name)


def _path(
    found: Understood, places: Sequence[LogPlace], answers: Answers, *, has_events: bool
) -> tuple[str, dict[str, str]]:
    """([trials] path where all names are built alike and say something, [actions])."""
    split = [re.split(r"([/_ .]+)", place.name) for place in places]
    first = split[0]
    if any(len(one) != len(first) or one[1::2] != first[1::2] for one in split):
        return "", {}
    tokens = [[one[k] for one in split] for k in range(0, len(first), 2)]
    fields = _fields_of_tokens(tokens, answers, has_events=has_events)
    if not set(fields.values()) - {"trial"}:
        return "", {}
    parts = []
    for k, values in enumerate(tokens):
        same = len(set(values)) == 1
        parts.append(f"{{{fields[k]}}}" if k in fields else values[0] if same else "*")
    path = "".join(a + b for a, b in zip(parts, [*first[1::2], ""], strict=True))
    actions = {}
    for k, field_name in fields.items():
        names = list(dict.fromkeys(tokens[k]))
        found.add("names", f"{field_name}: {listed(names, most=6)}")
        for word in names if field_name == "action" else []:
            meant = action_of_word(word, has_events=has_events)
            if meant and action_of(word) != meant:
                actions[word] = meant
    return path, actions


def _fields_of_tokens(
    tokens: list[list[str]], answers: Answers, *, has_events: bool
) -> dict[int, str]:
    """Which words of the paths are person, object, action and trial."""
    fields: dict[int, str] = {}

    def is_free(key: str) -> bool:
        return key not in fields.values() and not getattr(answers, key, "")

    for k, values in enumerate(tokens):
        given = {key: set(getattr(answers, key).split(",")) for key in NAMES}
        said = [key for key in NAMES if set(values) <= given[key]]
        words = [action_of_word(word, has_events=has_events) for word in values]
        words = [
            answers.actions.get(word, was)
            for word, was in zip(values, words, strict=True)
        ]
        if said:
            fields[k] = said[0]
        elif all(words) and (is_free("action") or answers.actions):
            fields[k] = "action"
        elif all(map(PERSON.fullmatch, values)) and is_free("person"):
            fields[k] = "person"
        elif k == len(tokens) - 1 and all(map(NUMBERED.fullmatch, values)):
            fields[k] = "trial"
    if {"action", "person"} & set(fields.values()) and is_free("object"):
        # what is left beside a person or an action is what was held
        left = [k for k, values in enumerate(tokens) if k not in fields and values[0]]
        named = [
            k for k in left if not all(NUMBERED.fullmatch(word) for word in tokens[k])
        ]
        fields |= dict.fromkeys(named[:1], "object")
    return fields


def _says_action(samples: Sequence[_Sample], trials: TrialRules, path: str) -> bool:
    about = [one.log.about.get("action") for one in samples]
    return bool("{action}" in path or trials.action or all(about))


def _not_used(
    samples: Sequence[_Sample], events: EventRules | None, trials: TrialRules
) -> list[str]:
    """Columns of the logs that nothing is taken from."""
    first = samples[0]
    used = {*first.taken, events.column if events else "", trials.column}
    used |= {trials.person, trials.object, trials.action}
    names = {name: None for stream in first.log.streams for name in stream.columns}
    return [name for name in names if name not in used]


def of_map(source: Path, plan: ImportMap) -> Understood:
    """The logs of a source by a map; tables of events are none. Raises DataNotFound."""
    places, _ = find_logs(source)
    if plan.events is not None and plan.events.file:
        begin, _, end = plan.events.file.partition("{name}")
        places = [
            one
            for one in places
            if not (
                one.path.name.startswith(Path(begin).name)
                and one.path.name.endswith(end)
            )
        ]
    return Understood(plans=[(plan, places)])
