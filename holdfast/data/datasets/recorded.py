"""Reader of the folders of `holdfast record`: tactile.csv, meta.json, tactile.truth.json.

Who did what with which object stands in each meta.json, so a whole recording, one person's folder,
or any choice of trials is a data set. Only kept trials are read. A person is a group: no split ever
divides the trials of one; where only one person is there, every trial is its own group, and the
figures do not apply to other people. Phases are those of tactile.truth.json and no script's;
preparation, objects and windows are the thesis'.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from holdfast.core.contract import Json
from holdfast.core.errors import DataNotFound, LabelError, UnitError
from holdfast.core.hand_card import HandCard
from holdfast.core.schema import checked
from holdfast.core.trial_layout import (
    DISCARDED,
    META,
    TACTILE,
    object_name,
    read_json,
    truth_path,
)
from holdfast.data.datasets import thesis
from holdfast.data.datasets.trials import (
    EMPTY_HAND,
    Fault,
    TrialPlace,
    TrialReader,
    hand_beside,
    refuse,
)
from holdfast.data.lifts import LIFT
from holdfast.data.timeline import OF_WHOLE_TRIAL
from holdfast.data.windows import TimedTrial

KEPT = "kept"
"""The state of a trial that was finished and not done again."""
EXACT = {"scene", "camera"}
"""Provenances of phases that are known to the moment."""
CAVEAT = (
    "Phases come from keys, a camera, a scene or a rule, as tactile.truth.json says of each: a "
    "pressed key is late by a human's reaction. Light and heavy differ only by object."
)
ONE_PERSON = " One person: the figures do not apply to other people."


def is_ours(root: Path) -> bool:
    """Whether the recorder wrote a trial anywhere below."""
    metas = (path.with_name(META) for path in root.rglob(TACTILE))
    return any("recorder" in read_json(meta) for meta in metas)


def about(root: Path) -> thesis.SetMeta:
    """Name and kind of a folder's kept trials, and what stands with their figures."""
    metas = _finished_trials(root).values()
    kinds = sorted({_kind(meta) for meta in metas})
    people = {meta.get("person") for meta in metas}
    caveat = CAVEAT + (ONE_PERSON if len(people) == 1 else "")
    kind, name = " and ".join(kinds), root.resolve().name
    return thesis.SetMeta(kind=kind, name=name, caveat=caveat)


def readers(
    root: Path, fault: Fault = refuse, rate_hz: float | None = None
) -> list[TrialReader]:
    """The kept trials of a folder, to be read one by one; fault: of the hand card alone.

    Raises DataNotFound without any, and UnitError for several units.
    """
    kept = _finished_trials(root)
    if not kept:
        raise DataNotFound(
            "no kept trial",
            where=root,
            cause="all of them were interrupted or done again",
            next_step="record again",
        )

    units = sorted({str(meta.get("unit")) for meta in kept.values()})
    if len(units) > 1:
        raise UnitError(
            f"trials in {' and in '.join(units)}",
            where=root,
            next_step="keep them in two folders",
        )
    hand = hand_beside(root, fault)
    return [_reader(path, meta, root, rate_hz, hand) for path, meta in kept.items()]


def _finished_trials(root: Path) -> dict[Path, Json]:
    """Each tactile.csv of a finished trial with its meta.json; trial_10 comes after trial_9.

    A trial that was done again stays on disk in a folder of its own, and must not train a model.
    """

    def order(path: Path) -> tuple[Path, int, str]:
        # A longer name has a larger number.
        trial = path.parent
        return trial.parent, len(trial.name), trial.name

    kept = {}
    for path in sorted(root.rglob(TACTILE), key=order):
        meta = read_json(path.with_name(META))
        if meta.get("state") == KEPT and DISCARDED not in path.relative_to(root).parts:
            kept[path] = meta
    return kept


def _kind(meta: Json) -> str:
    """simulated where the source was a virtual or simulated hand, else recorded."""
    source = str((meta.get("configuration") or {}).get("source", ""))
    virtual = source.startswith(("virtual://", "sim://"))
    return "simulated" if virtual else "recorded"


def _reader(
    path: Path, meta: Json, root: Path, rate_hz: float | None, hand: HandCard | None
) -> TrialReader:
    """The reader of a trial: its person and action are those of meta.json, not of the folder."""
    person = str(meta.get("person"))
    action = str(meta.get("action"))
    if action == EMPTY_HAND:
        place = TrialPlace(path, person=person)
    else:
        place = TrialPlace(path, path.parent.parent.parent, action, person)
    return TrialReader(place, partial(_timed, place, meta, root, rate_hz, hand))


def _timed(
    place: TrialPlace,
    meta: Json,
    root: Path,
    rate_hz: float | None,
    hand: HandCard | None,
) -> TimedTrial:
    """A kept trial, read and labelled by its truth. Raises LabelError without one."""
    folder = place.path.parent
    truth = truth_path(place.path)
    if not truth.exists():
        raise LabelError(
            "a kept trial without its truth",
            where=truth,
            next_step="holdfast check --repair, or record again",
        )

    recorded = (meta.get("quality") or {}).get("samples")
    unit = {"unit": meta.get("unit")}
    about = checked(unit, thesis.SetMeta, place.path.with_name(META), UnitError)
    timed = thesis.timed(place, root, about, recorded, rate_hz, hand)
    # The object is the one in meta.json; the folder may be called otherwise.
    name = object_name(str(meta.get("object"))) if place.object_folder else None
    trial_id = folder.name if folder == root else folder.relative_to(root).as_posix()
    recording = replace(
        timed.recording, trial_id=trial_id, group=trial_id, object_name=name
    )
    # A pressed key is late by a reaction; a scene and a camera know the moment.
    exact = not EXACT.isdisjoint(timed.labels_by.split(", "))
    exact |= timed.labels_by == OF_WHOLE_TRIAL[LIFT]
    return replace(timed, recording=recording, timed=exact)
