"""`python -m studies robustness`: what robustness costs, in time and on a hand not disturbed.

One learner (20 trees, two networks) on different features: those of sensors in fixed places, those
that are pooled over sensors, and these without one family; with and without disturbed copies in
training. Each acts from the confidence at which, on other trials, so many voluntary actions are
called. Then the same trials are asked unchanged and disturbed, one nuisance at a time. All steps
are timed in one run. Seeds are of development: nothing here is a test.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks.timed_calls import FLOOR, step_call, times_beside
from holdfast.core.reading import Json
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.preparation import Preparation
from holdfast.evaluation.model_outputs import (
    ModelOutputs,
    everywhere,
    read_outputs,
    steps_with,
)
from holdfast.evaluation.thresholds import requests_of
from holdfast.export.artifact import Artifact
from holdfast.export.exporting import model_card, seal, whole_graph
from holdfast.export.features import feature_count
from holdfast.export.heads import Calibration, Head
from holdfast.export.learner import Learner
from holdfast.export.spec import BandsLeftOut, StepSpec
from holdfast.training.crossval import learner_of
from holdfast.training.datasets import join, load
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.nuisances import with_copies
from holdfast.training.plan import CLOCK_FREE_GROUPS, POOLED_GROUPS, pooled_plan
from holdfast.training.progress import Say, stages
from holdfast.training.recording import DataSet, IntArray, Recording
from studies.distortions.open_loop import (
    OUTPUTS,
    OpenOutcomes,
    open_figures,
    outcomes_of,
)
from studies.distortions.table import TRIALS, UNCHANGED, by_name
from studies.distortions.trials import felt_set, recording_of
from tools.harness import SimulatedSet, simulate_sets, write_figures

TASK = "classes"
PLAN = pooled_plan("default")
ACROSS = "pooled_across"
EVERY_GROUP = (*CLOCK_FREE_GROUPS, *POOLED_GROUPS, ACROSS)
"""Computed once; each choice takes its columns."""
TRAIN_SEED, CHOOSE_SEED, ASK_SEED = 110, 111, 112
"""Of development."""
RATE_HZ = 150.0
CALLED = 0.08
"""Share of the voluntary actions on the unchanged trials of CHOOSE_SEED at which all compare."""
CONFIDENCES = range(300, 1000, 10)
DISTURBED = (
    "turned-any",
    "gain-0.4",
    "shear-0.5",
    "noise-30",
    "dead-1-invalid",
)
"""Names of the study of distortions."""


@dataclass(frozen=True)
class Sizes:
    """Trials of each training card, to choose on and to ask; rounds and calls of the timing."""

    train: int = 300
    choose: int = 160
    ask: int = 160
    turns: int = 40
    calls: int = 100


@dataclass(frozen=True)
class Choice:
    """What is varied. copies: trained on disturbed copies too. degraded: answers without all."""

    name: str
    groups: tuple[str, ...]
    copies: bool = True
    degraded: bool = True


def choices() -> list[Choice]:
    """Fixed and pooled features, then the pooled ones with a family less or more."""
    pooled = "pooled features"
    found = [
        Choice("fixed features", CLOCK_FREE_GROUPS, copies=False),
        Choice("fixed features, disturbed copies", CLOCK_FREE_GROUPS),
        Choice(pooled, POOLED_GROUPS, copies=False),
        Choice(f"{pooled}, disturbed copies", POOLED_GROUPS),
        Choice("the same, no degraded answers", POOLED_GROUPS, degraded=False),
    ]
    for group in POOLED_GROUPS:
        left = tuple(one for one in POOLED_GROUPS if one != group)
        found.append(Choice(f"the same without {_short(group)}", left))
    found.append(Choice(f"the same with {_short(ACROSS)}", (*POOLED_GROUPS, ACROSS)))
    return found


def _short(group: str) -> str:
    return group.removeprefix("pooled_")


@dataclass(frozen=True)
class Trained:
    """The training windows: their set, its step with all groups, and [M, F] of all features.

    own: so many windows are of the recordings themselves, those after them of their copies.
    """

    data: DataSet
    spec: StepSpec
    rows: FloatRows
    own: int

    def columns(self, groups: Sequence[str]) -> IntArray:
        """[F] places of some groups among all features."""
        place = 0
        places = {}
        for group in self.spec.groups:
            count = feature_count(replace(self.spec, groups=(group,)))
            places[group] = np.arange(place, place + count)
            place += count
        return np.concatenate([places[group] for group in groups])


def trained_on(folders: Sequence[Path]) -> Trained:
    """Windows and features of training sets with a disturbed copy of each recording."""
    plain = join([load(folder, windows="dense") for folder in folders])
    plain = replace(plain, tasks={TASK: plain.tasks[TASK]})
    data = with_copies(plain, 1, TRAIN_SEED)
    spec = spec_for(data, EVERY_GROUP)
    return Trained(data, spec, features_of(data, spec)[TASK], len(plain.tasks[TASK]))


def fitted(choice: Choice, trained: Trained) -> Learner:
    """The learner of a choice."""
    stop = len(trained.rows) if choice.copies else trained.own
    rows = np.asarray(trained.rows[:stop])[:, trained.columns(choice.groups)]
    task = trained.data.tasks[TASK]
    label = task.label[:stop]
    return learner_of(PLAN, TASK, rows, label, len(task.classes), TRAIN_SEED)


def file_of(choice: Choice, trained: Trained, learner: Learner) -> bytes:
    """The sealed model file of a choice; probabilities are the votes' shares."""
    spec = replace(trained.spec, groups=choice.groups, min_valid_sensors=0)
    if not choice.degraded:
        spec = replace(spec, min_valid_sensors=spec.n_sensors)
    classes = trained.data.tasks[TASK].classes
    k = len(classes)
    even = Calibration(np.eye(k), np.zeros(k))
    heads = [Head("situation", classes, learner, even)]
    nothing = np.zeros((1, feature_count(spec)), np.float32)
    decision = PLAN.decision.to_json()
    preparation = trained.data.preparation
    made = Artifact(spec, preparation, decision, heads, nothing, {})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandsLeftOut)
        return seal(whole_graph(spec, heads), model_card(made), spec)


@dataclass(frozen=True)
class Asked:
    """A model file on the trials of a seed, disturbed in one way."""

    model: Model
    trials: int
    seed: int

    def outputs(self, name: str) -> list[ModelOutputs]:
        """What it answers. name: of a distortion."""
        preparation = self.model.card.preparation
        recordings = _recordings(self.trials, self.seed, name, preparation)
        computed = everywhere(steps_with(self.model, OUTPUTS), recordings)
        return read_outputs(self.model, recordings, computed)

    def became(self, outputs: Sequence[ModelOutputs], permille: int) -> OpenOutcomes:
        """What became of the trials, from a confidence on."""
        card = self.model.card
        requests = requests_of(outputs, card.decision, permille)
        return outcomes_of(outputs, requests, card.settle_samples, self.seed)


@lru_cache(maxsize=16)
def _recordings(
    trials: int, seed: int, name: str, preparation: Preparation
) -> list[Recording]:
    distortion = by_name()[name]
    of = felt_set(str(TRIALS), trials, seed)
    return [recording_of(of, one, distortion, preparation) for one in of.trials]


def confidence_of(asked: Asked) -> int:
    """The least confidence at which CALLED of the voluntary actions are called, or fewer."""
    outputs = asked.outputs(UNCHANGED)
    for permille in CONFIDENCES:
        called = list(asked.became(outputs, permille).called.values())
        if not called or np.mean(called) <= CALLED:
            return permille
    return CONFIDENCES[-1]


def figures_of(path: Path, sizes: Sizes) -> Json:
    """The figures of a model file, unchanged and disturbed."""
    model = Model(path)
    permille = confidence_of(Asked(model, sizes.choose, CHOOSE_SEED))
    asked = Asked(model, sizes.ask, ASK_SEED)
    unchanged = asked.became(asked.outputs(UNCHANGED), permille)
    rows = {UNCHANGED: open_figures(unchanged, unchanged)}
    for name in DISTURBED:
        became = asked.became(asked.outputs(name), permille)
        rows[name] = open_figures(became, unchanged)
    return {"permille": permille, "delay_ms": unchanged.delay_ms, "sets": rows}


def robust(out: Path, sizes: Sizes, say: Say, chosen: Sequence[Choice] = ()) -> Json:
    """All choices: figures, and what a step costs, all files timed in one run."""
    say("training trials")
    sets = [
        SimulatedSet(f"{card}-{sizes.train}", card, sizes.train, TRAIN_SEED, RATE_HZ)
        for card in ("thesis", "wide")
    ]
    missing = [one for one in sets if not (out / one.folder).is_dir()]
    simulate_sets(missing, out)
    say("features of the training windows")
    trained = trained_on([out / one.folder for one in sets])

    rows = []
    files: dict[str, bytes] = {}
    learners: dict[tuple[tuple[str, ...], bool], Learner] = {}
    for choice in chosen or choices():
        say(choice.name)
        key = (choice.groups, choice.copies)
        if key not in learners:
            learners[key] = fitted(choice, trained)
        data = files[choice.name] = file_of(choice, trained, learners[key])
        path = out / f"{len(files)}.onnx"
        write_whole(path, data)
        about = {"name": choice.name, "features": len(trained.columns(choice.groups))}
        rows.append(about | {"bytes": len(data)} | figures_of(path, sizes))

    say("the time of a step")
    times = _times(files, sizes)
    for row in rows:
        row |= times[str(row["name"])]
    return {
        "rows": rows,
        "floor": times[FLOOR],
        "windows": [trained.own, len(trained.rows)],
        "trials": {"train": sizes.train, "choose": sizes.choose, "ask": sizes.ask},
        "seeds": {"train": TRAIN_SEED, "choose": CHOOSE_SEED, "ask": ASK_SEED},
        "called_at_most": CALLED,
    }


def _times(files: dict[str, bytes], sizes: Sizes) -> dict[str, Json]:
    """us of a step: median, 99 %, and over that of the first file."""
    of = felt_set(str(TRIALS), sizes.ask, ASK_SEED)
    samples = of.trials[0].forces_n.reshape(len(of.trials[0].t_s), -1)
    calls: dict[str, Callable[[], object]] = {}
    for name, data in files.items():
        calls[name] = step_call(data, samples)
    return times_beside(calls, sizes.turns, sizes.calls)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    for name, about in (("train", "a training card"), ("ask", "to ask and choose on")):
        trials = getattr(Sizes(), name)
        words = f"trials {about} (default {trials})"
        parser.add_argument(f"--{name}", type=int, default=trials, help=words)


def run(args: argparse.Namespace) -> int:
    """Measure all choices, write robustness.json."""
    sizes = Sizes(train=args.train, choose=args.ask, ask=args.ask)
    with stages(len(choices()) + 3) as say:
        figures = robust(args.out, sizes, say)
    print(write_figures(args.out / "robustness.json", figures))
    return 0
