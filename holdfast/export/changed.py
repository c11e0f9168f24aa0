"""A changed, verified copy of a sealed file: another hand, other rules, exported again, adapted.

`changed`: what stands behind the features is copied node by node, constants and all, and the step
in front of them is built anew. So a file needs no artifact folder to fit another hand, or to get
the step of this version. Rules of the decision stand in the card alone.

`adapted`: the file of one person has other rules, and may have a correction behind its votes
(heads.py). Its metadata keep those of the base, compressed: `undone` restores the base byte for
byte.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import zlib
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np
import onnx

from holdfast.core.contract import Json, channel_names
from holdfast.core.errors import NotAdapted, UsageError, VerificationFailed
from holdfast.core.hand_card import HandCard
from holdfast.core.schema import json_of
from holdfast.edge_runtime.decision import LIMITS, DecisionRules
from holdfast.edge_runtime.graph import Outputs, open_session, run_recording
from holdfast.edge_runtime.model import golden_input
from holdfast.edge_runtime.model_file import CARD_KEY, GOLDEN_KEY, SEAL_KEY
from holdfast.export.exporting import metadata_of, seal, sealed_with, spec_for_hand
from holdfast.export.structure import edge_rows, hard_rows_of, require
from holdfast.export.verify import (
    AdaptedVerification,
    compare_streams,
    cut,
    cut_learners,
    require_single_rows_equal,
    run_rows,
)
from holdfast.step.builder import GraphBuilder
from holdfast.step.features import add_step
from holdfast.step.heads import Correction, FloatRows
from holdfast.step.network import LOGIT_STEPS
from holdfast.step.spec import StepSpec

FEATURES, VOTES = "features", "votes"
NEW = "new_"
"""Begins the names of the new step's tensors: what is copied keeps its names."""
PREFIX = "adapted_"
"""Begins the name of every tensor that a correction adds."""
BEFORE = f"{PREFIX}votes_before"
"""The base's votes, which keep their numbers under another name."""
BASE_KEY = "holdfast.base"
"""The entry of the metadata that holds those of the base."""
RANDOM_ROWS = 5_000
"""Rows of noise at the size of the golden input's features, on which the votes are compared."""
OF_THE_VOTES = {"situation", "p_situation", "p_class", "weight"}
"""Outputs that a correction changes with the votes."""


def is_adapted(data: bytes) -> bool:
    """Whether a sealed file is adapted to a person."""
    return BASE_KEY in metadata_of(onnx.load_from_string(data))


def changed(
    data: bytes,
    hand: HandCard | None = None,
    rules: Mapping[str, int] | None = None,
    where: str | Path = "",
) -> bytes:
    """A changed copy of a sealed file, verified.

    hand: for which the copy is. rules: of the decision, by name. Without either, the step is built
    anew. Raises UsageError for a file that takes no such change, or a rule that cannot be;
    VerificationFailed where the learner answers differently.
    """
    model = onnx.load_from_string(data)
    kept = metadata_of(model)
    card = json_of(kept[CARD_KEY])
    spec = StepSpec.from_json(card["spec"])
    if rules:
        card["decision"] = _decision(card["decision"], rules)

    if hand is not None or not rules:
        if BASE_KEY in kept:
            raise UsageError(
                f"{where}: this file is adapted to a person",
                next_step="export its base again (holdfast adapt --undo), then adapt that",
            )
        if hand is not None:
            spec = spec_for_hand(spec, hand, where)
        model = _with_new_step(model, spec, card)
        # all else that a card says is of the learner, or of the rate
        card["spec"] = spec.to_json()
        card["channels"] = list(channel_names(spec.n_sensors))
        card["contact"] = msgspec.to_builtins(spec.contact)

    # these three are written anew; an adapted file has its base's behind them
    for name in (CARD_KEY, GOLDEN_KEY, SEAL_KEY):
        del kept[name]
    return seal(model, card, spec, kept)


def _decision(before: Json, rules: Mapping[str, int]) -> Json:
    """The rules of a decision, some of them replaced. Raises UsageError."""
    unknown = [name for name in rules if name not in LIMITS]
    if unknown:
        raise UsageError(
            f"no rule {unknown[0]!r} of the decision",
            next_step=f"choose from {', '.join(LIMITS)}",
        )
    try:
        return DecisionRules(**{**before, **rules}).to_json()
    except ValueError as error:
        raise UsageError(
            f"rule {error}", next_step="give a number that fits the other rules"
        ) from None


def _with_new_step(old: onnx.ModelProto, spec: StepSpec, card: Json) -> onnx.ModelProto:
    """The step of a spec in front of a file's learner, verified."""
    new = _joined(old, spec)
    rows = _rows(old, StepSpec.from_json(card["spec"]))
    before = run_rows(open_session(cut_learners(old)), rows)
    after = run_rows(open_session(cut_learners(new)), rows)
    _require_answers(before, after, rows)
    compare_streams(new, spec, seed=0)
    return new


def _joined(old: onnx.ModelProto, spec: StepSpec) -> onnx.ModelProto:
    """The new step, and what stands behind the features in the old graph."""
    # a file that was changed before has such names already
    prefix = NEW
    while any(node.output[0].startswith(prefix) for node in old.graph.node):
        prefix += NEW
    graph = GraphBuilder(spec.n_sensors, prefix)
    add_step(graph, spec)
    constants = {one.name: one for one in old.graph.initializer}
    published = {one.name: one for one in old.graph.output}
    behind = {FEATURES}
    for node in old.graph.node:
        if behind.isdisjoint(node.input):
            continue
        behind.update(node.output)
        for name in node.input:
            if name in constants:
                graph.copy_constant(constants[name])

        (made,) = node.output
        copied = onnx.NodeProto()
        copied.CopyFrom(node)
        graph.copy(copied)
        if made in published:
            graph.copy_output(published[made])

    return graph.model()


def _rows(model: onnx.ModelProto, spec: StepSpec) -> FloatRows:
    """Feature rows: of the golden input, noise of their size, and the edges of float32."""
    golden = _golden(model.SerializeToString(), spec)[FEATURES]
    rng = np.random.default_rng(0)
    drawn = golden[rng.integers(len(golden), size=RANDOM_ROWS)]
    noise = rng.normal(1.0, 0.5, size=drawn.shape).astype(np.float32)
    return np.concatenate([golden, drawn * noise, edge_rows(golden.shape[1])])


def _golden(data: bytes, spec: StepSpec) -> Outputs:
    """All outputs of the whole step for the golden input."""
    values, valid = golden_input(spec.n_channels, spec.unit, spec.settle_samples)
    session = open_session(data)
    names = [output.name for output in session.get_outputs()]
    names.remove("state_out")
    return run_recording(session, values, valid, names)


def _require_answers(
    old: Outputs,
    new: Outputs,
    rows: FloatRows,
    correction: Correction | None = None,
    where: str = "",
) -> None:
    """Votes are the old ones, corrected; what does not follow from them is the same bit for bit."""
    follow = {VOTES, *OF_THE_VOTES} if correction is not None else ()
    wrong = []
    for name, answers in old.items():
        if name not in follow and answers.tobytes() != new[name].tobytes():
            wrong.append(name)
    if correction is not None:
        votes = correction.corrected(rows, old[VOTES].astype(np.int64))
        if not np.array_equal(new[VOTES], votes):
            wrong.append(VOTES)
    require(not wrong, f"the changed file{where}: {wrong} differ from the reference")


def adapted(
    base: bytes, correction: Correction | None, decision: DecisionRules, about: Json
) -> bytes:
    """A sealed file for one person. base: a sealed file that is not adapted.

    correction: None where only the decision is another. decision: replaces that of the base. about:
    what the adaptation is based on, for the card. Raises VerificationFailed where the base could
    not be restored byte for byte.
    """
    model = onnx.load_from_string(base)
    metadata = metadata_of(model)
    card = json_of(metadata[CARD_KEY])
    card["decision"] = decision.to_json()
    if correction is not None:
        head = card["heads"]["situation"]
        _add_correction(model, correction, len(head["classes"]))
        head["correction"] = {
            "inputs": correction.network.n_features,
            "steps_per_nat": LOGIT_STEPS,
        }
    digest = hashlib.sha256(base).hexdigest()
    card["adaptation"] = {"base_sha256": digest, **about}
    onnx.checker.check_model(model, full_check=True)

    # the seal is computed again when the base is restored
    del metadata[SEAL_KEY]
    pairs = json.dumps(list(metadata.items()), separators=(",", ":"))
    # metadata of ONNX are strings, so the compressed bytes are written as letters
    packed = base64.b64encode(zlib.compress(pairs.encode(), 9)).decode("ascii")
    data = seal(model, card, StepSpec.from_json(card["spec"]), {BASE_KEY: packed})

    # a person must be able to go back, so a file that cannot is not returned
    if undone(data) != base:
        raise VerificationFailed(
            "the base file cannot be restored byte for byte",
            cause="it was written by another version of the onnx library",
            next_step="export the base again with this version, then adapt it",
        )
    return data


def undone(data: bytes, where: str | Path = "") -> bytes:
    """The base of an adapted file, byte for byte. Raises NotAdapted."""
    model = onnx.load_from_string(data)
    metadata = metadata_of(model)
    if BASE_KEY not in metadata:
        raise NotAdapted(
            "this file is not adapted", where=where, next_step="use it as it is"
        )

    card = json_of(metadata[CARD_KEY])
    try:
        pairs = json_of(zlib.decompress(base64.b64decode(metadata[BASE_KEY])))
        if "correction" in card["heads"]["situation"]:
            _remove_correction(model)
        base = sealed_with(model, dict(pairs))
    except (ValueError, zlib.error, binascii.Error):
        base = b""

    # The card names the digest of the base, so a base that differs in one byte is refused.
    if hashlib.sha256(base).hexdigest() != card["adaptation"]["base_sha256"]:
        raise NotAdapted(
            "the base file in it cannot be restored",
            where=where,
            cause="the file was altered, or another version of the onnx library wrote it",
            next_step="use your copy of the base file",
        )
    return base


def verify_adapted(
    base: bytes, data: bytes, correction: Correction | None, rows: FloatRows
) -> AdaptedVerification:
    """Compare an adapted file with its base, corrected in numpy. Raises VerificationFailed.

    rows: [N, F] features.
    """
    hard = np.concatenate([rows, hard_rows_of(correction, rows)])
    model, before_it = onnx.load_from_string(data), onnx.load_from_string(base)
    session = open_session(cut_learners(model))
    new = run_rows(session, hard)
    old = run_rows(open_session(cut_learners(before_it)), hard)
    _require_answers(old, new, hard, correction)
    # of the same votes the base makes the same label, probabilities and weight
    follow = sorted(OF_THE_VOTES & new.keys())
    of_votes = run_rows(open_session(cut(before_it, VOTES, follow)), new[VOTES])
    _require_answers(of_votes, new, hard)
    n_single = require_single_rows_equal(session, hard, new, seed=0)

    spec = StepSpec.from_json(json_of(metadata_of(model)[CARD_KEY])["spec"])
    before, after = _golden(base, spec), _golden(data, spec)
    _require_answers(before, after, before[FEATURES], correction, " of a stream")

    # only given rows: hard ones are no samples that a person could make
    differs = new["situation"][: len(rows)] != old["situation"][: len(rows)]
    n_samples = len(before[FEATURES])
    return AdaptedVerification(len(hard), n_single, n_samples, int(differs.sum()))


def _add_correction(
    model: onnx.ModelProto, correction: Correction, n_classes: int
) -> None:
    """Put it behind the votes of a model, in place: no other operator is changed."""
    # the number of sensors only matters to a graph with a state, which this part has not
    graph = GraphBuilder(1, PREFIX)
    correction.add(graph, FEATURES, BEFORE, n_classes, VOTES)
    added, constants = graph.part()

    # the correction takes over the name of the votes, so their readers need no change
    nodes = model.graph.node
    (at,) = (at for at, node in enumerate(nodes) if VOTES in node.output)
    nodes[at].output[:] = [BEFORE]
    # ONNX wants nodes in the order in which they can run
    for node in reversed(added):
        nodes.insert(at + 1, node)
    model.graph.initializer.extend(constants)


def _remove_correction(model: onnx.ModelProto) -> None:
    """The inverse of `_add_correction`, in place."""
    nodes, constants = model.graph.node, model.graph.initializer
    for at in reversed(range(len(constants))):
        if constants[at].name.startswith(PREFIX):
            del constants[at]

    for at in reversed(range(len(nodes))):
        (name, *_) = nodes[at].output
        if name == BEFORE:
            nodes[at].output[:] = [VOTES]
        elif name == VOTES or name.startswith(PREFIX):
            del nodes[at]
