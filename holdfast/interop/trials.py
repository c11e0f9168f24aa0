"""Logs become trials by a map: joined, cut, put on an even clock, named, labelled, written.

Log by log, so that only one is in the memory. What was left out or filled is counted and printed.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from unicodedata import normalize

import numpy as np

from holdfast.core.column_map import MINUS
from holdfast.core.contract import UNIT_OF, BoolArray, FloatArray, valid_names
from holdfast.core.errors import EmptyRecording, LabelError, TimeError, count_of, listed
from holdfast.core.progress import Part, ignored
from holdfast.core.trial_file import Trial, implausible_rate, says_no
from holdfast.core.trial_layout import LABELLED_ACTIONS, SITUATION_OF_ACTION, truth_path
from holdfast.core.writing import write_whole
from holdfast.data.datasets.thesis import prepared
from holdfast.data.datasets.trials import EMPTY_HAND
from holdfast.data.lifts import LIFT, lift_phases
from holdfast.data.timeline import contact
from holdfast.interop.beside import Files, read_joined
from holdfast.interop.columns import (
    JUDGED_ROWS,
    JUMP,
    usual_step,
    without_codes,
    without_jumps,
)
from holdfast.interop.formats.streams import (
    FEWEST_ROWS,
    GAP_STEPS,
    Column,
    ForeignLog,
    evened,
    text_cells,
    unwrapped,
)
from holdfast.interop.formats.tables import pd
from holdfast.interop.formats.writing import truth_of, write_csv
from holdfast.interop.joining import table_of
from holdfast.interop.labels import clock_of, events_of, marks_of
from holdfast.interop.map import NAMES, ImportMap
from holdfast.interop.proposal import Proposal
from holdfast.interop.sensors import touch

JUMP_S, BACK_S = 60.0, 0.5
"""A clock that jumps on by so much, or back, begins a new trial."""
LONG_GAP_S, LONG_GAP_STEPS = 0.5, 20.0
"""A gap with the open hand ends a trial from so many seconds and so many usual steps on."""
MOST_ZEROS = 0.3
"""Of the rows: a sensor that reads 0 in more touches nothing."""
LONGEST_SAME = 20
"""Rows in which a sensor may read the same, to the last digit of three axes."""
SELDOM, EVENLY = 0.05, 0.9
"""Of the rows of a sensor that changes from row to row; of the steps of one that is slower."""
MORE_REPEATS = 0.2
"""Of the rows: by so much more than another a sensor repeats its reading that is slower."""
LARGEST = 1e10
"""What is as large is no reading: a count has 32 bits."""
ACTION_OF_LABELS = (
    ({"safe_slip", "risky_slip"}, "daily"),
    ({"risky_slip"}, "slip"),
    ({"safe_slip"}, "pass"),
    ({"grasp"}, "hold"),
    ({"nothing"}, EMPTY_HAND),
)
"""The situations of a trial -> its action where nothing else says it; the first that fits."""


@dataclass
class TrialImport:
    """Reads logs by a map and writes their trials into a folder.

    kept: name -> a log that was read already; it is taken out of there. written: trial -> its log.
    missing: column -> cells. gaps_s: of lost samples. trials: person, object and action of each.
    """

    folder: Path
    kept: dict[str, ForeignLog]
    written: dict[str, str] = field(default_factory=dict)
    rows: int = 0
    missing: Counter[str] = field(default_factory=Counter)
    gaps_s: list[float] = field(default_factory=list)
    trials: list[tuple[str, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _log_of: dict[bytes, str] = field(default_factory=dict)

    def take(
        self, source: Path, plan: ImportMap, files: Files, part: Part = ignored
    ) -> None:
        """The logs of one map. part: receives the share that is read. Raises a DataError."""
        used: Counter[Path] = Counter()
        for number, (name, group) in enumerate(files.items()):
            log = self.kept.pop(name, None)
            log = log or read_joined(group, plan.trials.fingers, name)
            for stream in log.streams:
                self._note(log, *stream.notes)
            if not table_of(log, plan.channels):
                self._note(log, "no readings in it")
                continue
            events, where = events_of(log, plan, source)
            whole = self._rows(log, plan)
            # a long log is large
            log = replace(log, streams=())
            done = 0
            for rows in self._cuts(log, whole, plan):
                n_used = self._write(log, rows, plan, events)
                # a trial in which nothing falls has no event
                used.update({where: n_used} if events["start"].notna().any() else {})
                done += len(rows)
                part((number + done / len(whole)) / len(files))
        part(1.0)

        unused = next((where for where, n_used in used.items() if not n_used), None)
        if unused:
            raise LabelError(
                "no event of it lies in a log",
                where=unused,
                next_step="correct unit and zero of [events] in the map",
            )

    def report(self, found: Proposal) -> None:
        """Add the end of the table of what was understood. Raises EmptyRecording."""
        if not self.trials:
            raise EmptyRecording("no trial in these logs", next_step="correct the map")
        found.add("rows", str(self.rows))
        missing = [f"{name}: {n}" for name, n in self.missing.most_common() if n]
        if missing:
            found.add("missing", f"samples of {listed(missing, most=8)}")
        if self.gaps_s:
            ends = f"{min(self.gaps_s):.3g} to {max(self.gaps_s):.3g} s"
            found.add("gaps", f"{len(self.gaps_s)} of {ends}: lost samples")
        people, _, actions = zip(*self.trials, strict=True)
        counts = [f"{n} {action}" for action, n in Counter(actions).items()]
        n_trials = count_of(len(self.trials), "trial")
        found.add("trials", f"{n_trials}: {listed(counts)}")
        if any(people):
            found.add("people", listed([*filter(None, dict.fromkeys(people))], most=12))
        for note in self.notes[:12]:
            found.add("note", note)

    def _note(self, log: ForeignLog, *texts: str) -> None:
        """What was left out of a log, or changed."""
        notes = [f"{log.name}: {text}" for text in texts]
        self.notes += [note for note in notes if note not in self.notes]

    def _left_out(self, log: ForeignLog, count: int, what: str, why: str) -> None:
        """How many rows or lines of a log were left out, where some were."""
        if count:
            self._note(log, f"{count_of(count, what)} {why} left out")

    # -- rows of a log, and where a trial ends

    def _rows(self, log: ForeignLog, plan: ImportMap) -> pd.DataFrame:
        """The readings of a log as they stand, and cells of other columns, by stamps in ns.

        Rows without a time are left out. Raises ColumnError, ..
        """
        columns = table_of(log, plan.channels)
        rules = plan.trials
        further = {rules.column, rules.person, rules.object, rules.action} - {""}
        needed = {*plan.columns, rules.column, rules.action} - {""}
        plan.require_columns(columns, log.path, needed)
        missing = sorted(further - columns.keys())
        self._note(log, *(f"no column {name}" for name in missing))
        further |= {plan.events.column} if plan.events else set()
        further &= columns.keys()
        # the columns themselves, because a long log is large
        rows = pd.DataFrame({name: columns[name] for name in plan.columns}, copy=False)
        flags = valid_names(len(plan.sensors))
        for sensor, flag in zip(plan.sensors, flags, strict=True):
            if flag not in columns:
                continue
            # what a log says is not valid is no reading
            is_lost = _says_no(columns[flag])
            for name in filter(None, sensor.axes):
                name = name.removeprefix(MINUS)
                rows[name] = rows[name].mask(is_lost)
        for name in further:
            rows[name] = np.array(text_cells(columns[name]), dtype=object)
        if plan.time.column:
            n_rows = len(rows)
            rows = rows.dropna(subset=[plan.time.column])
            self._left_out(log, n_rows - len(rows), "row", "without a time")
            has_any = np.zeros(len(rows), dtype=np.bool_)
            for channel in plan.channels:
                # one by one: a long log is large
                has_any |= rows[channel].notna().to_numpy()
            if not has_any.all():
                self._left_out(log, int((~has_any).sum()), "row", "of no sensor")
                rows = rows[has_any]
        if not len(rows):
            raise EmptyRecording("no row of data", where=log.path)
        stamps = plan.stamps_ns(rows, len(rows), log.path)
        rows = rows.set_axis(unwrapped(stamps, plan.time.unit_ns))
        if np.median(np.diff(stamps)) < 0:
            self._note(log, "the newest row stood first: the rows were turned round")
            rows = rows[::-1]
        rows = self._without_repeats(log, rows, plan)
        self.rows += len(rows)
        return rows

    def _without_repeats(
        self, log: ForeignLog, rows: pd.DataFrame, plan: ImportMap
    ) -> pd.DataFrame:
        """Of values that stay for several rows one; a sensor that is slower or dead is named."""
        same = repeats(values_of(log, rows[:JUDGED_ROWS], plan))
        changes = np.flatnonzero(~same.all(axis=1))
        steps = np.diff(changes)
        n_rows = int(np.median(steps)) if len(steps) > FEWEST_ROWS else 1
        if n_rows > 1 and np.mean(steps % n_rows == 0) > EVENLY:
            self._note(log, f"each value stands in {n_rows} rows: one of them is kept")
            return rows[int(changes[1]) % n_rows :: n_rows]
        if n_rows > 1:
            self._note(
                log, f"readings stay for {n_rows} rows or so: slower than the log"
            )
        shares = same.mean(axis=0)
        for number, share in enumerate(shares.tolist(), 1):
            if share > shares.min() + MORE_REPEATS:
                text = f"sensor {number} repeats its reading in {share:.0%} of the rows"
                self._note(log, f"{text}: slower, or dead")
        return rows

    def _cuts(
        self, log: ForeignLog, rows: pd.DataFrame, plan: ImportMap
    ) -> Iterator[pd.DataFrame]:
        """The rows of each trial, on an even clock."""
        stamps = rows.index.to_numpy()
        step = usual_step(stamps.astype(np.float64))
        steps = 1e-9 * np.diff(stamps)
        ends = (steps < -BACK_S) | (steps > JUMP_S)
        for at in np.flatnonzero(ends)[:3].tolist():
            jump = f"the clock jumps by {steps[at]:.4g} s in row {at + 2}"
            self._note(log, f"{jump}: a new trial")
        column = plan.trials.column
        longest_s = max(LONG_GAP_S, 1e-9 * LONG_GAP_STEPS * step)
        if column:
            # a lost cell within a trial ends none
            cells = rows[column].where(rows[column] != "").ffill(limit=FEWEST_ROWS)
            rows[column] = cells.fillna("")
            ends |= (rows[column] != rows[column].shift()).to_numpy()[1:]
        elif (steps > longest_s).any():
            _, touched = touch(values_of(log, rows, plan))
            # a step within a touch is no pause, nor is one of its length
            within = touched[1:] & touched[:-1] & ~ends
            ends |= steps > max(longest_s, 1.01 * steps[within].max(initial=0.0))
        for first, stop in pairwise([0, *(np.flatnonzero(ends) + 1), len(rows)]):
            part = rows.iloc[first:stop]
            if column and not part[column].iloc[0]:
                continue
            if len(part) < FEWEST_ROWS:
                self._left_out(log, len(part), "row", "between trials")
                continue
            part = part.sort_index(kind="stable")
            clock = evened(part.index.to_numpy(), step)
            if (clock != part.index).any():
                hz = 1e9 / step
                self._note(
                    log, f"stamps in bursts: put on an even clock of {hz:.4g} Hz"
                )
            yield part.set_axis(clock)

    # -- one trial

    def _write(
        self, log: ForeignLog, rows: pd.DataFrame, plan: ImportMap, events: pd.DataFrame
    ) -> int:
        """Write a trial; how many of the events it has. Raises LabelError, TimeError."""
        names = names_of(log, rows, plan)
        labels, n_used = labels_of_rows(log, rows, plan, events)
        trial = self._trial(log, rows, plan)
        first = self._log_of.setdefault(sha256(trial.raw.tobytes()).digest(), log.name)
        if first != log.name:
            self._note(log, f"the same readings as {first}: keep one of them")
        labels = labels[-len(trial.t_s) :]
        recording = prepared(trial, plan.unit_of_values, "")
        closed = slice(*contact(trial.t_s, recording.samples))
        action = self._action(log, plan, names["action"], labels, closed)
        is_timed = any(labels)
        if action == LIFT and not is_timed:
            # raises where the forces do not tell when the hand holds something
            values, valid = recording.samples, recording.valid
            lift_phases(values, valid, trial.rate_hz, recording.unit, log.path)
        is_empty = action == EMPTY_HAND
        thing = "" if is_empty else names["object"] or "object"
        parts = names["person"], thing, action
        self.trials.append(parts)
        name = f"trial_{self.trials.count(parts)}.csv"
        place = "/".join(filter(None, [*parts, name]))
        write_csv(self.folder / place, trial, plan.unmeasured_names)
        if is_timed and not is_empty:
            write_whole(truth_path(self.folder / place), truth_of(trial, labels))
        self.written[place] = log.name
        return n_used

    def _action(
        self,
        log: ForeignLog,
        plan: ImportMap,
        action: str,
        labels: np.ndarray,
        closed: slice,
    ) -> str:
        """The action of a trial, by its name or else its labels.

        labels [T] become what is known of when: a closed hand holds where nothing is said; all
        are empty where nothing is known. closed: the first touch to the last. Raises LabelError.
        """
        is_timed = len({*labels}) > 1
        if plan.events and labels[0] is None:
            self._note(log, "no event is of it")
        elif plan.events and plan.events.rest:
            held = labels[closed]
            held[held == ""] = plan.events.rest
            if plan.events.hold:
                # a mark without an end lasts to that of the contact
                labels[closed.stop :] = ""
        kinds = {*labels} - {"", None}
        fits = (action for needed, action in ACTION_OF_LABELS if needed <= kinds)
        action = action or next(fits, "")
        situation = SITUATION_OF_ACTION.get(action, "")
        slips = "risky_slip" in kinds
        if is_timed and situation and slips != (situation == "risky_slip"):
            said = "that it slips" if slips else "no slip"
            self._note(log, f"DOUBTFUL: its name says {action}, its labels say {said}")
        if not is_timed:
            # what is the same in every row says what the trial is
            labels[:] = ""
        if not (situation or (action and is_timed)):
            raise LabelError(
                f"nothing says what happens in {log.name}",
                where=log.path,
                next_step="--action slip, or another action; or its events",
            )
        is_known = action in (*LABELLED_ACTIONS, EMPTY_HAND) or plan.facts.action_at_s
        if is_timed or is_known:
            return action
        unknown = f"{action}: its times are not known"
        if situation == "safe_slip":
            self._note(log, f"{unknown}: only the empty hand is labelled")
            labels[:] = "nothing"
            labels[closed] = ""
            return action
        taken = "slip" if situation == "risky_slip" else "hold"
        self._note(log, f"{unknown}: taken as {taken}")
        return taken

    def _trial(self, log: ForeignLog, rows: pd.DataFrame, plan: ImportMap) -> Trial:
        """The readings of a trial, from when every sensor that ever sends has sent.

        Raises NotANumber, TimeError.
        """
        values = values_of(log, rows, plan)
        for number, n_hung in enumerate(lose_hung(values), 1):
            if n_hung:
                text = f"sensor {number} is 0 in a press, or repeats one reading"
                self._note(log, f"{text}, in {count_of(n_hung, 'row')}: lost")
        steps = np.abs(np.diff(values, axis=0)) / UNIT_OF[plan.unit][1]
        n_jumps = int((np.abs(steps - JUMP) < 0.1 * JUMP).sum())
        if n_jumps:
            jumps = count_of(n_jumps, "jump")
            self._note(log, f"{jumps} by 2^16: --unwrap takes them out")
        is_lost = np.isnan(values)
        n_lost = is_lost.sum(axis=0)[plan.measured]
        lost = zip(plan.channels, n_lost.tolist(), strict=True)
        self.missing.update(dict(lost))
        first = int(is_lost.argmin(axis=0).max())
        if 0 < first < len(rows) // 2:
            self._left_out(log, first, "row", "before all sensors sent")
            rows, values = rows[first:], values[first:]
        t_s = 1e-9 * (rows.index - rows.index[0]).to_numpy()
        steps = np.diff(t_s)
        step_s = max(1e-12, float(np.median(steps)))
        wrong = implausible_rate(1.0 / step_s)
        if wrong:
            next_step = "--rate HZ; or correct [time] of the map"
            raise TimeError(wrong, where=log.path, next_step=next_step)
        self.gaps_s += steps[steps > GAP_STEPS * step_s].tolist()
        valid = np.ones((len(values), len(plan.sensors)), dtype=np.bool_)
        return Trial(log.path, t_s, values, valid)


def values_of(log: ForeignLog, rows: pd.DataFrame, plan: ImportMap) -> FloatArray:
    """[T, C] the readings in some rows of a log, in the unit of its trials; nan for none."""
    values = plan.values_of(rows, log.path)
    values[~(np.abs(values) < LARGEST)] = np.nan
    if plan.unwrap:
        values = without_jumps(values, UNIT_OF[plan.unit][1])
    return without_codes(values)


def repeats(values: FloatArray) -> BoolArray:
    """[T, S] whether a sensor reads the same as in the row before, on all axes; values [T, C]."""
    steps = np.diff(values, axis=0, prepend=np.nan)
    same: BoolArray = (steps == 0).reshape(len(values), -1, 3).all(axis=2)
    return same


def lose_hung(values: FloatArray) -> list[int]:
    """How many samples of each sensor are no readings, as of a driver that hangs; become nan.

    values [T, C]: changed. They repeat one reading for long, or are 0. A sensor may stay at its
    rest, and one that often repeats has coarse steps.
    """
    n_lost = []
    _, touched = touch(values)
    # where all sensors are 0, nothing seems to be touched: between the touches
    is_within = np.logical_or.accumulate(touched)
    is_within &= np.logical_or.accumulate(touched[::-1])[::-1]
    for sensor in np.split(values, values.shape[1] // 3, axis=1):
        same = repeats(sensor)[:, 0]
        runs = np.cumsum(~same)
        is_long = same & (np.bincount(runs)[runs] > LONGEST_SAME)
        is_coarse = np.mean(same & ~is_long) > SELDOM
        zeros = (sensor == 0).all(axis=1)
        is_at_rest = zeros.mean() > MOST_ZEROS or (zeros & ~is_within).any()
        hung = (is_long & ~is_coarse) | (zeros & ~is_at_rest)
        hung &= (sensor != sensor[0]).any(axis=1)
        sensor[hung] = np.nan
        n_lost.append(int(hung.sum()))
    return n_lost


def _says_no(cells: Column) -> BoolArray:
    """[T] where a column valid1, valid2, .. says that its sensor is not valid."""
    if cells.dtype == object:
        return np.array([says_no(cell) for cell in cells])
    # among numbers a word, such as False, was read as nan
    return ~(np.abs(cells.astype(np.float64)) > 0.0)


# -- names and labels of a trial


def names_of(log: ForeignLog, rows: pd.DataFrame, plan: ImportMap) -> dict[str, str]:
    """Person, object and action of a trial: by columns, by the path, by what is always so.

    Raises LabelError.
    """
    names = {}
    of_path = plan.trials.names_of(log.name, log.path)
    for key in NAMES:
        of_trial = {*rows.get(getattr(plan.trials, key), ())} - {""}
        if len(of_trial) > 1:
            raise LabelError(
                f"several values of trials.{key} in one trial: {listed(sorted(of_trial))}",
                where=log.path,
                next_step="split the log there: [trials] column",
            )
        fact = getattr(plan.facts, key) or log.about.get(key) or ""
        names[key] = [*of_trial, of_path.get(key, fact)][0]
    word = names["action"]
    action = plan.action(word) if word else ""
    if action is None:
        raise LabelError(
            f"the word {word!r:.60} is no action",
            where=log.path,
            next_step=f'--action "{word:.60}=slip" (or hold, pass, pull, ..)',
        )
    return {key: safe_name(name) for key, name in names.items()} | {"action": action}


def safe_name(text: str) -> str:
    """A name as a folder: letters of any script, digits and dashes.

    >>> safe_name("Soft ball #2")
    'Soft-ball-2'
    """
    return "-".join(re.findall(r"[\w-]+", normalize("NFC", text))).strip("-_")[:60]


def labels_of_rows(
    log: ForeignLog, rows: pd.DataFrame, plan: ImportMap, events: pd.DataFrame
) -> tuple[np.ndarray, int]:
    """([T] the situation of each row of a trial, "" for none, None where
    no label is of this trial; how many events begin in it).

    events: of this and other trials, what lies within another one behind it. Raises LabelError.
    """
    rules, n_used = plan.events, 0
    labels = np.full(len(rows), None, dtype=object)
    if rules and rules.column in rows:
        labels = marks_of(rows[rules.column].to_numpy(object), rules)
    elif rules:
        of_column = {*map(str.casefold, rows.get(plan.trials.column, ()))}
        is_ours = events["trial"].str.casefold().isin({"", *log.keys, *of_column})
        if not is_ours.any():
            return labels, 0
        clock = clock_of(rules, rows.index.to_numpy())
        for event in events[is_ours].dropna(subset="start").itertuples():
            first, stop = np.searchsorted(clock, [event.start, event.end])
            n_used += int(clock[0] <= event.start <= clock[-1])
            labels[first:stop] = event.label
    else:
        return labels, 0

    meanings: dict[str | None, str] = {None: ""}
    for label in {*labels} - {None}:
        situation = plan.situation(label)
        if situation is None:
            raise LabelError(
                f"the label {label!r:.60} is no situation",
                where=log.path,
                next_step=f'--action "{label:.60}=slip" (or hold, pass, ..)',
            )
        meanings[label] = situation
    return np.array([meanings[one] for one in labels], dtype=object), n_used
