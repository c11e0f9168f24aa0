"""Self-checks of the step graph: batches, corrupted samples, silence, reset, answers, offsets.

Each check takes an opened model and yields results with a figure. The input is the golden input of
model.py, which is made by formula and never from a recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from holdfast.core.contract import SITUATIONS, BoolArray, CheckResult, FloatArray
from holdfast.edge_runtime.graph import (
    Outputs,
    StepGraph,
    run_recording,
    run_recordings,
)
from holdfast.edge_runtime.model import Model, golden_input
from holdfast.edge_runtime.model_file import ModelCard, votes_in_all

SILENT_STEPS = 10_000
"""So long a silence shows a filter that decays into subnormal numbers, or a leak."""
SPANS = 5
"""Parts of the silence. A leak grows in most; what else the process does, in one or two."""
WARM_STEPS = 500
"""Steps before memory is measured, in which caches fill."""
MOST_GROWTH_KB = 1024
"""Python's allocator takes a few pages. A leak of one buffer a step would take 100 times more."""
STATM = Path("/proc/self/statm")
"""Memory of this process, in pages; its second number is the resident part."""
PAGE_KB = 4
"""Size of a page, kB: that of x86 and of most Arm systems."""
BATCH = (1.0, 0.5, 2.0, -1.0)
"""Factors: each recording of the batch is the golden input times one of these."""
EVIL = (np.nan, np.inf, -np.inf, 1e30, -1e30)
"""Readings that no sensor gives, and that a filter would keep for ever."""
ROUNDING = 1e-5
"""A probability is a float32, and so is a sum of eight of them."""


def clean_input(model: Model) -> tuple[FloatArray, BoolArray]:
    """The golden input [T, C] and [T, S] without its corrupted and lost samples."""
    card = model.card
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
    good = np.isfinite(values) & (np.abs(values) < 1e6)
    return np.where(good, values, 0.0), np.ones_like(valid)


def check_one_against_many(model: Model) -> Iterator[CheckResult]:
    """A recording alone and the same one in a batch must give the same bits."""
    values, valid = clean_input(model)
    names = _output_names(model)

    # different recordings, so that one that leaks into another shows
    scaled = [values * factor for factor in BATCH]
    flags = [valid] * len(BATCH)
    rows = [np.arange(len(values))] * len(BATCH)
    together = run_recordings(model.session, scaled, flags, names, rows)

    different = set()
    for recording, of_batch in zip(scaled, together, strict=True):
        alone = run_recording(model.session, recording, valid, names)
        different.update(_different(alone, of_batch))

    figure = f"{len(values)} rows, {len(BATCH)} together: "
    figure += _verdict(different, f"{len(names)} outputs, the same bits")
    yield CheckResult("one sample against a batch", not different, figure)


def check_corrupted_samples(model: Model) -> Iterator[CheckResult]:
    """NaN, inf and 1e30 must act like a lost sensor, bit for bit, in outputs and state."""
    values, valid = clean_input(model)

    # the same places twice: once corrupted, once flagged as lost by the driver
    corrupted = values.copy()
    lost = valid.copy()
    count = 2 * len(EVIL)
    for k in range(count):
        # apart from one another, so that every fault meets a settled model
        row = model.card.settle_samples + 3 * k
        channel = k % model.card.n_channels
        corrupted[row, channel] = EVIL[k % len(EVIL)]
        lost[row, channel // 3] = False

    # every number of the state is compared too, or a fault could show much later
    answers = _outputs_and_states(StepGraph(model.session), corrupted, valid)
    wanted = _outputs_and_states(StepGraph(model.session), values, lost)
    same = not _different(answers, wanted)

    # both could be wrong alike
    finite = all(np.isfinite(rows).all() for rows in answers.values())

    figure = f"{count} of nan, inf, 1e30: "
    figure += "as if lost, to the last bit" if same else "not as if lost"
    if not finite:
        figure += "; not finite"

    yield CheckResult("corrupted samples", same and finite, figure)


def check_silence_and_memory(model: Model) -> Iterator[CheckResult]:
    """A press and a shake, then one reading 10,000 times: no subnormal numbers, no memory leak."""
    graph = StepGraph(model.session)
    values, _ = clean_input(model)
    tiny = float(np.finfo(np.float64).tiny)
    for row in values[: model.card.settle_samples + 5]:
        np.copyto(graph.sample[0], row)
        graph.step()

    for _ in range(WARM_STEPS):
        graph.step()

    resident_kb = [_resident_kb()]
    subnormal = 0
    smallest = float("inf")
    for k in range(1, SILENT_STEPS + 1):
        graph.step()
        if k % (SILENT_STEPS // SPANS) == 0:
            resident_kb.append(_resident_kb())
        if k % 10 == 0:
            # subnormal numbers make a processor a hundred times slower
            sizes = np.abs(graph.state[graph.state != 0.0])
            subnormal += int((sizes < tiny).sum())
            smallest = min(smallest, float(sizes.min(initial=np.inf)))

    grown_kb = SPANS * int(np.median(np.diff(resident_kb)))
    figure = f"{subnormal} subnormal numbers, the smallest state {smallest:.1e}"
    yield CheckResult("silence", subnormal == 0, figure)
    figure = f"{SILENT_STEPS} steps, {grown_kb:+d} kB"
    yield CheckResult("memory", grown_kb <= MOST_GROWTH_KB, figure)


def check_reset(model: Model) -> Iterator[CheckResult]:
    """After a reset the graph must answer as a fresh one does, bit for bit."""
    values, valid = clean_input(model)
    graph = StepGraph(model.session)
    first = _outputs_and_states(graph, values, valid)

    # something else in between, which a reset must forget
    _outputs_and_states(graph, -3.0 * values, ~valid)

    graph.reset()
    different = _different(first, _outputs_and_states(graph, values, valid))
    figure = f"{len(values)} rows again: {_verdict(different, 'the same bits')}"
    yield CheckResult("reset forgets", not different, figure)


def check_answers(model: Model) -> Iterator[CheckResult]:
    """Votes must be whole, and as many as the card says; probabilities must be possible."""
    card = model.card
    values, valid = golden_input(card.n_channels, card.unit, card.settle_samples)
    answers = run_recording(model.session, values, valid, _output_names(model))

    wrong = _impossible_votes(card, answers) | _impossible_shares(card, answers)

    labels = np.arange(len(SITUATIONS))
    if not np.isin(answers["situation"], labels).all():
        wrong.add("situation")

    sensors = answers["usable_sensors"]
    possible = (sensors >= 0) & (sensors <= card.n_channels // 3)
    if not possible.all():
        wrong.add("usable_sensors")

    figure = f"{len(values)} rows: "
    figure += f"{', '.join(sorted(wrong))} out of range" if wrong else "all in range"
    yield CheckResult("votes and probabilities", not wrong, figure)


def _impossible_shares(card: ModelCard, answers: Outputs) -> set[str]:
    """Names of the probabilities that are out of range, or do not add up to 1."""
    shares = ["p_situation"]
    if card.has_weight:
        shares.append("p_class")

    wrong = set()
    for name in (*shares, *card.heads):
        p = answers[name]
        # a comparison with NaN is false, so this says what must hold
        in_range = (p >= 0.0) & (p <= 1.0 + ROUNDING)
        if not in_range.all():
            wrong.add(name)
        if name in shares:
            off = np.abs(p.sum(axis=1) - 1.0)
            if not (off <= ROUNDING).all():
                wrong.add(name)

    return wrong


def _impossible_votes(card: ModelCard, answers: Outputs) -> set[str]:
    """Names of the votes that are not whole, or not as many as the card says."""
    wrong = set()
    for head in ("situation", *card.heads):
        name = "votes" if head == "situation" else f"votes_{head}"
        votes = answers[name]
        whole = (votes >= 0) & (votes == np.floor(votes))

        # in float64, where sums of whole numbers are exact
        sums = votes.sum(axis=1, dtype=np.float64)
        wanted = votes_in_all(card.raw["heads"][head])
        if not whole.all() or (sums != wanted).any():
            wrong.add(name)

    return wrong


def check_large_offset(model: Model) -> Iterator[CheckResult]:
    """A large constant on every channel must not change what the band-pass filters detect.

    The offset is a power of two, which the input's numbers take without rounding.
    """
    values, valid = clean_input(model)
    offset = 2.0 ** np.floor(np.log2(0.5 * model.card.range_limit))

    # only these promise it: a level or a cone follows the offset
    is_band_pass = [name.startswith("band_pass") for name in model.card.detectors]
    fired = []
    for moved in (values, values + offset):
        answers = run_recording(model.session, moved, valid, ["detectors"])
        fired.append(answers["detectors"][:, is_band_pass])

    plain, with_offset = fired
    differ = int((plain != with_offset).sum())
    figure = f"{offset:g} {model.card.unit} on every channel: "
    figure += f"{plain.sum()} found, {differ} differ"
    yield CheckResult("a large offset", differ == 0, figure)


def _output_names(model: Model) -> list[str]:
    """All outputs but the state."""
    names = [one.name for one in model.session.get_outputs()]
    names.remove("state_out")
    return names


def _outputs_and_states(
    graph: StepGraph, values: FloatArray, valid: BoolArray
) -> Outputs:
    """Every output and the state at every row; the graph may have stepped before."""
    kept: dict[str, list[np.ndarray]] = {name: [] for name in graph.out}
    kept["state"] = []
    for row, flags in zip(values, valid, strict=True):
        np.copyto(graph.sample[0], row)
        np.copyto(graph.valid[0], flags)
        answers = graph.step()
        # copied, because the graph reuses its buffers
        for name, array in answers.items():
            kept[name].append(array[0].copy())
        kept["state"].append(graph.state[0].copy())

    return {name: np.array(rows) for name, rows in kept.items()}


def _different(one: Outputs, other: Outputs) -> list[str]:
    """Names of the outputs whose bits differ."""
    return [name for name in one if one[name].tobytes() != other[name].tobytes()]


def _verdict(different: set[str] | list[str], same: str) -> str:
    """The end of a figure."""
    return f"{', '.join(sorted(different))} differ" if different else same


def _resident_kb() -> int:
    """Memory of this process; 0 where the system does not report it."""
    if not STATM.exists():
        return 0

    pages = STATM.read_text(encoding="ascii").split()
    return int(pages[1]) * PAGE_KB
