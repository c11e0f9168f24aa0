"""One rate of simulated scenes: trials and objects held out, unseen styles, retrainings.

Every row of the table is a candidate (features, forest). A trial is never on both sides of a split,
and nothing is fitted on apple, p1 or p2. Styles (author, p1, p2) are ranges of parameters, not
people.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import CLASSES
from holdfast.core.errors import DataNotFound, UnitError
from holdfast.core.reading import Json
from holdfast.core.trial_layout import read_json
from holdfast.evaluation.baseline_signals import (
    SHEAR_RATE_LAW,
    clock_features,
    raw_windows,
    shear_rate_at,
)
from holdfast.evaluation.stream_pictures import StreamPicture
from holdfast.evaluation.window_scores import (
    ClassScores,
    calls,
    confusion,
    leak_check,
    scores,
    spread_of,
)
from holdfast.export.learner import reference_votes
from holdfast.export.network import IntArray
from holdfast.export.spec import window_samples
from holdfast.training.crossval import HeldOut, cross_validate, fit_learner
from holdfast.training.datasets import join, load, require_alike
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.plan import CLOCK_PLAN, RAW_BASELINE, TrainingPlan
from holdfast.training.progress import Say
from holdfast.training.recording import DataSet
from studies.row_names import CLOCK, LINE, OURS, RAW
from studies.scenes.figures import (
    LearningPoint,
    OtherSetFigures,
    RateFigures,
    Retraining,
    ShearRateFigures,
    StyleLeftOut,
)
from studies.scenes.held_out import held_out_streams

TRAINED = "thesis"
OTHERS = ("apple", "p1", "p2")
STYLES = ("p1", "p2")
RETRAININGS = 5
TRIALS = (100, 200, 400, 600, 800, 1000)
"""Of the learning curve; the thesis had 600, then 1000."""
CAVEAT = (
    "Simulated: a model of a hand and of people, no recording. Styles (author, p1, p2) are ranges "
    "of parameters, not people. The figures show what the method can tell apart in the scenes' "
    "physics, not how good it is on a hand."
)
"""Stands beside every number of the study."""
STAGES = 14 + RETRAININGS
"""Lines one rate says, for the progress bar, when every card is there."""


@dataclass(frozen=True)
class Candidate:
    """A way to answer: its plan, and what it sees of the windows of "classes" [M, F]."""

    plan: TrainingPlan
    features: Callable[[DataSet], FloatRows]

    def votes(
        self,
        data: DataSet,
        features: FloatRows,
        train: IntArray,
        rows: FloatRows,
        seed: int,
    ) -> IntArray:
        """Votes [K, 8] on rows [K, F] of a forest fitted on some windows of a set."""
        forest = fit_learner(data, features, self.plan, "classes", train, seed)
        return reference_votes(forest, rows, len(CLASSES))


def step_graph(plan: TrainingPlan) -> Callable[[DataSet], FloatRows]:
    """The features of a plan, as the step graph on the hand makes them."""
    return lambda data: features_of(data, spec_for(data, plan.groups))["classes"]


def ways(
    plan: TrainingPlan | None = None,
    raw: TrainingPlan = RAW_BASELINE,
    clock: TrainingPlan = CLOCK_PLAN,
) -> dict[str, Candidate]:
    """Our forest and the baseline forests."""
    ours = plan or TrainingPlan()
    return {
        OURS: Candidate(ours, step_graph(ours)),
        RAW: Candidate(raw, raw_windows),
        CLOCK: Candidate(clock, clock_features),
    }


@dataclass(frozen=True)
class RateStudy:
    """Figures of one rate, and what its pictures are made from."""

    figures: RateFigures
    data: DataSet
    held_out: HeldOut
    streams: list[StreamPicture]


def study_rate(
    folder: Path, chosen: dict[str, Candidate], seed: int, say: Say
) -> RateStudy:
    """Everything about the sets in one rate's folder. Raises DataNotFound, UnitError or
    RateError."""
    say(f"{folder.name}: reading {TRAINED}")
    data = read_trained(folder, seed)
    features = {}
    for name, way in chosen.items():
        say(f"{folder.name}: features, {name}")
        features[name] = way.features(data)
    say(f"{folder.name}: trials held out")
    held = {
        name: cross_validate(data, {"classes": features[name]}, way.plan, seed=seed)
        for name, way in chosen.items()
    }
    rows = {
        name: scores(data, held[name].votes["classes"], seed=seed) for name in chosen
    }
    leak = leak_check(data, held[RAW].votes["classes"], seed=seed)
    say(f"{folder.name}: objects held out")
    objects = {
        name: objects_held_out(data, features[name], way, seed)
        for name, way in chosen.items()
    }
    figures = RateFigures(
        rate_hz=data.rate_hz,
        window_samples=window_samples(data.rate_hz),
        data=described(data, folder / TRAINED),
        rows=rows | {LINE: shear_rate_figures(data, seed)},
        leak=leak,
        objects=objects,
        others=evaluated_on_others(folder, data, features, chosen, seed, say),
        styles=_styles(folder, data, chosen, seed, say),
        learning_curve=_fewer_trials(folder.name, data, features, chosen, seed, say),
        retrainings=retrained(folder.name, data, features, chosen, seed, say),
    )
    say(f"{folder.name}: three whole trials")
    streams = held_out_streams(
        folder / TRAINED, data, features[OURS], chosen[OURS].plan, seed
    )
    return RateStudy(figures, data, held[OURS], streams)


def _styles(
    folder: Path, data: DataSet, chosen: dict[str, Candidate], seed: int, say: Say
) -> dict[str, StyleLeftOut] | None:
    """Each style left out; None where only one style is there."""
    there = [card for card in STYLES if (folder / card).is_dir()]
    if not there:
        return None
    styles = {TRAINED: data} | {
        card: load(folder / card, seed=seed, windows="thesis") for card in there
    }
    return styles_left_out(
        styles, chosen, seed, lambda line: say(f"{folder.name}: {line}")
    )


def _fewer_trials(
    rate: str,
    data: DataSet,
    features: dict[str, FloatRows],
    chosen: dict[str, Candidate],
    seed: int,
    say: Say,
) -> list[LearningPoint]:
    say(f"{rate}: fewer trials")
    pair = {name: way for name, way in chosen.items() if name in (OURS, RAW)}
    return learning_curve(data, features, pair, seed)


def read_trained(folder: Path, seed: int) -> DataSet:
    """The thesis' undersampled set, to train on, in newtons for which the baselines are made."""
    rate = folder.name.removesuffix("hz")
    if not (folder / TRAINED).is_dir():
        raise DataNotFound(
            f"no {TRAINED} in it",
            where=folder,
            next_step=f"holdfast simulate {TRAINED} --rate {rate} --out {folder / TRAINED}",
        )
    data = load(folder / TRAINED, seed=seed, windows="thesis")
    if data.unit != "N":
        raise UnitError(
            f"in {data.unit}, the study is in N",
            where=data.name,
            next_step="simulate with unit N",
        )
    return data


def described(data: DataSet, folder: Path) -> Json:
    """What a set is, for the JSON: kind, card, counts of trials, windows and samples."""
    meta = read_json(folder / "meta.json")
    known = {"name": data.name, "kind": data.kind, "n_trials": len(data.recordings)}
    for key in ("title", "card_sha256", "seed", "step_s"):
        if key in meta:
            known[key] = meta[key]
    for key in ("windows", "windows_natural", "samples"):
        if key in data.notes:
            known[key] = data.notes[key]
    return known


def shear_rate_figures(data: DataSet, seed: int) -> ShearRateFigures:
    """What the one-line detector calls, at a window's last sample and anywhere in its 0.10 s."""
    reach = window_samples(data.rate_hz)
    return ShearRateFigures(
        law=SHEAR_RATE_LAW,
        n_windows=len(data.tasks["classes"]),
        calls=calls(data, shear_rate_at(data), seed=seed),
        calls_anywhere_in_the_window=calls(data, shear_rate_at(data, reach), seed=seed),
    )


def objects_held_out(
    data: DataSet, features: FloatRows, way: Candidate, seed: int
) -> dict[str, ClassScores]:
    """Object -> figures on its windows from a forest trained without the object."""
    names = np.array([recording.object_name or "" for recording in data.recordings])[
        data.tasks["classes"].trial
    ]
    figures = {}
    for name in sorted(set(names.tolist()) - {""}):
        held_out = names == name
        votes = way.votes(
            data, features, np.flatnonzero(~held_out), features[held_out], seed
        )
        part = replace(data, tasks={"classes": data.tasks["classes"].take(held_out)})
        figures[name] = scores(part, votes, seed=seed)
    return figures


def evaluated_on_others(
    folder: Path,
    data: DataSet,
    features: dict[str, FloatRows],
    chosen: dict[str, Candidate],
    seed: int,
    say: Say,
) -> dict[str, OtherSetFigures]:
    """Card -> figures on all its windows (not undersampled), trained on every thesis trial."""
    everything = np.arange(len(data.tasks["classes"]))
    figures = {}
    for card in (card for card in OTHERS if (folder / card).is_dir()):
        say(f"{folder.name}: trained on {TRAINED}, evaluated on {card}")
        other = load(folder / card, windows="natural")
        require_alike(other, data)
        other = replace(other, rate_hz=data.rate_hz)
        rows = {
            name: scores(
                other,
                way.votes(data, features[name], everything, way.features(other), seed),
                seed=seed,
            )
            for name, way in chosen.items()
        }
        threshold = {LINE: shear_rate_figures(other, seed)}
        figures[card] = OtherSetFigures(
            described(other, folder / card), rows | threshold
        )
    return figures


def retrained(
    rate: str,
    data: DataSet,
    features: dict[str, FloatRows],
    chosen: dict[str, Candidate],
    seed: int,
    say: Say,
) -> dict[str, Retraining]:
    """Five cross-validations with other seeds, for our forest and the raw-window forest."""
    seeds = [seed + k for k in range(RETRAININGS)]
    matrices: dict[str, list[IntArray]] = {OURS: [], RAW: []}
    for number, one in enumerate(seeds, start=1):
        say(f"{rate}: retraining {number} of {len(seeds)}")
        for name, found in matrices.items():
            again = cross_validate(
                data, {"classes": features[name]}, chosen[name].plan, seed=one
            )
            found.append(confusion(data.tasks["classes"].label, again.votes["classes"]))
    return {name: retraining(seeds, found) for name, found in matrices.items()}


def retraining(seeds: Sequence[int], matrices: list[IntArray]) -> Retraining:
    """Figures of retrainings. matrices: [8, 8] counts of each."""
    counts = [matrix.tolist() for matrix in matrices]
    spread = vars(spread_of(matrices))
    return Retraining(**spread, seeds=list(seeds), confusion=counts)


def styles_left_out(
    sets: Mapping[str, DataSet], ways: Mapping[str, Candidate], seed: int, say: Say
) -> dict[str, StyleLeftOut]:
    """Style -> figures on its windows of forests trained on the other styles alone."""
    figures = {}
    for style, unseen in sets.items():
        say(f"{style} left out")
        seen = join([one for name, one in sets.items() if name != style])
        rows = {
            name: scores(unseen, _votes(way, seen, unseen, seed), seed=seed)
            for name, way in ways.items()
        }
        figures[style] = StyleLeftOut(len(seen.recordings), rows)
    return figures


def _votes(way: Candidate, seen: DataSet, unseen: DataSet, seed: int) -> IntArray:
    """[M, 8] votes on the unseen windows of a forest trained on all that are seen."""
    every = np.arange(len(seen.tasks["classes"]))
    return way.votes(seen, way.features(seen), every, way.features(unseen), seed)


def learning_curve(
    data: DataSet,
    features: Mapping[str, Any],
    ways: Mapping[str, Candidate],
    seed: int,
    counts: Sequence[int] = TRIALS,
) -> list[LearningPoint]:
    """Figures of every method from so many of the trials, trials held out."""
    order = np.random.default_rng(seed).permutation(len(data.recordings))
    task = data.tasks["classes"]
    points = []
    for count in (one for one in counts if one <= len(order)):
        mask = np.isin(task.trial, order[:count])
        part = replace(data, tasks={"classes": task.take(mask)})
        rows: dict[str, ClassScores] = {}
        for name, way in ways.items():
            held = cross_validate(
                part, {"classes": features[name][mask]}, way.plan, seed=seed
            )
            rows[name] = scores(part, held.votes["classes"], seed=seed)
        points.append(LearningPoint(count, int(mask.sum()), rows))
    return points
