"""From a person's recordings to an adaptation of a model file, chosen and fitted.

The base that an adaptation starts from: the file itself, or the base inside an adapted file.

Recordings with slips, which a person does not have to record: simulated, if none are given.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.core.errors import TooLittleToAdapt, UsageError
from holdfast.core.reading import Json
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import ModelCard, read_sealed, votes_in_all
from holdfast.export.adapted_file import Adaptation, is_adapted, undone
from holdfast.export.heads import FloatRows
from holdfast.sessions.adapting.choice import OperatingPoint, choose, correction_at
from holdfast.sessions.adapting.evidence import (
    PersonCounts,
    Stream,
    counts_of,
    label_weights,
    streams_of,
)
from holdfast.simulation.card import read_card
from holdfast.simulation.closed_loop.recording import scene_of
from holdfast.simulation.folder import write_set
from holdfast.training.datasets import load
from holdfast.training.progress import Part, Say, ignored
from holdfast.training.recording import DataSet

LEAST_HAND_OVERS, LEAST_HOLDING_S, LEAST_SLIPS = 8, 40.0, 40


@dataclass(frozen=True)
class Fitted:
    """An adaptation, the held-out figures of its operating point, and what it was fitted on."""

    adaptation: Adaptation
    point: OperatingPoint
    streams: list[Stream]

    def rows(self) -> FloatRows:
        """[N, F] features of all samples that a correction may change, to verify on."""
        return np.concatenate([one.features for one in self.streams])


def adapt(
    model: Model,
    person: DataSet,
    others_of: Callable[[], DataSet],
    say: Say = ignored,
    part: Part = ignored,
) -> Fitted:
    """Adapt a base model to a person. others_of: reads recordings with slips, of any person.

    Raises TooLittleToAdapt; ChannelError, UnitError or RateError where a set does not fit.
    """
    counts = counts_of(person.recordings)
    require_enough(counts)
    others = others_of()
    require_slips(others)
    say(f"running the model on {counts.trials} trials of the person")
    own = streams_of(model, person, part)
    say(
        f"running the model on {len(others.recordings)} recordings with slips ({others.name})"
    )
    return adapt_streams(model, own, streams_of(model, others, part), counts, say)


def adapt_streams(
    model: Model,
    person: Sequence[Stream],
    others: Sequence[Stream],
    counts: PersonCounts,
    say: Say = ignored,
) -> Fitted:
    """Adapt from computed answers. counts: what the person's recordings hold."""
    in_all = votes_in_all(model.card.raw["heads"]["situation"])
    weights = label_weights(model)
    say("fitting the correction, each trial held out in turn")
    wanted = in_all if any(len(one.row) for one in person) else None
    point = choose(person, others, model.card.decision, weights, wanted)
    correction = correction_at(point, person, others, in_all)
    about = _about(counts, others, point)
    return Fitted(Adaptation(correction, point.rules, about), point, [*person, *others])


def _about(
    counts: PersonCounts, others: Sequence[Stream], point: OperatingPoint
) -> Json:
    """What the card says of an adaptation: counts and figures, no name of a person or a folder."""
    return {
        "person": asdict(counts),
        "others": {
            "recordings": len(others),
            "slips": sum(len(one.recording.events) for one in others),
        },
        "held_out": asdict(point.reached),
    }


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


def require_slips(others: DataSet) -> None:
    """Raise TooLittleToAdapt where the recordings that keep the recall have too few slips."""
    slips = sum(len(one.events) for one in others.recordings)
    if slips < LEAST_SLIPS:
        raise TooLittleToAdapt(
            f"{slips} risky slips of {LEAST_SLIPS} in {others.name}",
            cause="the correction must be shown what it has to keep",
            next_step="holdfast simulate thesis --trials 300 --seed 1 --out slips, then --slips "
            "slips",
        )


def of_person(data: DataSet, person: str) -> DataSet:
    """The recordings of a person; all of them where the set names no person. Raises UsageError."""
    people = sorted({one.person for one in data.recordings if one.person is not None})
    if not people:
        return data
    if person not in people:
        raise UsageError(
            f"--person {person}: no recording in {data.name} is of this person",
            next_step=f"choose from {', '.join(people)}",
        )
    kept = [k for k, one in enumerate(data.recordings) if one.person == person]
    tasks = {name: rows.of_trials(kept) for name, rows in data.tasks.items()}
    return replace(data, recordings=[data.recordings[k] for k in kept], tasks=tasks)


@contextmanager
def base_model(path: Path) -> Iterator[tuple[Model, bytes]]:
    """The opened base model and its bytes. Raises what opening a model raises."""
    data = read_sealed(path)
    if not is_adapted(data):
        yield Model(path), data
        return
    base = undone(data, path)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        file.write_bytes(base)
        yield Model(file), base


CARD, TRIALS, SEED = "thesis", 300, 1
"""Models are trained on seed 0."""


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
    scene = scene_of(read_card(CARD, rate_hz=card.rate_hz), SEED)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / CARD
        write_set(scene, out, trials, lambda n: part(min(1.0, n / trials)))
        return load(out, windows="none")
