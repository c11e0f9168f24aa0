"""A model file again: for another hand, with the contact rule, or with other rules of the decision.

What stands behind the features is copied node by node, constants and all; the step in front of them
is built anew, and force decides "nothing". So a file needs no artifact folder to be exported again.
Rules of the decision stand in the card alone, so the graph stays as it is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from holdfast.core.contract import Json, channel_names
from holdfast.core.errors import UsageError, VerificationFailed
from holdfast.core.hand_card import HandCard
from holdfast.core.schema import json_of
from holdfast.core.writing import require_writable, write_whole
from holdfast.edge_runtime.decision import LIMITS, DecisionRules
from holdfast.edge_runtime.graph import Outputs, open_session, run_recording
from holdfast.edge_runtime.model import golden_input
from holdfast.edge_runtime.model_file import (
    CARD_KEY,
    CARD_SUFFIX,
    CONTACT_KEY,
    read_sealed,
    votes_in_all,
)
from holdfast.export.adapted_file import is_adapted
from holdfast.export.builder import GraphBuilder
from holdfast.export.exporting import (
    readable_card,
    seal,
    sealed_with,
    spec_for_hand,
)
from holdfast.export.features import add_step
from holdfast.export.heads import MAIN_HEAD, ByForce, FloatRows, learned_name
from holdfast.export.spec import StepSpec
from holdfast.export.structure import edge_rows
from holdfast.export.verify import CHUNK, compare_streams, cut_learners, run_rows

FEATURES = "features"
KEPT = "kept_"
"""Begins the names of what is copied: the new step numbers its own tensors."""
RANDOM_ROWS = 5_000
"""Rows of noise at the size of the golden input's features, on which the votes are compared."""


def export_again(
    path: Path,
    out: Path,
    hand: HandCard | None = None,
    rules: Mapping[str, int] | None = None,
) -> int:
    """Write a file again, with its card beside it; returns its size in bytes.

    hand: for which the new file is. rules: of the decision, by name. Without either an older file
    gets the contact rule. Raises UsageError for a file that needs it not or a rule that cannot be,
    VerificationFailed where the learner differs.
    """
    data = read_sealed(path)
    require_writable(out.parent)
    card: Json = {}
    if hand is not None:
        card, data = for_hand(data, hand, path)
    if rules:
        card, data = with_rules(data, rules)
    if not card:
        card, data = with_contact_rule(data, path)
    write_whole(out, data)
    write_whole(out.with_suffix(CARD_SUFFIX), readable_card(card, out.name, data))
    return len(data)


def with_contact_rule(old: bytes, where: str | Path = "") -> tuple[Json, bytes]:
    """Card and bytes of the file again, verified. Raises UsageError or VerificationFailed."""
    model = onnx.load_from_string(old)
    card = json_of({one.key: one.value for one in model.metadata_props}[CARD_KEY])
    spec = StepSpec.from_json(card["spec"])
    _require_older(old, card, spec, where)

    heads = [_by_force(name, head) for name, head in card["heads"].items()]
    again = _graph(model, spec, heads)
    _verify(model, again, spec, heads)

    rule = spec.contact
    assert rule is not None
    # where a fresh export has them
    described: Json = {}
    for key, value in card.items():
        described[key] = spec.to_json() if key == "spec" else value
        if key == "normal_floor":
            described[CONTACT_KEY] = rule.to_json()
    return described, seal(again, described, spec)


def for_hand(old: bytes, hand: HandCard, where: str | Path = "") -> tuple[Json, bytes]:
    """Card and bytes of the file for another hand, verified: the same learner, another step.

    Raises UsageError for a file whose features are not pooled, or that is adapted to a person.
    """
    model = onnx.load_from_string(old)
    card = json_of({one.key: one.value for one in model.metadata_props}[CARD_KEY])
    _require_base(old, where)
    spec = spec_for_hand(StepSpec.from_json(card["spec"]), hand, where)
    again = _graph(model, spec, [])
    _verify(model, again, spec, [])

    # all else that a card says is of the learner, or of the rate
    rule = spec.contact
    card["spec"] = spec.to_json()
    card["channels"] = list(channel_names(spec.n_sensors))
    card[CONTACT_KEY] = None if rule is None else rule.to_json()
    return card, seal(again, card, spec)


def with_rules(old: bytes, rules: Mapping[str, int]) -> tuple[Json, bytes]:
    """Card and bytes of the file with other rules of the decision. Raises UsageError."""
    model = onnx.load_from_string(old)
    metadata = {one.key: one.value for one in model.metadata_props}
    card = json_of(metadata[CARD_KEY])
    for name in rules:
        if name not in LIMITS:
            raise UsageError(
                f"no rule {name!r} of the decision",
                next_step=f"choose from {', '.join(LIMITS)}",
            )
    try:
        decision = DecisionRules(**{**card["decision"], **rules})
    except ValueError as error:
        raise UsageError(
            f"rule {error}", next_step="give a number that fits the other rules"
        ) from None
    card["decision"] = decision.to_json()
    metadata[CARD_KEY] = json.dumps(card, separators=(",", ":"))
    return card, sealed_with(model, metadata)


def _require_older(old: bytes, card: Json, spec: StepSpec, where: str | Path) -> None:
    """Raise UsageError for a file that has the rule, cannot have it, or is adapted."""
    if CONTACT_KEY in card:
        raise UsageError(
            f"{where}: this file is up to date",
            next_step="use it as it is, or give --hand CARD or --rule NAME=NUMBER",
        )
    if spec.contact is None:
        raise UsageError(
            f"{where}: a model in {spec.unit} has no contact rule",
            next_step="use it as it is",
        )
    _require_base(old, where)


def _require_base(old: bytes, where: str | Path) -> None:
    """Raise UsageError for a file that is adapted to a person."""
    if is_adapted(old):
        raise UsageError(
            f"{where}: this file is adapted to a person",
            next_step="export its base again (holdfast adapt --undo), then adapt that",
        )


def _by_force(name: str, head: Json) -> ByForce:
    """The rule of a head, from its card."""
    return ByForce(name, tuple(head["classes"]), votes_in_all(head))


def _graph(
    model: onnx.ModelProto, spec: StepSpec, heads: list[ByForce]
) -> onnx.ModelProto:
    """The new step, and what stands behind the features in the old graph."""
    graph = GraphBuilder(spec.n_sensors)
    _, empty = add_step(graph, spec)
    constants = {one.name: one for one in model.graph.initializer}
    rules = {_votes_name(rule.name): rule for rule in heads}

    published = {one.name: one for one in model.graph.output}
    behind = {FEATURES}
    copied: set[str] = set()
    for node in model.graph.node:
        if behind.isdisjoint(node.input):
            continue
        behind.update(node.output)
        for name in node.input:
            if name in constants and name not in copied:
                copied.add(name)
                kept = onnx.TensorProto()
                kept.CopyFrom(constants[name])
                kept.name = KEPT + name
                graph.copy_constant(kept)

        (made,) = node.output
        rule = rules.get(made)
        out = learned_name(made) if rule else _kept(made, published)
        inputs = [
            name if name == FEATURES else _kept(name, published) for name in node.input
        ]
        again = onnx.NodeProto()
        again.CopyFrom(node)
        again.input[:] = inputs
        again.output[:] = [out]
        graph.copy(again)
        if rule:
            rule.add(graph, out, empty, made)
        if made in published:
            graph.copy_output(published[made])

    return graph.model()


def _votes_name(head: str) -> str:
    """The tensor of a head's votes."""
    return "votes" if head == MAIN_HEAD else f"votes_{head}"


def _kept(name: str, published: dict[str, Any]) -> str:
    """The name of a tensor behind the features in the new graph."""
    # votes before the contact rule have a name that a correction looks for
    own = name in published or name.startswith(learned_name(""))
    return name if own else KEPT + name


def _verify(
    old: onnx.ModelProto, new: onnx.ModelProto, spec: StepSpec, heads: list[ByForce]
) -> None:
    """Raise VerificationFailed unless the votes are the old learner's, by the rule."""
    rows = _rows(old)
    before = run_rows(open_session(cut_learners(old)), rows, CHUNK)
    after = run_rows(open_session(cut_learners(new)), rows, CHUNK)
    if not heads:
        for name, answers in before.items():
            _require(np.array_equal(after[name], answers), name)

    without: Outputs = {}
    if heads:
        empty = open_session(cut_learners(new, touches=False))
        without = run_rows(empty, rows, CHUNK)
    for rule in heads:
        name = _votes_name(rule.name)
        learned = before[name].astype(np.int64)
        _require(np.array_equal(after[name], rule.in_contact(learned)), name)
        _require(
            bool((without[name] == rule.without_contact()).all()),
            f"{name} of an empty hand",
        )

    compare_streams(new, spec, seed=0)


def _rows(model: onnx.ModelProto) -> FloatRows:
    """Feature rows: of the golden input, noise of their size, and the edges of float32."""
    session = open_session(model.SerializeToString())
    metadata = {one.key: one.value for one in model.metadata_props}
    spec = StepSpec.from_json(json_of(metadata[CARD_KEY])["spec"])
    values, valid = golden_input(spec.n_channels, spec.unit, spec.settle_samples)
    golden = run_recording(session, values, valid, [FEATURES])[FEATURES]

    rng = np.random.default_rng(0)
    drawn = golden[rng.integers(len(golden), size=RANDOM_ROWS)]
    noise = rng.normal(1.0, 0.5, size=drawn.shape).astype(np.float32)
    return np.concatenate([golden, drawn * noise, edge_rows(golden.shape[1])])


def _require(same: bool, what: str) -> None:
    """Raise VerificationFailed unless something is the same."""
    if not same:
        raise VerificationFailed(
            f"exported again, {what} are not those of the older file",
            next_step="report this",
        )
