"""Small models by the exporter itself, and model files that were altered and sealed again by its
rules alone."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort

from holdfast.core.contract import CLASSES, SITUATIONS, Unit
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.graph import open_session
from holdfast.edge_runtime.model_file import CARD_KEY, SEAL_KEY
from holdfast.edge_runtime.preparation import Preparation
from holdfast.export.exporting import model_card, seal, whole_graph
from holdfast.step.artifact import Artifact
from holdfast.step.features import feature_count, feature_graph
from holdfast.step.heads import Head, VoteCalibration
from holdfast.step.learner import Learner, votes_of_trees
from holdfast.step.spec import BandsLeftOut, StepSpec
from holdfast.training.network_fit import fit_network
from holdfast.training.plan import ForestPlan, NetworkPlan

EXTRA_HEAD = "p_risky_250ms"


def spec(
    groups: Sequence[str] = ("now",),
    unit: Unit = "N",
    n_sensors: int = 2,
    rate_hz: float = 50.0,
) -> StepSpec:
    """What a small model is built for."""
    return StepSpec(
        n_sensors=n_sensors, rate_hz=rate_hz, unit=unit, groups=tuple(groups)
    )


SMALL = ForestPlan(kind="random", n_estimators=2, max_depth=3)
SMALL_NETWORK = NetworkPlan(hidden=(3,), members=1, epochs=1, batch=8)


def head(
    spec: StepSpec, name: str, classes: tuple[str, ...], plan: ForestPlan = SMALL
) -> Head:
    """A head, fitted on noise."""
    rng = np.random.default_rng(0)
    forest = plan.build(0, n_jobs=1)
    forest.fit(
        rng.normal(size=(40, feature_count(spec))).astype(np.float32),
        np.arange(40) % len(classes),
    )
    return Head(
        name,
        classes,
        Learner(forest),
        VoteCalibration(np.eye(len(classes)), np.zeros(len(classes))),
    )


def artifact(
    spec: StepSpec, eight: bool = True, extra: bool = True, plan: ForestPlan = SMALL
) -> Artifact:
    """What training would hand to the exporter."""
    heads = [head(spec, "situation", CLASSES if eight else SITUATIONS, plan)]
    heads += [head(spec, EXTRA_HEAD, ("no", "yes"), plan)] if extra else []
    rows = np.zeros((1, feature_count(spec)), dtype=np.float32)
    return Artifact(spec, Preparation(), DecisionRules().to_json(), heads, rows, {})


def with_networks(made: Artifact) -> Artifact:
    """The same with a committee in the first head, which has label weights, and networks in the
    others."""
    heads = []
    for number, one in enumerate(made.heads):
        forest = one.learner.forest
        assert forest is not None
        k = len(one.classes)
        rows = np.random.default_rng(1).normal(size=(40, one.learner.n_features))
        votes = votes_of_trees(len(forest.estimators_))
        label = np.arange(40) % k
        network = fit_network(
            SMALL_NETWORK, rows.astype(np.float32), label, k, 0, votes
        )
        heads.append(
            replace(one, learner=Learner(network=network))
            if number
            else replace(
                one,
                learner=Learner(forest, network),
                label_weights=(1, 0.5, 0.5, 1),
            )
        )
    return replace(made, heads=heads)


def for_the_hand() -> Artifact:
    """A committee for six sensors at 150 Hz, as a hand has them; its samples come with a bias."""
    made = with_networks(
        artifact(spec(("now", "differences"), n_sensors=6, rate_hz=150.0))
    )
    return replace(made, preparation=Preparation(5, "mean", True, 0.3, "sensor"))


def graph_of(made: Artifact) -> onnx.ModelProto:
    """Its whole step, unsealed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandsLeftOut)
        return whole_graph(made.spec, made.heads)


@cache
def session_of(spec: StepSpec) -> ort.InferenceSession:
    """The step of this without a model: features, and what is known of the sample."""
    return open_session(feature_graph(spec).SerializeToString())


@cache
def sealed_bytes() -> bytes:
    """A sealed model of two sensors at 50 Hz: eight classes and a further head."""
    made = artifact(spec())
    return seal(graph_of(made), model_card(made), made.spec)


def card_of(data: bytes) -> dict[str, Any]:
    """The card inside a model file."""
    return dict(json.loads(metadata_of(data)[CARD_KEY]))


class Trap:
    """What a pickle could do when it is read."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return (exec, ("raise SystemExit('the pickle was read')",))


def metadata_of(data: bytes) -> dict[str, str]:
    return {
        entry.key: entry.value for entry in onnx.load_from_string(data).metadata_props
    }


def with_metadata(data: bytes, **changed: str | None) -> bytes:
    """The file with other metadata (None: without), and a seal that holds, made from the rule
    alone."""
    model = onnx.load_from_string(data)
    entries = {**metadata_of(data), **changed, SEAL_KEY: "0" * 64}
    del model.metadata_props[:]
    for key, value in entries.items():
        if value is not None:
            model.metadata_props.add(key=key, value=value)
    zeroed = model.SerializeToString()
    assert zeroed.count(b"0" * 64) == 1
    return zeroed.replace(b"0" * 64, hashlib.sha256(zeroed).hexdigest().encode())
