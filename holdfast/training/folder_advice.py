"""What more data of a folder would bring, for `holdfast check`.

Training takes whatever situations and masses there are; a model does not tell the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from holdfast.core.contract import LIGHT_BELOW_G, NOTHING, SITUATIONS, UNITS
from holdfast.core.errors import DataError
from holdfast.core.trial_layout import (
    META,
    RISKY_ACTIONS,
    VOLUNTARY_ACTIONS,
    read_json,
    truth_path,
    weigh_it,
)
from holdfast.training.timeline import OF_WHOLE_TRIAL
from holdfast.training.windows import TimedTrial

Level = Literal["error", "training", "advice"]
NOT_MEASURED = {
    "script": "have labels by the script, not measured ones",
    OF_WHOLE_TRIAL["slip"]: "slip at a moment that is guessed: the largest change",
}
"""How the source of labels begins that are not measured, and what to say of these."""
LAYOUT = "<person>/<object>/<action>/trial_1.csv"
SLIPS = {"safe_slip": VOLUNTARY_ACTIONS, "risky_slip": RISKY_ACTIONS}
"""The actions that lead to each slip."""
PLACE = {
    "nothing": "<person>/nothing/trial_1.csv",
    "grasp": "<person>/<object>/hold/trial_1.csv",
    "safe_slip": "<person>/<object>/pass/trial_1.csv",
    "risky_slip": "<person>/<object>/slip/trial_1.csv",
}
"""Where a trial of each situation belongs, as it is advised."""
WITHOUT = {
    "nothing": "a model answers something else for an empty hand",
    "grasp": "a model cannot tell that an object is held",
    "safe_slip": "a model takes hand-overs and put-downs for something else",
    "risky_slip": "a model cannot tell that an object slips",
}
"""What a model cannot do that was trained without a situation."""
NO_WEIGHT = "a model does not learn light and heavy"
PHASES = '{"phases": [{"t0_s": 2.1, "t1_s": 6.4, "label": "grasp"}, ..]}'
"""An example of a truth file, for the advice."""
LIGHT, HEAVY = f"under {LIGHT_BELOW_G:g} g", f"of {LIGHT_BELOW_G:g} g or more"


@dataclass(frozen=True)
class Missing:
    """Something that is missing: where, and what to write there.

    level: an error keeps the folder from being read, or the trial; training: it can be evaluated
    on, but not trained on; advice: it works as it is, and more data would bring something.
    """

    level: Level
    where: str
    what: str
    next_step: str

    @staticmethod
    def of(error: DataError, level: Level = "error") -> Missing:
        """A fault of reading."""
        return Missing(level, error.where, error.what, error.next_step)


@dataclass(frozen=True)
class ClassSeconds:
    """How long a situation lasts in all trials, with light and with heavy objects, s.

    unweighed_s: with objects whose mass is not known.
    """

    situation: str
    light_s: float
    heavy_s: float
    unweighed_s: float = 0.0

    @property
    def seconds(self) -> float:
        """With objects of any mass."""
        return self.light_s + self.heavy_s + self.unweighed_s


def advice_on(
    root: Path,
    layout: str,
    trials: Sequence[TimedTrial],
    classes: Sequence[ClassSeconds],
    held_out_by: str,
    *,
    all_read: bool,
) -> list[Missing]:
    """What is missing besides the faults: unit, people, masses, situations, weights, exact labels.

    held_out_by: what training holds out. all_read: else only the first three are known, since an
    unread trial may have the rest.
    """
    found = []

    # The recorder writes unit and labels itself; only folders made by hand can lack them.
    bare = layout == "thesis"
    if bare and "unit" not in read_json(root / META):
        where = str(root / META)
        units = " or ".join(f'{{"unit": "{unit}"}}' for unit in UNITS)
        next_step = f"write {units}"
        found.append(Missing("advice", where, "no unit; N is assumed", next_step))

    people = sorted({trial.recording.person or "" for trial in trials} - {""})
    if len(people) < 2:
        named = f"one person, {people[0]}" if people else "no people"
        held_out = f"figures are held out by {held_out_by}"
        limit = f"{held_out} and do not apply to other people"
        what = f"{named}: {limit}"
        next_step = f"sort trials of several people into {LAYOUT}"
        found.append(Missing("advice", str(root), what, next_step))

    unweighed = _unweighed(root, trials)
    found += unweighed
    # A class that seems to be missing may be in the trial that could not be read.
    if all_read:
        by_force = {trial.recording.unit for trial in trials} == {"N"}
        found += _missing_situations(root, classes, nothing_by_force=by_force)
        if not unweighed:
            found += _missing_weights(root, classes)
        if len(people) > 1:
            found += _missing_actions(root, trials)
        if bare:
            found += _missing_labels(root, trials)
    return found


def _missing_situations(
    root: Path, classes: Sequence[ClassSeconds], *, nothing_by_force: bool
) -> list[Missing]:
    """The situations without a sample: a forest cannot learn what it never saw.

    nothing_by_force: in N a model knows an empty hand by its force, and learns nothing of it.
    """
    absent = [one.situation for one in classes if not one.seconds]
    # Of one situation alone there is nothing to learn.
    level: Level = "advice"
    if len(SITUATIONS) - len(absent) < 2:
        level = "training"

    found = []
    for situation in absent:
        if nothing_by_force and situation == SITUATIONS[NOTHING] and level == "advice":
            continue
        what = f"no {situation}: {WITHOUT[situation]}"
        next_step = f"record {root / PLACE[situation]}"
        found.append(Missing(level, str(root), what, next_step))
    return found


def _unweighed(root: Path, trials: Sequence[TimedTrial]) -> list[Missing]:
    """The objects without a mass, each folder once."""
    found: dict[Path, Missing] = {}
    for trial in trials:
        name = trial.recording.object_name
        if name is None or trial.heavy is not None:
            continue
        # The folder of the object is two above the file of the trial.
        folder = root / Path(trial.recording.trial_id).parent.parent
        what = f"no mass given for object {name!r}: {NO_WEIGHT}"
        found[folder] = Missing("advice", str(folder), what, weigh_it(folder))
    return list(found.values())


def _missing_weights(root: Path, classes: Sequence[ClassSeconds]) -> list[Missing]:
    """The situations with light or with heavy objects alone."""
    missing = []
    for one in classes:
        if one.situation == SITUATIONS[NOTHING] or not one.seconds:
            continue
        lasts = ((one.light_s, LIGHT), (one.heavy_s, HEAVY))
        for seconds, weight in lasts:
            if not seconds:
                place = PLACE[one.situation].replace("object", f"object {weight}")
                what = f"no {one.situation} with an object {weight}: {NO_WEIGHT}"
                next_step = f"record {root / place}"
                missing.append(Missing("advice", str(root), what, next_step))
    return missing


def _missing_actions(root: Path, trials: Sequence[TimedTrial]) -> list[Missing]:
    """The slips that a person has no trial of."""
    situations: dict[str, set[str]] = {}
    for trial in trials:
        person = trial.recording.person
        if person is not None:
            seen = situations.setdefault(person, set())
            for phase in trial.recording.phases:
                seen.add(SITUATIONS[phase.situation])

    found = []
    for person, seen in situations.items():
        for slip, actions in SLIPS.items():
            if slip not in seen:
                what = f"no {slip} of {person}"
                next_step = f"record a {' or '.join(actions)}"
                found.append(Missing("advice", str(root / person), what, next_step))
    return found


def _missing_labels(root: Path, trials: Sequence[TimedTrial]) -> list[Missing]:
    """A line on the trials that are labelled by the script, and on slips without a time."""
    found = []
    for source, what in NOT_MEASURED.items():
        such = [trial for trial in trials if trial.labels_by.startswith(source)]
        if such:
            truth = truth_path(root / f"{such[0].recording.trial_id}.csv")
            share = f"{len(such)} of {len(trials)} trials {what}"
            next_step = f"where you know the times, write {PHASES}"
            found.append(Missing("advice", str(truth), share, next_step))
    return found
