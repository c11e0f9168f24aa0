"""Adapted files of small models: a correction of noise, for any base."""

from __future__ import annotations

import numpy as np
from small_model import artifact, card_of, graph_of, spec, with_networks

from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.model_file import votes_in_all
from holdfast.export.changed import adapted
from holdfast.export.exporting import model_card, seal
from holdfast.step.features import feature_count
from holdfast.step.heads import Correction
from holdfast.step.network import InputScale, Layer, Network

RULES = DecisionRules(min_risky_permille=700)


def base_of(eight: bool = True, committee: bool = False) -> bytes:
    made = artifact(spec(), eight)
    made = with_networks(made) if committee else made
    return seal(graph_of(made), model_card(made), made.spec)


def correction(base: bytes, bias: float = 40.0) -> Correction:
    """Of noise, for the features and classes of a base."""
    card = card_of(base)["heads"]["situation"]
    k, n = len(card["classes"]), 2 * feature_count(spec()) + len(card["classes"])
    knee = np.full(n, 0.5, np.float32)
    knee[-k:] = votes_in_all(card)
    weights = np.zeros((n, 2), np.float32)
    weights[:, 1] = np.random.default_rng(5).integers(-400, 400, n)
    layer = Layer(
        weights, np.array([0, bias], np.float32), np.array([1, 0.002], np.float32)
    )
    inputs = InputScale(knee, np.full(n, 511, np.float32), np.zeros(n, np.float32))
    return Correction(Network(inputs, (layer,), votes_in_all=1))


def file_of(base: bytes) -> bytes:
    return adapted(base, correction(base), RULES, {"person": {"hand_overs": 8}})
