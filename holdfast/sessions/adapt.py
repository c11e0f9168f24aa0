"""A model file for one person from a short recording: a correction and when it acts.

An adaptation starts from the file itself, or from the base inside an adapted file. Recordings with
slips, which a person does not have to record, are simulated if none are given.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import onnx

from holdfast.core.errors import TooLittleToAdapt, UsageError, WorseThanBase, count_of
from holdfast.core.locked import require_open
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import (
    CARD_SUFFIX,
    ModelCard,
    read_card,
    read_sealed,
    votes_in_all,
)
from holdfast.export.changed import (
    Adaptation,
    adapted,
    is_adapted,
    undone,
    verify_adapted,
)
from holdfast.export.exporting import metadata_of, readable_card
from holdfast.export.verify import AdaptedVerification
from holdfast.sessions.adapt_evidence import (
    PersonCounts,
    contradicted,
    counts_of,
    label_weights,
    streams_of,
)
from holdfast.sessions.adapt_point import Evidence, HeldOutFigures, OperatingPoint
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import find, load
from holdfast.training.progress import Part, Stages, ignored
from holdfast.training.recording import DataSet

LEAST_HAND_OVERS = 8
"""As many as the adaptation protocol asks for."""
LEAST_HOLDING_S = 40.0
"""Of a grip without a slip, in which nothing may be called."""
LEAST_SLIPS = 40
"""Of so many, a single missed slip already falls below LEAST_RECALL."""
SCENE = "thesis"
TRIALS = 300
SEED = 1
"""Of simulated slips. Models are trained on seed 0."""


@dataclass(frozen=True)
class AdaptedFile:
    """What an adaptation was fitted on, and reaches beside its base on the same trials.

    contradicted: trials of the person whose labels the base contradicts.
    """

    person: PersonCounts
    point: OperatingPoint
    base: HeldOutFigures
    contradicted: list[str]
    verified: AdaptedVerification


@contextmanager
def base_model(path: Path) -> Iterator[tuple[Model, bytes]]:
    """The opened base model and its bytes. Raises what opening a model raises."""
    data = read_sealed(path)
    if not is_adapted(data):
        yield Model(path), data
        return

    # Corrections do not stack: a second adaptation starts from the base again.
    base = undone(data, path)
    with tempfile.TemporaryDirectory() as folder:
        # The runtime opens files by their path, so the base needs one for a moment.
        file = Path(folder) / path.name
        file.write_bytes(base)
        yield Model(file), base


def adapt_file(
    model_path: Path,
    data: str,
    person: str,
    slips: str | None,
    out: Path,
    begin: Stages,
    *,
    worse_too: bool = False,
) -> AdaptedFile:
    """Fit, build, verify and write. slips: recordings with slips, None for simulated ones.

    Warns (ContradictedLabels) before anything is fitted. worse_too: write a file that is worse than
    its base too; else it raises WorseThanBase. Raises TooLittleToAdapt; ChannelError, UnitError or
    RateError where a set does not fit.
    """
    with base_model(model_path) as (model, base):
        begin("reading the person's recordings")
        own = of_person(_read(data, model, begin.part), person)
        counts = counts_of(own.recordings)
        require_enough(counts)
        others = _slips(slips, model, begin)
        begin(f"running the model on {count_of(counts.trials, 'trial')} of the person")
        of_own = streams_of(model, own, begin.part)
        rules = model.card.decision
        against = contradicted(of_own, rules)
        n_others = count_of(len(others.recordings), "recording")
        begin(f"running the model on {n_others} with slips ({others.name})")
        of_others = streams_of(model, others, begin.part)

    begin("fitting the correction, each trial held out in turn")
    in_all = votes_in_all(model.card.raw["heads"]["situation"])
    evidence = Evidence(of_own, of_others, rules, label_weights(model), in_all)
    # Without a sample that may be called risky, only the decision's parameters can be adapted.
    point = evidence.choose(threshold_only=not any(len(one.row) for one in of_own))
    of_base = evidence.base_figures()
    worse = point.reached.worse_than(of_base)
    if worse and not worse_too:
        raise WorseThanBase(
            f"adapted, it would be worse on trials held out: {'; '.join(worse)}",
            cause="labels that are wrong, or hand-overs that look like slips",
            next_step="correct the labels or record again; --force writes the file anyway",
        )

    begin("building, verifying and sealing the file")
    # Counts and figures only: no name of a person or a folder goes into a model file.
    about = {
        "person": asdict(counts),
        "others": {
            "recordings": len(of_others),
            "slips": sum(len(stream.recording.events) for stream in of_others),
        },
        "held_out": asdict(point.reached),
        "base_held_out": asdict(of_base),
    }
    correction = evidence.correction(point)
    made = adapted(base, Adaptation(correction, point.rules, about))
    rows = np.concatenate([one.features for one in (*of_own, *of_others)])
    # Before it is written: a file that fails is never on the disk.
    verified = verify_adapted(base, made, correction, rows)
    _write(out, made)
    return AdaptedFile(counts, point, of_base, against, verified)


def write_base(adapted_path: Path, out: Path) -> None:
    """The base of an adapted file, byte for byte."""
    _write(out, undone(read_sealed(adapted_path), adapted_path))


def _write(path: Path, data: bytes) -> None:
    """The file, and its card next to it."""
    # Read from the file, so that the card shows what it says.
    card = read_card(metadata_of(onnx.load_from_string(data)), path)
    write_whole(path, data)
    write_whole(path.with_suffix(CARD_SUFFIX), readable_card(card.raw, path.name, data))


# -- recordings


def _read(name: str, model: Model, part: Part) -> DataSet:
    """The recordings of a set or folder. Raises SetLocked for a set that is kept for tests."""
    require_open(find(name), "a correction", styles=False)
    card = model.card
    return load(
        name,
        channels=card.n_channels,
        rate_hz=card.rate_hz,
        windows="none",
        part=part,
    )


def _slips(slips: str | None, model: Model, begin: Stages) -> DataSet:
    """Recordings that keep the recall. Raises TooLittleToAdapt where they have too few slips."""
    if slips:
        begin(f"reading {slips}")
        others = _read(slips, model, begin.part)
    else:
        begin("simulating trials with slips")
        others = simulated_slips(model.card, part=begin.part)

    n_slips = sum(len(one.events) for one in others.recordings)
    if n_slips < LEAST_SLIPS:
        raise TooLittleToAdapt(
            f"{n_slips} risky slips of {LEAST_SLIPS} in {others.name}",
            cause="the correction must be shown what it has to keep",
            next_step="holdfast simulate thesis --trials 300 --seed 1 --out slips, then --slips "
            "slips",
        )
    return others


def require_enough(counts: PersonCounts) -> None:
    """Raise TooLittleToAdapt that says what to record."""
    missing = []
    if counts.hand_overs < LEAST_HAND_OVERS:
        missing.append(f"{counts.hand_overs} hand-overs of {LEAST_HAND_OVERS}")
    if counts.holding_s < LEAST_HOLDING_S:
        missing.append(f"{counts.holding_s:.0f} s of holding of {LEAST_HOLDING_S:.0f}")
    if missing:
        raise TooLittleToAdapt(
            " and ".join(missing),
            cause="an adaptation from less would follow chance; without a mark of the load onset "
            "a hand-over has no label",
            next_step="holdfast record --source URL --out DIR --person p01 --protocol "
            "simulation/cards/adapt.toml",
        )


def of_person(data: DataSet, person: str) -> DataSet:
    """The recordings of a person; all of them where the set names no person. Raises UsageError."""
    people = sorted({one.person for one in data.recordings if one.person is not None})
    # A folder without people is taken as one person's recordings.
    if not people:
        return data
    kept = [one for one in data.recordings if one.person == person]
    if not kept:
        raise UsageError(
            f"--person {person}: no recording in {data.name} is of this person",
            next_step=f"choose from {', '.join(people)}",
        )
    return replace(data, recordings=kept, tasks={})


def simulated_slips(
    card: ModelCard, trials: int = TRIALS, part: Part = ignored
) -> DataSet:
    """Trials of the thesis' protocol at the model's rate. Raises UsageError for another hand."""
    if card.unit != "N" or card.n_channels != 18:
        raise UsageError(
            "--slips is needed: scenes have six sensors in N, this model has "
            f"{card.n_channels // 3} in {card.unit}",
            next_step="--slips FOLDER, with recordings of pulls and falls by any person",
        )

    scene = Scene(read_scene_file(SCENE, rate_hz=card.rate_hz), SEED)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / SCENE
        write_set(scene, out, trials, lambda n: part(min(1.0, n / trials)))
        # Read within the block: the folder is gone after it.
        return load(out, windows="none")
