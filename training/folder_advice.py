"""What a folder of recordings lacks, and what to write or record where."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from holdfast.edge_runtime.contract import LIGHT_BELOW_G, SITUATIONS, UNITS
from holdfast.edge_runtime.trial_layout import (
    INTENT_SUFFIX,
    META,
    RISKY_ACTIONS,
    TACTILE,
    VOLUNTARY_ACTIONS,
    truth_path,
)
from holdfast.training.datasets.places import FOLDERS
from holdfast.training.folder_report import ClassSeconds, Missing
from holdfast.training.objects import read_json
from holdfast.training.windows import TimedTrial

SCRIPT = "script"
LAYOUT = "<person>/<object>/<action>/trial_1.csv"
SLIPS = {"safe_slip": VOLUNTARY_ACTIONS, "risky_slip": RISKY_ACTIONS}
PHASES = '{"phases": [{"t0_s": 2.1, "t1_s": 6.4, "label": "grasp"}, ..]}'
LIGHT, HEAVY = f"under {LIGHT_BELOW_G:g} g", f"of {LIGHT_BELOW_G:g} g or more"


def advice(
    root: Path,
    layout: str,
    trials: Sequence[TimedTrial],
    classes: Sequence[ClassSeconds],
    *,
    all_read: bool,
) -> list[Missing]:
    """What is missing beside the faults: unit, people, classes, actions of people, exact labels.

    all_read: else only the first two are known, since an unread trial may have the rest.
    """
    if not trials:
        return []
    bare = layout == "thesis"
    if not all_read:
        return [*(_unit(root) if bare else ()), *_people(root, trials)]
    return [
        *(_unit(root) if bare else ()),
        *_people(root, trials),
        *_classes(root, classes),
        *_actions_of_people(root, trials),
        *(_labels(root, trials) if bare else ()),
    ]


def not_read(root: Path, read: Sequence[Path]) -> list[Missing]:
    """CSV files that are at no trial's place; an error where no file is at one."""
    others = sorted(
        path
        for path in set(root.rglob("*.csv")) - set(read)
        if path.name != TACTILE and not path.name.endswith(INTENT_SUFFIX)
    )
    if read and not others:
        return []
    what = "no CSV file"
    if others:
        first = others[0].relative_to(root).as_posix()
        what = f"CSV files at no trial's place: {len(others)}, such as {first}"
    next_step = f"a trial belongs at {root / LAYOUT}; an action is one of {', '.join(FOLDERS)}"
    return [Missing("advice" if read else "error", str(root), what, next_step)]


def _unit(root: Path) -> Iterator[Missing]:
    if "unit" not in read_json(root / META):
        units = " or ".join(f'{{"unit": "{unit}"}}' for unit in UNITS)
        yield Missing("advice", str(root / META), "no unit; N is assumed", f"write {units}")


def _people(root: Path, trials: Sequence[TimedTrial]) -> Iterator[Missing]:
    people = {trial.recording.person for trial in trials} - {None}
    if len(people) < 2:
        named = f"one person, {people.pop()}" if people else "no people"
        what = f"{named}: figures are held out by trial and do not apply to other people"
        yield Missing("advice", str(root), what, f"sort trials of several people into {LAYOUT}")


def _classes(root: Path, classes: Sequence[ClassSeconds]) -> Iterator[Missing]:
    for one in classes:
        action = SLIPS[one.situation][0] if one.situation in SLIPS else "<action>"
        for seconds, weight in ((one.light_s, LIGHT), (one.heavy_s, HEAVY)):
            if not seconds:
                path = root / "<person>" / f"<object {weight}>" / action / "trial_1.csv"
                what = f"no {one.situation} with an object {weight}"
                yield Missing("training", str(root), what, f"record {path}")


def _actions_of_people(root: Path, trials: Sequence[TimedTrial]) -> Iterator[Missing]:
    situations: dict[str, set[str]] = {}
    for trial in trials:
        if trial.recording.person is not None:
            seen = situations.setdefault(trial.recording.person, set())
            seen.update(SITUATIONS[phase.situation] for phase in trial.phases)
    for person, seen in situations.items() if len(situations) > 1 else ():
        for slip in SLIPS:
            if slip not in seen:
                actions = " or ".join(SLIPS[slip])
                yield Missing(
                    "advice", str(root / person), f"no {slip} of {person}", f"record a {actions}"
                )


def _labels(root: Path, trials: Sequence[TimedTrial]) -> Iterator[Missing]:
    scripted = [trial for trial in trials if trial.labels_by.startswith(SCRIPT)]
    if scripted:
        truth = truth_path(root / f"{scripted[0].recording.trial_id}.csv")
        what = (
            f"{len(scripted)} of {len(trials)} trials have labels by the script, not measured ones"
        )
        yield Missing("advice", str(truth), what, f"where you know the times, write {PHASES}")
