"""Scores at the windows of a labelled set: of a model file, and of votes for the eight classes.

"Nothing, light" and "nothing, heavy" are the same signal. So the accuracy over eight balanced
classes is at most 6/8 + 2/8 x 1/2 = 0.875; a higher one shows that the label leaked. "Seven" counts
nothing once, with the votes of both added. Intervals are 95 %, over trials, unless stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    CLASSES,
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    BoolArray,
    untold_of,
)
from holdfast.core.errors import ChannelError
from holdfast.core.reading import Json
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.graph import Outputs, run_recordings
from holdfast.edge_runtime.monitor import Model, require_fit
from holdfast.export.heads import riskier_argmax, situation_votes
from holdfast.export.network import IntArray
from holdfast.training.featurise import pick_rows, rows_wanted
from holdfast.training.figures import HeadFigures, Interval, Share
from holdfast.training.fitting import fingerprint
from holdfast.training.metrics import Labels, report, share_scores, situation_scores
from holdfast.training.plan import TASK_HEADS
from holdfast.training.recording import DataSet

LEVELS = {"eight": CLASSES, "seven": ("nothing", *CLASSES[2:]), "four": SITUATIONS}
CEILING = 0.875
"""The best honest accuracy over eight balanced classes (see above)."""
LEAK_PERCENT = (0.5, 99.5)
LEAK_DRAWS = 4000
"""More than for other intervals, because the ends of a 99 % interval are rare draws."""
LEAK_EXPLAINED = (
    "Nothing held, light or heavy, is the same signal, so over eight balanced classes no honest "
    "answer exceeds 0.875, and within nothing the weight is right half of the time. Judged: the "
    "raw-window forest, trials held out, each window stepped from a fresh state (only its own N "
    "samples; the offset is the trial's unloaded start). A leak is a 99 % interval over trials "
    "that lies wholly above 0.875, or, sharper, above 0.5 for the weight within nothing."
)


@dataclass(frozen=True)
class WindowFigures:
    """Figures of a model at the windows of a set.

    trained_on_recordings: recordings of the set that the model was trained on. unknown_windows:
    where the state would be unknown; each counts as a miss.
    """

    heads: HeadFigures
    model_id: str
    data: str
    kind: str
    trained_on_recordings: int
    unknown_windows: int
    caveat: str
    seed: int

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        fields = asdict(self)
        del fields["heads"]
        return self.heads.to_json() | fields


def evaluate(model: Model, data: DataSet, *, seed: int = 0) -> WindowFigures:
    """Figures of a model at the windows of a set, and how much of the set it was trained on.

    Every recording is streamed from a fresh state, as on the hand; a window at which the state
    would be unknown counts as a miss. Raises ChannelError, UnitError or RateError where the set
    does not fit the model.
    """
    require_model_fits(model, data)
    data = data.with_situations()
    # `unknown` is read with every head: a withheld answer must count as a miss.
    outputs = ["situation", "unknown", *heads_with_task(model, data)]
    return window_figures(model, data, stream(model, data, outputs), seed=seed)


def require_model_fits(model: OpenedModel, data: DataSet) -> None:
    """Raise ChannelError, UnitError or RateError where the set does not fit the model."""
    require_fit(
        model.card,
        n_channels=3 * data.n_sensors,
        unit=data.unit,
        rate_hz=data.rate_hz,
        where=data.name,
    )
    hand = model.card.hand
    if hand is None or data.hand is None:
        return
    if hand.sensor_sides != data.hand.sensor_sides:
        raise ChannelError(
            f"the set is of the hand {data.hand.name}, the model of {hand.name}",
            where=data.name,
            cause="sensors on other sides of the hand",
            next_step="use a model made for this hand, or train one",
        )


def heads_with_task(model: OpenedModel, data: DataSet) -> list[str]:
    """The model's further heads that the set has a task for."""
    heads = [TASK_HEADS[task] for task in data.tasks]
    return [head for head in heads if head in model.card.heads]


def window_figures(
    model: OpenedModel, data: DataSet, answers: dict[str, Outputs], *, seed: int = 0
) -> WindowFigures:
    """The same from computed answers at the windows of a set with the task "situations"."""
    at_windows = answers["situations"]
    withheld = at_windows["unknown"]

    # One past the last situation is "unknown", which misses whatever was there.
    situation = np.where(withheld, len(SITUATIONS), at_windows["situation"])

    risky_score = None
    # A head that the set has no labels for cannot be scored.
    if "p_risky_250ms" in heads_with_task(model, data):
        at_task = answers["predict_250ms"]
        score = at_task["p_risky_250ms"].astype(np.float64)
        # Where the hand would say unknown, the further head predicts nothing.
        risky_score = np.where(at_task["unknown"], 0.0, score)

    # By content: a recording that was copied or renamed is still one that it was trained on.
    seen = set(model.card.raw["training"].get("recordings", ()))
    overlap = sum(fingerprint(recording) in seen for recording in data.recordings)

    return WindowFigures(
        heads=report(
            data,
            situation,
            risky_score,
            untold=untold_of(model.card.raw),
            seed=seed,
        ),
        model_id=model.card.model_id,
        data=data.name,
        kind=data.kind,
        trained_on_recordings=overlap,
        unknown_windows=int(withheld.sum()),
        caveat=data.caveat,
        seed=seed,
    )


def stream(model: Model, data: DataSet, outputs: list[str]) -> dict[str, Outputs]:
    """Task -> output -> [M, ...] at every window of the set."""
    wanted = rows_wanted(data)
    # Streamed whole, as on the hand: a window alone would have no state.
    values = [recording.samples for recording in data.recordings]
    valid = [recording.valid for recording in data.recordings]
    # Only the wanted rows are kept; the graph still steps every sample, for its state.
    computed = run_recordings(model.session, values, valid, outputs, wanted)
    return at_windows(data, computed, wanted)


def at_windows(
    data: DataSet, computed: Sequence[Outputs], rows: list[npt.NDArray[np.int64]]
) -> dict[str, Outputs]:
    """The same, out of what was computed at these rows of each recording."""
    answers: dict[str, Outputs] = {}
    for task in data.tasks:
        picked = {}
        for name in computed[0]:
            of_each = [outputs[name] for outputs in computed]
            picked[name] = pick_rows(data, task, rows, of_each)
        answers[task] = picked

    return answers


@dataclass(frozen=True)
class LevelScores:
    """Accuracy and F1 at one level. present: number of classes that occur."""

    accuracy: float | None
    accuracy_ci: Interval | None
    macro_f1: float | None
    macro_f1_ci: Interval | None
    f1: dict[str, float | None]
    f1_ci: dict[str, Interval | None]
    present: int


@dataclass(frozen=True)
class RiskyCalls:
    """Share of the windows of each situation that are called risky; of risky, the recall."""

    risky: Share
    safe: Share
    grasp: Share
    nothing: Share


@dataclass(frozen=True)
class ClassScores:
    """Scores of votes for the eight classes, at every level."""

    n_windows: int
    n_trials: int
    eight: LevelScores
    seven: LevelScores
    four: LevelScores
    calls: RiskyCalls


@dataclass(frozen=True)
class LeakCheck:
    """Whether votes know the weight where no signal carries it. ci99: 99 % intervals."""

    leak: bool
    eight_class_accuracy: float | None
    eight_class_accuracy_ci99: Interval | None
    ceiling: float
    weight_within_nothing: float | None
    weight_within_nothing_ci99: Interval | None
    balanced: bool
    explanation: str


@dataclass(frozen=True)
class RecallSpread:
    """Recall of each class in every retraining, and its range; None for an absent class."""

    recall: dict[str, list[float] | None]
    spread: dict[str, float | None]
    largest_spread: float
    within_10_percent: bool


def labels_at(label: Labels, level: str) -> IntArray:
    """Labels 0..7 at a level: seven (0 and 1 are one) or four (light and heavy are one).

    >>> labels_at(np.arange(8), "seven").tolist(), labels_at(np.arange(8), "four").tolist()
    ([0, 0, 1, 2, 3, 4, 5, 6], [0, 0, 1, 1, 2, 2, 3, 3])
    """
    if level == "seven":
        # Both kinds of nothing become 0, and all other classes move down by one.
        label = np.maximum(label - 1, 0)
    if level == "four":
        label = label // 2
    return np.asarray(label, dtype=np.int64)


def answers_at(votes: IntArray, level: str) -> IntArray:
    """[M, 8] votes -> [M] answers at a level; votes of merged classes are added."""
    if level == "four":
        return riskier_argmax(situation_votes(votes))
    if level == "seven":
        # Light and heavy nothing first: together they may win over a class that beats each.
        nothing = votes[:, :2].sum(axis=1)
        votes = np.column_stack([nothing, votes[:, 2:]])
    return riskier_argmax(votes)


def scores(data: DataSet, votes: IntArray, *, seed: int = 0) -> ClassScores:
    """Accuracy and macro F1 at every level, and `calls`, of votes [M, 8] on "classes"."""
    label = data.tasks["classes"].label
    groups = data.group_of("classes")

    def at(level: str) -> LevelScores:
        truth = labels_at(label, level)
        answer = answers_at(votes, level)

        # Over trials: windows of one trial overlap and are not independent.
        right = share_scores(truth == answer, groups, seed=seed)
        # The same seed for both, so that they draw the same trials.
        f1 = situation_scores(truth, answer, groups, classes=LEVELS[level], seed=seed)

        return LevelScores(
            accuracy=right.share,
            accuracy_ci=right.share_ci,
            macro_f1=f1.macro_f1,
            macro_f1_ci=f1.macro_f1_ci,
            f1=f1.f1,
            f1_ci=f1.f1_ci,
            present=len(np.unique(truth)),
        )

    # The hand acts on situations, so calls are counted at that level whatever the classes are.
    called = answers_at(votes, "four") == RISKY_SLIP

    return ClassScores(
        n_windows=len(label),
        n_trials=len(np.unique(groups)),
        eight=at("eight"),
        seven=at("seven"),
        four=at("four"),
        calls=calls(data, called, seed=seed),
    )


def calls(data: DataSet, called: BoolArray, *, seed: int = 0) -> RiskyCalls:
    """Shares of the windows that are called risky. called [M]: at each window of "classes"."""
    truth = labels_at(data.tasks["classes"].label, "four")
    groups = data.group_of("classes")

    def share_of(situation: int) -> Share:
        here = truth == situation
        return share_scores(called[here], groups[here], seed=seed)

    return RiskyCalls(
        risky=share_of(RISKY_SLIP),
        safe=share_of(SAFE_SLIP),
        grasp=share_of(GRASP),
        nothing=share_of(NOTHING),
    )


def leak_check(data: DataSet, votes: IntArray, *, seed: int = 0) -> LeakCheck:
    """Whether votes [M, 8] of held-out trials know a weight that no signal carries.

    Classes must be balanced.
    """
    label = data.tasks["classes"].label
    groups = data.group_of("classes")

    def share_right(right: BoolArray, of: npt.ArrayLike) -> Share:
        return share_scores(
            right, of, percent=LEAK_PERCENT, n_draws=LEAK_DRAWS, seed=seed
        )

    # A wide interval and many draws: a leak is a strong claim, and must not be a chance finding.
    whole = share_right(riskier_argmax(votes) == label, groups)
    empty = labels_at(label, "four") == NOTHING
    # Light or heavy alone, so that a model that confuses nothing with grasp cannot hide a leak.
    weight = riskier_argmax(votes[empty, :2])
    weight_right = weight == label[empty]
    within = share_right(weight_right, groups[empty])

    # The ceiling of 0.875 holds for classes of equal size only, so this is reported with it.
    counts = np.bincount(label, minlength=len(CLASSES))

    return LeakCheck(
        leak=_above(whole, CEILING) or _above(within, 0.5),
        eight_class_accuracy=whole.share,
        eight_class_accuracy_ci99=whole.share_ci,
        ceiling=CEILING,
        weight_within_nothing=within.share,
        weight_within_nothing_ci99=within.share_ci,
        balanced=len(np.unique(counts)) == 1,
        explanation=LEAK_EXPLAINED,
    )


def _above(figure: Share, limit: float) -> bool:
    return figure.share_ci is not None and figure.share_ci[0] > limit


def confusion(label: Labels, votes: IntArray) -> npt.NDArray[np.int64]:
    """[8, 8] counts: was (rows), answered (columns)."""
    n = len(CLASSES)
    # One number for each pair of truth and answer, so that one count fills the matrix.
    pair = n * np.asarray(label) + answers_at(votes, "eight")
    cells = np.bincount(pair, minlength=n * n)
    return cells.reshape(n, n)


def spread_of(matrices: list[npt.NDArray[np.int64]]) -> RecallSpread:
    """Spread of the recall over retrainings. matrices: [8, 8] counts of each."""
    counts = np.array(matrices)
    windows = counts.sum(axis=2)
    # On the diagonal the answer is the truth.
    right = np.diagonal(counts, axis1=1, axis2=2)
    recalls = right / np.maximum(windows, 1)

    recall: dict[str, list[float] | None] = dict.fromkeys(CLASSES)
    spread: dict[str, float | None] = dict.fromkeys(CLASSES)
    for k, name in enumerate(CLASSES):
        # The windows are the same in every retraining, so the first one tells which classes occur.
        if windows[0, k] > 0:
            recall[name] = recalls[:, k].tolist()
            spread[name] = float(np.ptp(recalls[:, k]))

    largest = max(span for span in spread.values() if span is not None)
    # A spread of exactly 10 % may come out a rounding error above it.
    within = largest <= 0.10 + 1e-9
    return RecallSpread(recall, spread, largest, within)
