"""Self-checks of the step graph: batches, corrupted samples, silence, reset, votes, offsets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.edge_runtime.check_result import CheckResult, clean_input
from holdfast.edge_runtime.graph import (
    Outputs,
    StepGraph,
    run_recording,
    run_recordings,
)
from holdfast.edge_runtime.monitor import Model
from holdfast.edge_runtime.onnx_rules import votes_in_all

SILENT_STEPS = 10_000
WARM_STEPS = 500
MOST_GROWTH_KB = 1024
"""Python's allocator takes a few pages. A leak of one buffer a step would take 100 times more."""
STATM = Path("/proc/self/statm")
PAGE_KB = 4
BATCH = (1.0, 0.5, 2.0, -1.0)
"""Factors: each recording of the batch is the golden input times one of these."""


def check_one_against_many(model: Model) -> Iterator[CheckResult]:
    """A recording alone and the same one in a batch must give the same bits."""
    values, valid = clean_input(model)
    names = [one.name for one in model.session.get_outputs() if one.name != "state_out"]
    scaled = [values * factor for factor in BATCH]
    rows = [np.arange(len(values))] * len(BATCH)
    together = run_recordings(model.session, scaled, [valid] * len(BATCH), names, rows)
    alone = [run_recording(model.session, one, valid, names) for one in scaled]
    pairs = list(zip(alone, together, strict=True))
    other = [
        name
        for name in names
        if any(_bits(one[name]) != _bits(many[name]) for one, many in pairs)
    ]
    verdict = (
        f"{', '.join(other)} differ"
        if other
        else f"{len(names)} outputs, the same bits"
    )
    figure = f"{len(values)} rows, {len(BATCH)} together: {verdict}"
    yield CheckResult("one sample against a batch", not other, figure)


def check_corrupted_samples(model: Model) -> Iterator[CheckResult]:
    """NaN, inf and 1e30 must act like a lost sensor, bit for bit, in outputs and state."""
    values, valid = clean_input(model)
    settle, bad_values, lost = model.card.settle_samples, values.copy(), valid.copy()
    places = [
        (settle + 3 * k, k % model.card.n_channels, evil)
        for k, evil in enumerate(EVIL * 2)
    ]
    for row, channel, evil in places:
        bad_values[row, channel] = evil
        lost[row, channel // 3] = False
    got, finite = _followed(model, bad_values, valid)
    wanted, _ = _followed(model, values, lost)
    same = all(_bits(got[name]) == _bits(wanted[name]) for name in got)
    verdict = f"{len(places)} of nan, inf, 1e30: " + (
        "as if lost, to the last bit" if same else "not as if lost"
    )
    yield CheckResult(
        "corrupted samples",
        same and finite,
        verdict + ("" if finite else "; not finite"),
    )


EVIL = (np.nan, np.inf, -np.inf, 1e30, -1e30)


def check_silence_and_memory(model: Model) -> Iterator[CheckResult]:
    """A press and a shake, then one reading 10,000 times: no subnormal numbers, no memory leak."""
    graph, (values, _) = StepGraph(model.session), clean_input(model)
    tiny, smallest, subnormal = float(np.finfo(np.float64).tiny), np.inf, 0
    for row in values[: model.card.settle_samples + 5]:
        np.copyto(graph.sample[0], row)
        graph.step()
    for _ in range(WARM_STEPS):
        graph.step()
    before_kb = _resident_kb()
    for k in range(SILENT_STEPS):
        graph.step()
        if k % 10 == 0:
            size = np.abs(graph.state[graph.state != 0.0])
            subnormal += int((size < tiny).sum())
            smallest = min(smallest, float(size.min(initial=np.inf)))
    grown_kb = _resident_kb() - before_kb
    yield CheckResult(
        "silence",
        subnormal == 0,
        f"{subnormal} subnormal numbers, the smallest state {smallest:.1e}",
    )
    yield CheckResult(
        "memory", grown_kb <= MOST_GROWTH_KB, f"{SILENT_STEPS} steps, {grown_kb:+d} kB"
    )


def check_reset(model: Model) -> Iterator[CheckResult]:
    """After a reset the graph must answer as a fresh one does, bit for bit."""
    values, valid = clean_input(model)
    graph = StepGraph(model.session)
    first = _walked(graph, values, valid)
    _walked(graph, -3.0 * values, ~valid)
    graph.reset()
    again = _walked(graph, values, valid)
    other = [name for name in first if _bits(first[name]) != _bits(again[name])]
    verdict = f"{', '.join(other)} differ" if other else "the same bits"
    yield CheckResult(
        "reset forgets", not other, f"{len(values)} rows again: {verdict}"
    )


def check_votes(model: Model) -> Iterator[CheckResult]:
    """Every sample must get whole votes, and as many as its card says."""
    values, valid = clean_input(model)
    votes = run_recording(model.session, values, valid, ["votes"])["votes"].astype(
        np.float64
    )
    head = model.card.raw["heads"]["situation"]
    wanted = votes_in_all(head)
    sums = np.unique(votes.sum(axis=1))
    whole = bool((votes == np.round(votes)).all()) and sums.tolist() == [wanted]
    verdict = f"{wanted} a sample, found {sums[:3].tolist()}"
    yield CheckResult("votes", whole, verdict)


def check_large_offset(model: Model) -> Iterator[CheckResult]:
    """A large constant on every channel must not change what the band-pass filters detect.

    The offset is a power of two, which the input's numbers take without rounding.
    """
    values, valid = clean_input(model)
    offset = 2.0 ** np.floor(np.log2(0.5 * model.card.raw["range_limit"]))
    columns = [
        k for k, name in enumerate(model.card.detectors) if name.startswith("band_pass")
    ]
    plain, moved = (
        run_recording(model.session, one, valid, ["detectors"])["detectors"][:, columns]
        for one in (values, values + offset)
    )
    differ = int((plain != moved).sum())
    found = int(plain.sum())
    verdict = (
        f"{offset:g} {model.card.unit} on every channel: {found} found, {differ} differ"
    )
    yield CheckResult("a large offset", differ == 0, verdict)


def _walked(graph: StepGraph, values: FloatArray, valid: BoolArray) -> Outputs:
    """Every output at every row, and the last state; the graph may have stepped before."""
    kept: dict[str, list[Any]] = {name: [] for name in graph.out}
    for row, flags in zip(values, valid, strict=True):
        np.copyto(graph.sample[0], row)
        np.copyto(graph.valid[0], flags)
        for name, array in graph.step().items():
            kept[name].append(array[0].copy())
    return {
        **{name: np.array(rows) for name, rows in kept.items()},
        "state": graph.state.copy(),
    }


def _followed(
    model: Model, values: FloatArray, valid: BoolArray
) -> tuple[Outputs, bool]:
    """What a fresh graph gave, and whether outputs and state were finite at every step."""
    graph, finite = StepGraph(model.session), True
    kept: dict[str, list[Any]] = {name: [] for name in (*graph.out, "state")}
    for row, flags in zip(values, valid, strict=True):
        np.copyto(graph.sample[0], row)
        np.copyto(graph.valid[0], flags)
        for name, array in {**graph.step(), "state": graph.state}.items():
            kept[name].append(array[0].copy())
            finite = finite and bool(np.isfinite(array.astype(np.float64)).all())
    return {name: np.array(rows) for name, rows in kept.items()}, finite


def _bits(array: npt.NDArray[Any]) -> bytes:
    return array.tobytes()


def _resident_kb() -> int:
    """Memory of this process; 0 where the system does not report it."""
    return (
        int(STATM.read_text(encoding="ascii").split()[1]) * PAGE_KB
        if STATM.exists()
        else 0
    )
