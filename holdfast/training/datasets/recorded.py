"""Reader of the folders of `holdfast record`: tactile.csv, meta.json, tactile.truth.json.

Who did what with which object stands in each meta.json, so a whole recording, one person's folder,
or any choice of trials is a data set. Only kept trials are read. A person is a group: no split ever
tears one apart; where only one person is there, every trial is a group of its own, and the figures
say nothing about other people. Phases are those of tactile.truth.json and no script's; preparation,
objects and windows are the thesis'.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

from holdfast.core.errors import DataNotFound, LabelError, UnitError
from holdfast.core.objects import object_name, read_json
from holdfast.core.reading import Json
from holdfast.core.trial_file import Trial
from holdfast.core.trial_layout import DISCARDED, META, TACTILE, truth_path
from holdfast.training.datasets import thesis
from holdfast.training.datasets.places import EMPTY_HAND, Fault, TrialPlace, refuse
from holdfast.training.datasets.reading import TrialReader, read_all
from holdfast.training.progress import Part, ignored, span
from holdfast.training.recording import DataSet, Recording
from holdfast.training.timeline import Phase, RiskyEvent, read_events, read_truth
from holdfast.training.windows import Choice, TimedTrial

KEPT = "kept"
EXACT = ("scene", "camera")
CAVEAT = (
    "Phases come from keys, a camera, a scene or a rule, as tactile.truth.json says of each: a "
    "pressed key is late by a human's reaction. Light and heavy differ only by object."
)
ONE_PERSON = " One person: the figures do not apply to other people."


def recognises(root: Path) -> bool:
    """Whether a folder holds a trial of `holdfast record`."""
    return any("recorder" in read_json(path.with_name(META)) for path in _trials(root))


def load(
    root: Path,
    *,
    channels: int | None = None,
    seed: int = 0,
    windows: Choice = "balanced",
    part: Part = ignored,
) -> DataSet:
    """All kept trials of a folder, as training.datasets.thesis does. Raises a DataError."""
    found, reading = _found(root), span(part, 0.0, thesis.READING)
    trials = [trial for trial in read_all(readers(root), part=reading) if trial]
    kinds = sorted({_kind(meta) for _, meta in found if meta.get("state") == KEPT})
    about = {
        "unit": trials[0].recording.unit,
        "kind": " and ".join(kinds),
        "name": root.resolve().name,
    }
    rest = span(part, thesis.READING, 1.0)
    data = thesis.assembled(
        about, trials, channels=channels, seed=seed, windows=windows, part=rest
    )
    states = dict(Counter(str(meta.get("state")) for _, meta in found))
    people = {one.person for one in data.recordings}
    caveat = CAVEAT + (ONE_PERSON if len(people) == 1 else "")
    notes = {
        **data.notes,
        "layout": "recorded",
        "states": states,
        "people": len(people),
    }
    return replace(data, caveat=caveat, notes=notes)


def readers(root: Path, fault: Fault = refuse) -> list[TrialReader]:
    """The kept trials of a folder, to be read one by one; fault: receives nothing.

    Raises DataNotFound without any, and UnitError for several units.
    """
    found = _found(root)
    kept = [
        (path, meta)
        for path, meta in found
        if meta.get("state") == KEPT and DISCARDED not in path.relative_to(root).parts
    ]
    if not kept:
        raise DataNotFound(
            f"no kept trial among {len(found)}",
            where=root,
            cause="all of them were interrupted or done again",
            next_step="record again",
        )
    units = sorted({str(meta.get("unit")) for _, meta in kept})
    if len(units) > 1:
        raise UnitError(
            f"trials in {' and in '.join(units)}",
            where=root,
            next_step="keep them in two folders",
        )
    thesis.require_unit(units[0], kept[0][0].with_name(META))
    return [
        TrialReader(_place(path, meta), partial(_timed, path, meta, root))
        for path, meta in kept
    ]


def _found(root: Path) -> list[tuple[Path, Json]]:
    return [(path, read_json(path.with_name(META))) for path in _trials(root)]


def _trials(root: Path) -> list[Path]:
    return sorted(
        root.rglob(TACTILE),
        key=lambda path: (path.parent.parent, len(path.parent.name), path.parent.name),
    )


def _kind(meta: Json) -> str:
    """simulated where the source was a virtual or simulated hand, else recorded."""
    configuration = meta.get("configuration")
    source = (
        str(configuration.get("source", "")) if isinstance(configuration, dict) else ""
    )
    return "simulated" if source.startswith(("virtual://", "sim://")) else "recorded"


def _place(path: Path, meta: Json) -> TrialPlace:
    person, action = str(meta.get("person")), str(meta.get("action"))
    if action == EMPTY_HAND:
        return TrialPlace(path, person=person)
    return TrialPlace(path, path.parent.parent.parent, action, person)


def _timed(path: Path, meta: Json, root: Path) -> TimedTrial:
    thing, place = str(meta.get("object")), _place(path, meta)
    timed = thesis.timed(place, root, {"unit": meta.get("unit")}, phased)
    trial_id = (
        path.parent.relative_to(root).as_posix()
        if path.parent != root
        else path.parent.name
    )
    recording = replace(
        timed.recording,
        trial_id=trial_id,
        group=trial_id,
        object_name=object_name(thing) if place.object_folder else None,
    )
    provenances = {
        str(phase.get("provenance"))
        for phase in read_json(truth_path(path)).get("phases", [])
    }
    return replace(timed, recording=recording, timed=bool(provenances & {*EXACT}))


def phased(
    trial: Trial, recording: Recording
) -> tuple[tuple[Phase, ...], tuple[RiskyEvent, ...]]:
    """Phases and risky events of the truth beside a trial. Raises LabelError."""
    truth = truth_path(trial.path)
    if not truth.exists():
        raise LabelError(
            "a kept trial without its truth",
            where=truth,
            next_step="holdfast repair, or record again",
        )
    if not read_json(truth).get("phases"):
        return (), ()
    return read_truth(truth, trial.t_s), read_events(truth)
