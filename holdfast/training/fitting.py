"""One training run: sets -> features -> held-out figures -> calibrated learners -> an artifact."""

from __future__ import annotations

import hashlib
import platform
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from holdfast.core.contract import (
    CANNOT_TELL,
    MOST_AVERAGED,
    Json,
    averaged_by,
    not_learned_of,
)
from holdfast.core.errors import RateError, UsageError
from holdfast.core.progress import Part, Say, Stages, ignored
from holdfast.core.writing import require_free, require_writable
from holdfast.data.datasets import find, load
from holdfast.data.datasets.joining import join, of_several_hands
from holdfast.data.datasets.trials import sides_unknown, warn_of
from holdfast.data.fixture import write_fixture
from holdfast.data.metrics import PLURAL, HeadFigures
from holdfast.data.recording import (
    DataSet,
    HoldOut,
    Recording,
    cannot_tell,
    counts_in_words,
    learnable,
    regrouped,
)
from holdfast.data.windows import Choice
from holdfast.step.artifact import INDEX, Artifact, write_artifact
from holdfast.step.heads import Head
from holdfast.training.crossval import (
    FloatRows,
    HeldOut,
    cross_validate,
    features_of_each_hand,
    fit_calibration,
    fit_learner,
    main_task,
    spec_for,
    window_counts,
    with_even_classes,
)
from holdfast.training.judging import (
    CurvePoint,
    as_grouped,
    held_out_figures,
    learning_curve,
    strictest_hold_out,
)
from holdfast.training.plan import PLANS, TASK_HEADS, LearnerKind, TrainingPlan, at_rate

if TYPE_CHECKING:
    from holdfast.step.spec import StepSpec

VERSIONS_OF = ("numpy", "scipy", "scikit-learn", "skl2onnx", "onnx", "onnxruntime")
FIXTURE = "fixture"
FIXTURE_TRIALS = 4
"""Trials a cell: enough windows for a forest to learn something, few enough for a minute of CI."""
FEWEST_WINDOWS = 50
"""Of a class; below, a forest learns single trials and an F1 jumps with each window."""


class FewWindows(UserWarning):
    """A class with fewer windows than FEWEST_WINDOWS."""


class FewGroups(UserWarning):
    """A set of two groups (people, objects, blocks, trials) only, or with a situation in one."""


@dataclass(frozen=True)
class TrainingRequest:
    """What `train_on_sets` is asked for.

    data: sets by name or folder; none for the generated fixture. replace: an artifact in `out` may
    be replaced. windows: as `datasets.load` takes them. hold_out: what is held out, by name of a
    set, "" for all others; the strictest that the data allow where nothing is given. rate_hz: to
    learn at, None for that of the data. features, size, learner: of the plan. seed: of every random
    choice, so that the same request gives the same model. judge: compute the learning curve too.
    """

    data: tuple[str, ...]
    out: Path
    replace: bool = False
    hold_out: Mapping[str, HoldOut] = field(default_factory=dict)
    rate_hz: float | None = None
    windows: Choice = "balanced"
    features: str = "fixed"
    size: str = "default"
    learner: LearnerKind = "committee"
    seed: int = 0
    judge: bool = False


@dataclass(frozen=True)
class TrainedModel:
    """What a training run leaves in memory: held-out figures, and the votes behind them.

    curve: the same with fewer training data, where that was asked for. cannot_tell: situations and
    "weight" that the model does not know, with the reason. not_held_out: why no stricter hold-out
    was taken, a line each.
    """

    figures: HeadFigures
    held_out: HeldOut
    curve: list[CurvePoint] = field(default_factory=list)
    cannot_tell: dict[str, str] = field(default_factory=dict)
    not_held_out: list[str] = field(default_factory=list)


def train_on_sets(
    request: TrainingRequest, progress: Stages, describe: Callable[[str], None]
) -> tuple[DataSet, TrainedModel]:
    """Read the sets, train on all of them together and write the artifact.

    describe: receives a description of each set that was read. Returns the joined set and what was
    found of it. Raises UsageError, OutputError, or a DataError.
    """
    # Checked before anything is read, so that a long run does not end at a folder that it cannot
    # write.
    require_writable(request.out)
    require_free(request.out / INDEX, force=request.replace)

    # Without data the command trains on a generated set, which lies in the artifact's folder.
    names = request.data
    if not names:
        write_fixture(request.out / FIXTURE, trials_per_cell=FIXTURE_TRIALS)
        names = (str(request.out / FIXTURE),)

    else:
        # The generated set is open by its making, so a run without data does not load this.
        from holdfast.core.locked import require_open, require_open_people

        for name in names:
            require_open(find(name), "a model")

    sets: list[DataSet] = []
    for name in names:
        progress(f"reading {name}")
        # A set that can be had at the rate of the first is averaged down to it.
        rate_hz = request.rate_hz or (sets[0].rate_hz if sets else None)
        data = load(name, seed=request.seed, windows=request.windows, rate_hz=rate_hz)
        if request.data:
            require_open_people(data.name, data.people(), "a model")
        if request.rate_hz and averaged_by(data.rate_hz, request.rate_hz) != 1:
            raise RateError(
                f"{data.rate_hz:.4g} Hz is no whole multiple of --rate {request.rate_hz:g}",
                where=data.name,
                next_step=f"--rate {data.rate_hz:.4g}, or that divided by 2 to {MOST_AVERAGED}",
            )
        count = f"{len(data.recordings)} recordings at {data.rate_hz:.4g} Hz"
        describe(f"{data.name}: {data.kind}; {count}\n{_counts(data)}")
        sets.append(data)

    _require_known(request.hold_out, sets)
    plan = PLANS[request.features](request.size, request.learner)
    plan = at_rate(plan, sets[0].rate_hz)
    not_held_out: list[str] = []
    chosen = [_held_out(data, plan.folds, request, not_held_out) for data in sets]
    # Pooled features are the same numbers for any hand.
    joined = join(chosen, several_hands=plan.is_pooled)
    joined = learnable(joined)
    warn_of_scarcity(joined)

    trained = train(
        joined,
        request.out,
        plan,
        seed=request.seed,
        say=progress,
        part=progress.part,
        judge=request.judge,
    )
    return joined, replace(trained, not_held_out=not_held_out)


def _require_known(hold_out: Mapping[str, HoldOut], sets: Sequence[DataSet]) -> None:
    """Raise UsageError for a hold-out of a set that is not among these."""
    names = [data.name for data in sets]
    for name in hold_out:
        if name and name not in names:
            raise UsageError(
                f"--hold-out {name}=..: no such set",
                next_step=f"name one of {', '.join(names)}",
            )


def _held_out(
    data: DataSet, folds: int, request: TrainingRequest, reasons: list[str]
) -> DataSet:
    """The set with what is held out. reasons: receives why it is nothing stricter."""
    by = request.hold_out.get(data.name, request.hold_out.get(""))
    if by is None:
        choice = strictest_hold_out(data, folds, request.seed)
    else:
        choice = as_grouped(regrouped(data, by), folds, request.seed)

    several = len(request.data) > 1
    for line in choice.lines():
        reasons.append(f"{data.name}: {line}" if several else line)
    if choice.lacks:
        kind = PLURAL.get(choice.kind, "groups")
        warnings.warn(
            f"{data.name}: some of the {kind} have a situation to themselves "
            f"({choice.lacks}); models that hold them out never saw it, so do not trust figures "
            "and probabilities; next: record each situation more often",
            FewGroups,
            stacklevel=2,
        )
    return choice.data


def _counts(data: DataSet) -> str:
    """Windows by class, a line for each task, and before they were undersampled."""
    counts = {task: rows.class_counts() for task, rows in data.tasks.items()}
    if "windows_natural" in data.notes:
        counts["before undersampling"] = data.notes["windows_natural"]

    lines = [
        f"{task}: {counts_in_words(of_class)}" for task, of_class in counts.items()
    ]
    return "\n".join(lines)


def warn_of_scarcity(data: DataSet) -> None:
    """Warn (FewWindows, FewGroups) of a set that holds too little; each names the next step."""
    few = []
    groups: set[str] = set()
    for task, rows in data.tasks.items():
        groups.update(data.group_of(task).tolist())
        for name, count in rows.class_counts().items():
            # What has no window is not learned, and the model says so.
            if 0 < count < FEWEST_WINDOWS:
                few.append(f"{name} ({count})")

    # The thesis' undersampled set (--windows thesis) is as small as its rarest class.
    if few:
        warnings.warn(
            f"{data.name}: fewer than {FEWEST_WINDOWS} windows of {', '.join(few)}; do not trust "
            "the answers and figures of these; next: record or simulate more trials with them",
            FewWindows,
            stacklevel=2,
        )

    # With two groups each model has learned from one alone, and half of all draws hold one group
    # twice.
    if len(groups) == 2:
        kind = PLURAL.get(data.group_kind, "groups")
        warnings.warn(
            f"{data.name}: two {kind} only; each is answered by a model of the other alone, and "
            f"intervals mean little; next: record more {kind}",
            FewGroups,
            stacklevel=2,
        )


def train(
    data: DataSet,
    out: str | Path,
    plan: TrainingPlan,
    *,
    seed: int = 0,
    say: Say = ignored,
    part: Part = ignored,
    judge: bool = False,
) -> TrainedModel:
    """Train on a set and write the artifact folder.

    say: receives the name of each stage as it begins. part: receives the share of the stage that is
    done. judge: compute the learning curve too.

    Raises ClassMissing, TooFewGroups, RateError or OutputError.
    """
    # A set with nothing to tell apart is refused before any feature is computed.
    data = learnable(data)

    # A fold holds out at least one group, so there are at most as many folds as groups.
    plan = replace(plan, folds=min(plan.folds, max(2, len(data.groups()))))

    data, features = with_features(data, plan, seed, say, part)
    held_out, figures, artifact = fitted(data, features, plan, seed, say)
    write_artifact(out, artifact)
    curve = []
    if judge:
        curve = learning_curve(data, features, plan, seed, figures, say)
    return TrainedModel(
        figures, held_out, curve, not_learned_of({"training": artifact.training})
    )


def with_features(
    data: DataSet,
    plan: TrainingPlan,
    seed: int,
    say: Say = ignored,
    part: Part = ignored,
) -> tuple[DataSet, dict[str, FloatRows]]:
    """The set with the plan's copies, and the features [M, F] of each task's windows."""
    spec_for(data, plan.groups).warn_of_lost_bands()
    if plan.copies:
        data = _with_copies(data, plan.copies, seed)

    say(f"features of {len(data.recordings)} recordings")
    return data, features_of_each_hand(data, plan.groups, part)


def fitted(
    data: DataSet,
    features: dict[str, FloatRows],
    plan: TrainingPlan,
    seed: int,
    say: Say = ignored,
) -> tuple[HeldOut, HeadFigures, Artifact]:
    """Held-out votes and figures, and learners of all windows. features: of `with_features`."""
    # The figures come from these votes. The final learners have seen every window, so they have
    # none.
    held_out = cross_validate(data, features, plan, seed=seed, say=say)
    say("final learners on all recordings")
    figures = held_out_figures(data, held_out, seed)
    artifact = final_artifact(data, features, held_out, figures, plan, seed)
    return held_out, figures, artifact


def _with_copies(data: DataSet, copies: int, seed: int) -> DataSet:
    """The set with disturbed copies of its recordings, those of each hand as that hand feels."""
    # only a plan of pooled features has copies
    from holdfast.training.nuisances import with_copies

    for of_hand in data.parts or (data,):
        warn_of(sides_unknown(of_hand, Path(of_hand.name)))
    if not data.parts:
        return with_copies(data, copies, seed)
    parts = [with_copies(of_hand, copies, seed) for of_hand in data.parts]
    return replace(of_several_hands(parts), origins=data.origins)


def final_artifact(
    data: DataSet,
    features: dict[str, FloatRows],
    held_out: HeldOut,
    figures: HeadFigures,
    plan: TrainingPlan,
    seed: int,
) -> Artifact:
    """Learners on all windows, calibrated on the held-out votes, with their origin.

    figures: of the held-out votes, for the model card.
    """
    heads = []
    for task, windows in data.tasks.items():
        every = np.arange(len(windows))
        learner = fit_learner(data, features[task], plan, task, every, seed)

        # Votes on windows that a learner was trained on are too sure of themselves, so held-out
        # ones count.
        label = windows.label
        counts_as = window_counts(plan, label, data.set_of(task))
        calibration = fit_calibration(held_out.shares(task), label, counts_as)
        if plan.even_classes:
            calibration = with_even_classes(calibration, label, counts_as)
        head = Head(TASK_HEADS[task], windows.classes, learner, calibration)
        heads.append(head)

    spec = spec_for(data, plan.groups)
    return Artifact(
        spec=spec,
        preparation=data.preparation,
        decision=plan.decision.to_json(),
        heads=heads,
        rows=np.concatenate(list(features.values())),
        training=_origin(data, plan, spec, seed, figures),
    )


def fingerprint(recording: Recording) -> str:
    """First 12 digits of the SHA-256 of a recording's samples, by which a model knows it."""
    # By content and not by name: a copy under another name is still known as a training recording.
    samples = np.ascontiguousarray(recording.samples)
    return hashlib.sha256(samples.tobytes()).hexdigest()[:12]


def _origin(
    data: DataSet, plan: TrainingPlan, spec: StepSpec, seed: int, figures: HeadFigures
) -> Json:
    """The origin of the model, for its card."""
    # The digest of the set sorts the prints, so that the order of reading does not change it.
    prints = [fingerprint(recording) for recording in data.recordings]

    windows = {task: rows.class_counts() for task, rows in data.tasks.items()}
    not_learned = cannot_tell(data, by_force=spec.contact is not None)
    # A set of one hand alone says all of this already.
    sets = [asdict(origin) for origin in data.origins]
    return {
        "data": data.name,
        **({"sets": sets} if sets else {}),
        "kind": data.kind,
        "redistributable": data.redistributable,
        "caveat": data.caveat,
        "data_sha256": hashlib.sha256("".join(sorted(prints)).encode()).hexdigest(),
        "recordings": prints,
        "groups": len(data.groups()),
        "group_kind": data.group_kind,
        "windows": windows,
        **({CANNOT_TELL: not_learned} if not_learned else {}),
        "main_task": main_task(data),
        "plan": plan.to_json(),
        "seed": seed,
        "held_out": figures.to_json(),
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Versions of what computes the figures."""
    packages = {name: version(name) for name in VERSIONS_OF}
    return {"python": platform.python_version(), **packages}
