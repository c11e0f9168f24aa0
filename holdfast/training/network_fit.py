"""A network trained by scikit-learn and turned into whole numbers (holdfast/step/network.py).

Several networks that differ in their seed alone are evaluated together, and the mean of their
logits counts: their first layers are one matrix, later ones a matrix of blocks.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier

from holdfast.core.contract import FloatArray, IntArray
from holdfast.step.heads import FloatRows
from holdfast.step.network import (
    EXACT_FLOAT32,
    HIDDEN_MOST,
    INPUT_MOST,
    LOGIT_STEPS,
    VOTES,
    WEIGHT_MOST,
    InputScale,
    Layer,
    Network,
    hidden_values,
)
from holdfast.training.plan import NetworkPlan, class_weights

KNEE_FLOOR = 1e-3
"""Smallest knee, in the features' unit: a feature that hardly moves is not blown up."""
UNUSED_PERCENT = 0.1
"""A hidden unit's largest values that are cut off, % of the training rows."""
INTERRUPTED = "Training interrupted by user"
"""How scikit-learn's warning begins; a test holds it."""
NO_VOTES_NATS = -20.0
"""Logit of a class that training never saw."""


@dataclass(frozen=True)
class _Squash:
    """knee [F], mean [F] and deviation [F] of what it gives."""

    knee: FloatRows
    mean: FloatArray
    deviation: FloatArray

    @staticmethod
    def of(rows: FloatRows, knee: float) -> _Squash:
        """Fitted on training rows [N, F]."""
        spread = rows.std(axis=0, dtype=np.float64)

        # A knee per feature, since features of different size would not all be squashed alike.
        knees = (knee * spread + KNEE_FLOOR).astype(np.float32)
        squashed = rows / (np.abs(rows) + knees)

        # In float64: a float32 sum over many rows loses the last digits.
        mean = squashed.mean(axis=0, dtype=np.float64)
        deviation = squashed.std(axis=0, dtype=np.float64)
        # A feature that never moves would divide by zero.
        return _Squash(knees, mean, deviation + 1e-6)

    def steps(self) -> FloatArray:
        """[F] steps of a quantised input a standard deviation."""
        # |x / (knee + |x|)| < 1, so 1 + |mean| is the farthest that a value gets from the mean.
        farthest = 1.0 + np.abs(self.mean)
        # A hair less, so that rounding in float32 does not reach one step too many.
        return INPUT_MOST * self.deviation / farthest * (1.0 - 1e-6)

    def standardised(self, rows: FloatRows) -> FloatRows:
        """[N, F] as the network sees it."""
        squashed = rows / (np.abs(rows) + self.knee)
        return ((squashed - self.mean) / self.deviation).astype(np.float32)


@dataclass(frozen=True)
class Members:
    """Networks of one plan that differ in their seed alone, in real numbers. present: classes."""

    squash: _Squash
    networks: tuple[MLPClassifier, ...]
    present: IntArray


def fit_members(
    plan: NetworkPlan,
    rows: FloatRows,
    label: IntArray,
    seed: int,
    counts_as: FloatArray | None = None,
) -> Members:
    """Train on rows [N, F] with labels [N]; the seed makes it the same every time.

    counts_as [N]: how many rows each counts as, None for one.
    """
    squash = _Squash.of(rows, plan.knee)
    standardised = squash.standardised(rows)
    networks = []
    for number in range(plan.members):
        member = _fit_member(plan, standardised, label, counts_as, seed + number)
        networks.append(member)
    return Members(squash, tuple(networks), np.unique(label))


def fit_network(
    plan: NetworkPlan,
    rows: FloatRows,
    label: IntArray,
    n_classes: int,
    seed: int,
    votes_in_all: int = VOTES,
    counts_as: FloatArray | None = None,
) -> Network:
    """Train as `fit_members` does, and make whole numbers of it."""
    members = fit_members(plan, rows, label, seed, counts_as)
    return in_whole_numbers(members, rows, n_classes, votes_in_all)


def _fit_member(
    plan: NetworkPlan,
    rows: FloatRows,
    label: IntArray,
    counts_as: FloatArray | None,
    seed: int,
) -> MLPClassifier:
    """One network by scikit-learn, on standardised rows [N, F]; the seed starts its weights."""
    member = MLPClassifier(
        plan.hidden,
        alpha=plan.alpha,
        max_iter=plan.epochs,
        batch_size=min(plan.batch, len(rows)),
        learning_rate_init=plan.rate,
        random_state=seed,
    )

    # balance 1: each class weighs the same in all; 0: each window does.
    weight = (class_weights(label, counts_as) ** plan.balance)[label]
    if counts_as is not None:
        weight = weight * counts_as

    with interruptible():
        # It stops after the plan's epochs on purpose.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return member.fit(rows, label, sample_weight=weight)


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt where scikit-learn ends the fit of a network with a warning of it.

    What it has then is no network to go on with. Filters of warnings end with the block.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("error", INTERRUPTED, UserWarning)
        try:
            yield
        except UserWarning as warning:
            if not str(warning).startswith(INTERRUPTED):
                raise
            raise KeyboardInterrupt from None


def in_whole_numbers(
    members: Members, rows: FloatRows, n_classes: int, votes_in_all: int = VOTES
) -> Network:
    """One network of whole numbers. rows [N, F]: of training, for the range of hidden values."""
    squash = members.squash
    networks = members.networks
    # Standardising and quantising are one line: gain * squashed + offset.
    steps = squash.steps()
    gain = steps / squash.deviation
    offset = -steps * squash.mean / squash.deviation
    inputs = InputScale(squash.knee, gain.astype(np.float32), offset.astype(np.float32))

    # The values of the training rows go along, since each layer is scaled by what enters it.
    values = inputs.quantised(rows)
    most = INPUT_MOST
    unit = 1.0 / steps
    layers = []
    n_hidden = len(networks[0].coefs_) - 1
    for number in range(n_hidden):
        layer, unit = _hidden(networks, number, values, most, unit)
        values = hidden_values(layer, values)
        layers.append(layer)
        most = HIDDEN_MOST

    layers.append(_logits(networks, unit, most, members.present, n_classes))
    return Network(inputs, tuple(layers), votes_in_all)


def _hidden(
    members: tuple[MLPClassifier, ...],
    number: int,
    values: FloatRows,
    most: int,
    unit: FloatArray,
) -> tuple[Layer, FloatArray]:
    """A hidden layer of all members, and the real value of one step of each of its units.

    values [N, I]: what enters it. unit [I]: the real value of one step of that.
    """
    coefficients = [member.coefs_[number] for member in members]
    # All members see the same inputs; after that each sees its own units only.
    joined = np.hstack(coefficients) if number == 0 else block_diag(*coefficients)
    bias = np.concatenate([member.intercepts_[number] for member in members])
    # In real numbers a step of input i counts unit[i] times its weight.
    by_step = joined * unit[:, None]
    weights, whole_bias, fineness = whole_weights(by_step, bias, most)

    real = np.maximum((values @ weights + whole_bias) / fineness, 0.0)
    # A unit's few largest values are cut off, so that its steps are finer for all the others.
    top = np.percentile(real, 100.0 - UNUSED_PERCENT, axis=0)
    # A unit that is never active has no range; any will do.
    span = np.where(top > 0.0, top, 1.0)

    step = span / HIDDEN_MOST
    scale = (1.0 / (fineness * step)).astype(np.float32)
    return Layer(weights, whole_bias, scale), step


def _logits(
    members: tuple[MLPClassifier, ...],
    unit: FloatArray,
    most: int,
    present: IntArray,
    n_classes: int,
) -> Layer:
    """The last layer: the mean of the members' logits, for all classes."""
    stacked = np.vstack([member.coefs_[-1] for member in members])
    # Stacked weights add up the members' logits; divided by their number they are the mean.
    coefficients = stacked / len(members)
    intercepts = np.mean([member.intercepts_[-1] for member in members], axis=0)

    # A class that training never saw keeps a column of zeros and a bias that gives it no vote.
    wide = np.zeros((len(coefficients), n_classes))
    bias = np.full(n_classes, NO_VOTES_NATS)
    # Of two classes only the second has a logit.
    columns = present[-coefficients.shape[1] :]
    wide[:, columns] = coefficients

    bias[present] = 0.0
    bias[columns] = intercepts

    weights, whole_bias, fineness = whole_weights(wide * unit[:, None], bias, most)

    # Logits enter a table of exponentials in steps, so the last layer is scaled to those.
    scale = (LOGIT_STEPS / fineness).astype(np.float32)
    return Layer(weights, whole_bias, scale)


def whole_weights(
    weights: FloatArray, bias: FloatArray, most: int
) -> tuple[FloatRows, FloatRows, FloatArray]:
    """Whole weights and bias, as fine as exact sums allow, and their steps per real 1, [O]."""
    # Rounding may add half a step to each weight.
    room = EXACT_FLOAT32 - 1 - most * len(weights)
    # The largest sum that a unit can reach stays below what float32 counts exactly.
    sizes = np.abs(weights)
    size = most * sizes.sum(axis=0) + np.abs(bias) + 1e-9
    largest = sizes.max(axis=0) + 1e-9

    by_sum = room / size
    by_weight = (WEIGHT_MOST - 1) / largest
    fineness = np.minimum(by_sum, by_weight)

    whole = np.round(weights * fineness).astype(np.float32)
    whole_bias = np.round(bias * fineness).astype(np.float32)
    return whole, whole_bias, fineness
