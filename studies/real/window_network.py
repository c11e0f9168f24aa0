"""A small convolutional network beside the committee, on people: `make study NAME=window-network`.

It sees the last 0.5 s of samples relative to the last one, each sensor in units of its own level,
and no feature. Trained in numpy; whole numbers when it answers, as the networks of the committee
(holdfast/export/network.py). Nested: the number of passes is chosen on a third of the training
people of each fold, by average precision, and nothing else is chosen. window-network.json.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from sklearn.metrics import average_precision_score

from holdfast.cli.options import add_job_options, chosen_workers
from holdfast.core.contract import NORMAL_AXIS, FloatArray, IntArray
from holdfast.core.reading import Json
from holdfast.core.trial_layout import NORMAL_FLOOR
from holdfast.core.writing import require_writable
from holdfast.export.heads import FloatRows, riskier_argmax
from holdfast.export.network import (
    HIDDEN_MOST,
    INPUT_MOST,
    LOGIT_STEPS,
    VOTES,
    Layer,
    hidden_values,
)
from holdfast.export.spec import HISTORY_S, USUAL_SENSORS
from holdfast.training.crossval import splits_of
from holdfast.training.metrics import report
from holdfast.training.network_fit import whole_weights
from holdfast.training.progress import stages
from holdfast.training.recording import DataSet, grouped_folds
from studies.real.learners import learner_votes
from studies.real.methods import PLACED, Method, done
from studies.row_names import SPREAD_OWN_18
from tools.harness import write_figures

KERNELS = ((5, 2, 32), (3, 1, 32), (3, 2, 48))
"""Width in samples, step in samples and units of each convolution."""
DENSE = 64
"""Units of the layer between the convolutions and the logits."""
BATCH, RATE, DECAY, DROPPED = 256, 2e-3, 2e-2, 0.25
"""Windows of a step; Adam's rate; decay of the weights over the rate; share of dropped values."""
AVERAGED = 0.998
"""The weights that answer are a running mean over the steps: how much of it each step keeps."""
PASSES = {"situations": (4, 8, 12), "predict_250ms": (4, 8, 16)}
"""Passes over the windows to choose from."""
INNER_FOLDS = 3
BALANCE = {"situations": 0.0, "predict_250ms": 0.5}
"""1 weighs all classes the same, 0 all windows: as in the networks of the committee."""
CUT_PERCENT = 0.1
"""A unit's largest values that whole numbers cut off, % of the training windows."""
ALONE = "window network"
REAL = "window network before it is made of whole numbers"
BESIDE = "committee and window network"
INSTEAD = "forest and window network"
Weights = list[FloatRows]


@dataclass(frozen=True)
class Inputs:
    """relative [N, L, C]: samples less the last, over own level; static [N, C + S]: last, levels.

    Both squashed to x / (knee + |x|), and rounded to whole numbers over INPUT_MOST.
    """

    relative: FloatRows
    static: FloatRows

    def take(self, rows: IntArray) -> Inputs:
        """Some windows."""
        return Inputs(self.relative[rows], self.static[rows])


def inputs_of(data: DataSet, task: str) -> Inputs:
    """The windows of a task, squashed. The knees are fixed: no person is seen by them."""
    rows = data.tasks[task]
    length = int(HISTORY_S * data.rate_hz) + 1
    floor = NORMAL_FLOOR[data.unit] / USUAL_SENSORS
    windows = np.empty((len(rows), length, 3 * data.n_sensors), np.float32)
    for trial in np.unique(rows.trial):
        here = np.flatnonzero(rows.trial == trial)
        places = rows.row[here][:, None] + np.arange(1 - length, 1)
        windows[here] = data.recordings[trial].samples[places]
    levels = np.maximum(np.abs(windows[:, :, NORMAL_AXIS::3]).mean(axis=1), floor)
    last = windows[:, -1]
    relative = (windows - last[:, None]) / np.repeat(levels, 3, axis=1)[:, None]
    static = np.concatenate([last, levels], axis=1)
    return Inputs(_squashed(relative, 0.3), _squashed(static, 1.0))


def _squashed(values: FloatRows, knee: float) -> FloatRows:
    """Whole numbers within +-INPUT_MOST, over INPUT_MOST."""
    squashed = values / (np.abs(values) + np.float32(knee))
    whole = np.round(squashed * np.float32(INPUT_MOST))
    return np.asarray(whole / np.float32(INPUT_MOST), np.float32)


def unrolled(values: FloatRows, width: int, step: int) -> FloatRows:
    """[N, T, C] -> [N, T', width x C]: what each place of a convolution sees."""
    views = np.lib.stride_tricks.sliding_window_view(values, width, axis=1)[:, ::step]
    return np.ascontiguousarray(views.transpose(0, 1, 3, 2)).reshape(
        len(values), views.shape[1], -1
    )


def rolled_back(
    change: FloatRows, shape: tuple[int, ...], width: int, step: int
) -> FloatRows:
    """The transpose of `unrolled`: gradients [N, T', width x C] summed into [N, T, C]."""
    found = np.zeros(shape, np.float32)
    n_places = change.shape[1]
    parts = change.reshape(len(change), n_places, width, shape[2])
    for k in range(width):
        found[:, k : k + step * n_places : step] += parts[:, :, k]
    return found


class WindowNetwork:
    """Three convolutions, then two dense layers; weights: W and b of each, in this order."""

    def __init__(
        self, n_channels: int, n_static: int, length: int, n_classes: int, seed: int
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.multiplications = 0
        self.weights: Weights = []
        units = n_channels
        for width, step, n_out in KERNELS:
            length = (length - width) // step + 1
            self._add(width * units, n_out, length)
            units = n_out
        self._add(length * units + n_static, DENSE, 1)
        self._add(DENSE, n_classes, 1)

    def _add(self, n_in: int, n_out: int, places: int) -> None:
        size = np.sqrt(2.0 / n_in)
        weights = self.rng.normal(0.0, size, (n_in, n_out)).astype(np.float32)
        self.weights += [weights, np.zeros(n_out, np.float32)]
        self.multiplications += places * n_in * n_out

    @property
    def n_weights(self) -> int:
        """Weights and biases."""
        return sum(one.size for one in self.weights)

    def step(self, inputs: Inputs, label: IntArray, weight: FloatRows) -> Weights:
        """Gradients of the weighted mean cross-entropy, with dropped values."""
        weights = self.weights
        values = inputs.relative
        shapes, seen, active = [], [], []
        for k, (width, step, _) in enumerate(KERNELS):
            shapes.append(values.shape)
            places = unrolled(values, width, step)
            values = np.maximum(places @ weights[2 * k] + weights[2 * k + 1], 0.0)
            seen.append(places)
            active.append(values > 0.0)
        n = len(label)
        shape = values.shape
        flat = np.concatenate([values.reshape(n, -1), inputs.static], axis=1)
        kept = (self.rng.random(flat.shape, np.float32) > DROPPED) / np.float32(
            1 - DROPPED
        )
        flat = flat * kept.astype(np.float32)
        dense = np.maximum(flat @ weights[-4] + weights[-3], 0.0)
        logits = dense @ weights[-2] + weights[-1]

        change = _softmax(logits)
        change[np.arange(n), label] -= 1.0
        change *= (weight / weight.sum())[:, None]
        found = [dense.T @ change, change.sum(axis=0)]
        change = (change @ weights[-2].T) * (dense > 0.0)
        found = [flat.T @ change, change.sum(axis=0), *found]
        change = (change @ weights[-4].T) * kept
        change = change[:, : shape[1] * shape[2]].reshape(shape).astype(np.float32)
        for k in reversed(range(len(KERNELS))):
            change = change * active[k]
            n_in, n_out = weights[2 * k].shape
            of_weights = seen[k].reshape(-1, n_in).T @ change.reshape(-1, n_out)
            found = [of_weights, change.sum(axis=(0, 1)), *found]
            if k:
                width, step, _ = KERNELS[k]
                change = rolled_back(change @ weights[2 * k].T, shapes[k], width, step)
        return found


def _softmax(logits: FloatRows) -> FloatRows:
    raised = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(raised / raised.sum(axis=1, keepdims=True), np.float32)


def shares(weights: Weights, inputs: Inputs) -> FloatRows:
    """[N, K] in real numbers."""
    parts = []
    for start in range(0, len(inputs.static), 4096):
        some = inputs.take(np.arange(start, min(start + 4096, len(inputs.static))))
        values = some.relative
        for k, (width, step, _) in enumerate(KERNELS):
            places = unrolled(values, width, step)
            values = np.maximum(places @ weights[2 * k] + weights[2 * k + 1], 0.0)
        flat = np.concatenate([values.reshape(len(values), -1), some.static], axis=1)
        dense = np.maximum(flat @ weights[-4] + weights[-3], 0.0)
        parts.append(_softmax(dense @ weights[-2] + weights[-1]))
    return np.concatenate(parts)


def fitted(
    inputs: Inputs,
    label: IntArray,
    n_classes: int,
    balance: float,
    passes: int,
    seed: int,
    after: Callable[[int, Weights], None] = lambda number, weights: None,
) -> tuple[Weights, WindowNetwork]:
    """Weights by Adam after so many passes; after: receives the weights after each."""
    length, n_channels = inputs.relative.shape[1:]
    network = WindowNetwork(n_channels, inputs.static.shape[1], length, n_classes, seed)
    counts = np.bincount(label, minlength=n_classes)
    even = (len(label) / np.maximum(counts, 1) / n_classes) ** balance
    mean = [np.zeros_like(one) for one in network.weights]
    square = [np.zeros_like(one) for one in network.weights]
    averaged = [one.copy() for one in network.weights]
    number = 0
    for one_pass in range(1, passes + 1):
        order = network.rng.permutation(len(label))
        for start in range(0, len(order) - BATCH // 2, BATCH):
            rows = order[start : start + BATCH]
            weight = even[label[rows]].astype(np.float32)
            number += 1
            # a short start, so that the first steps do not leap
            rate = RATE * min(1.0, number / 200)
            kept = min(AVERAGED, number / (number + 10))
            for k, slope in enumerate(
                network.step(inputs.take(rows), label[rows], weight)
            ):
                mean[k] += np.float32(0.1) * (slope - mean[k])
                square[k] += np.float32(0.001) * (slope**2 - square[k])
                size = np.sqrt(square[k] / (1 - 0.999**number)) + 1e-8
                weights = network.weights[k]
                weights -= rate * (mean[k] / (1 - 0.9**number) / size)
                if weights.ndim == 2:
                    weights *= 1 - rate * DECAY
                averaged[k] += np.float32(1 - kept) * (weights - averaged[k])
        after(one_pass, averaged)
    return averaged, network


def whole_votes(
    weights: Weights, seen: Inputs, asked: Inputs, votes_in_all: int
) -> IntArray:
    """[N, K] votes of the network in whole numbers. seen: training windows, for hidden ranges."""
    unit = np.full(KERNELS[0][0] * seen.relative.shape[2], 1.0 / INPUT_MOST)
    most = INPUT_MOST
    of_seen = seen.relative * np.float32(INPUT_MOST)
    of_asked = asked.relative * np.float32(INPUT_MOST)
    for k, (width, step, _) in enumerate(KERNELS):
        layer, span = _whole_layer(
            weights[2 * k],
            weights[2 * k + 1],
            unit,
            most,
            unrolled(of_seen, width, step),
        )
        of_seen = _hidden(layer, unrolled(of_seen, width, step))
        of_asked = _hidden(layer, unrolled(of_asked, width, step))
        most = HIDDEN_MOST
        following = KERNELS[k + 1][0] if k + 1 < len(KERNELS) else of_seen.shape[1]
        unit = np.tile(span, following)
    static = seen.static.shape[1]
    unit = np.concatenate([unit, np.full(static, 1.0 / INPUT_MOST)])
    of_seen, of_asked = [
        np.concatenate(
            [values.reshape(len(values), -1), one.static * np.float32(INPUT_MOST)],
            axis=1,
        )
        for values, one in ((of_seen, seen), (of_asked, asked))
    ]
    # the static inputs reach INPUT_MOST, so the sums of this layer leave room for that
    layer, unit = _whole_layer(weights[-4], weights[-3], unit, INPUT_MOST, of_seen)
    of_asked = _hidden(layer, of_asked)
    whole, bias, fineness = whole_weights(
        weights[-2] * unit[:, None], weights[-1].astype(np.float64), HIDDEN_MOST
    )
    scale = (LOGIT_STEPS / fineness).astype(np.float32)
    steps = np.round((of_asked @ whole + bias) * scale)
    logits = np.asarray(steps / LOGIT_STEPS, np.float32)
    return np.asarray(np.floor(_softmax(logits) * votes_in_all), np.int64)


def _whole_layer(
    weights: FloatRows, bias: FloatRows, unit: FloatArray, most: int, seen: FloatRows
) -> tuple[Layer, FloatArray]:
    """A layer of whole numbers, and the real value of one step of each of its units."""
    whole, whole_bias, fineness = whole_weights(
        weights * unit[:, None], bias.astype(np.float64), most
    )
    real = np.maximum(
        (seen.reshape(-1, len(unit)) @ whole + whole_bias) / fineness, 0.0
    )
    top = np.percentile(real[::7], 100.0 - CUT_PERCENT, axis=0)
    step = np.where(top > 0.0, top, 1.0) / HIDDEN_MOST
    return Layer(whole, whole_bias, (1.0 / (fineness * step)).astype(np.float32)), step


def _hidden(layer: Layer, places: FloatRows) -> FloatRows:
    return hidden_values(layer, places.reshape(-1, places.shape[-1])).reshape(
        *places.shape[:-1], -1
    )


@dataclass(frozen=True)
class FoldShares:
    """Of one fold: task -> row -> [N, K] shares of the held-out windows, and how it was fitted."""

    rows: dict[str, IntArray]
    shares: dict[str, dict[str, FloatArray]]
    fits: dict[str, Json]


def study_fold(method: Method, number: int, seed: int) -> FoldShares:
    """Train on the people of one fold, answer the windows of the others."""
    data = method.data()
    split = splits_of(data, method.plan, seed)[number]
    by_task: dict[str, dict[str, FloatArray]] = {}
    fits = {}
    for task, (train, test) in split.items():
        given = method.features()[task]
        votes, _ = learner_votes(data, given, method.plan, task, train, test, seed)
        found = {name: _share(one) for name, one in votes.items()}

        inputs = inputs_of(data, task)
        n_classes = len(data.tasks[task].classes)
        label = data.tasks[task].label[train]
        passes = chosen_passes(data, inputs, task, train, seed)
        seen, asked = inputs.take(train), inputs.take(test)
        started = time.process_time()
        weights, network = fitted(seen, label, n_classes, BALANCE[task], passes, seed)
        fits[task] = {
            "passes": passes,
            "cpu_s": round(time.process_time() - started, 1),
            "weights": network.n_weights,
            "multiplications": network.multiplications,
        }
        found[REAL] = shares(weights, asked).astype(np.float64)
        found[ALONE] = _share(whole_votes(weights, seen, asked, VOTES))
        # each learner has as many votes as another
        found[BESIDE] = (2 * found["committee"] + found[ALONE]) / 3
        found[INSTEAD] = (found["forest"] + found[ALONE]) / 2
        by_task[task] = found
    return FoldShares({task: rows[1] for task, rows in split.items()}, by_task, fits)


def _share(votes: IntArray) -> FloatArray:
    found: FloatArray = votes / votes.sum(axis=1, keepdims=True)
    return found


def chosen_passes(
    data: DataSet, inputs: Inputs, task: str, train: IntArray, seed: int
) -> int:
    """Passes of the best mean average precision on a third of the training people."""
    folds = grouped_folds(data.group_of(task)[train], INNER_FOLDS, seed=seed)
    others, left_out = next(iter(folds))
    n_classes = len(data.tasks[task].classes)
    truth = data.tasks[task].label[train[left_out]]
    asked = inputs.take(train[left_out])
    scores: dict[int, float] = {}

    def score(number: int, weights: Weights) -> None:
        if number in PASSES[task]:
            found = shares(weights, asked)
            each = [
                average_precision_score(truth == k, found[:, k])
                for k in range(n_classes)
            ]
            scores[number] = float(np.mean(each))

    seen = inputs.take(train[others])
    label = data.tasks[task].label[train[others]]
    fitted(seen, label, n_classes, BALANCE[task], PASSES[task][-1], seed, score)
    return max(scores, key=lambda number: scores[number])


def figures_of(data: DataSet, folds: list[FoldShares], seed: int) -> Json:
    """Every row's figures with intervals over people, and the fits of all folds."""
    rows: Json = {}
    for name in folds[0].shares["situations"]:
        whole = {}
        for task, windows in data.tasks.items():
            whole[task] = np.zeros((len(windows), len(windows.classes)))
            for fold in folds:
                whole[task][fold.rows[task]] = fold.shares[task][name]
        # of equal shares the riskier counts, as in a file
        situation = riskier_argmax(
            np.round(whole["situations"] * 2**20).astype(np.int64)
        )
        soon = whole["predict_250ms"][:, 1]
        rows[name] = report(data, situation, soon, seed=seed).to_json()
    return {"kind": data.kind, "rows": rows, "fits": [fold.fits for fold in folds]}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_job_options(parser, 2)


def run(args: argparse.Namespace) -> int:
    """Study the spread taxels at their own level; write window-network.json."""
    require_writable(args.out)
    method = PLACED[SPREAD_OWN_18]
    parts = {
        f"fold {number + 1} of {method.plan.folds}": partial(
            study_fold, method, number, args.seed
        )
        for number in range(method.plan.folds)
    }
    with stages(len(parts)) as say:
        folds = list(done(parts, chosen_workers(args), say))
    figures = figures_of(method.data(), folds, args.seed)
    print(write_figures(args.out / "window-network.json", figures))
    return 0
