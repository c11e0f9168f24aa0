"""Critical points -> balanced windows of the eight classes, third of four steps.

Where the mass of an object is not known, windows are labelled with the four situations alone.

A window is the N samples that end at its row. Five kinds of row are used:

critical points  labelled by the phase they fall in. At an edge between phases both claim the points
                 within 0.10 s of it, one window, and the higher situation wins, as in every tie:
                 the grasp point is the contact onset, a slip begins with its first sign and ends
                 when the object is gone
slip             only with an exact truth (a simulated trial, a camera), not from a script: evenly
                 spaced over each slip, since a short or faint one may have no critical point
keep             steady holding: in the middle of each hold and just before its end, with no
                 critical point near (critical points alone never show a hand that just holds)
nothing          the same in each phase without contact; labelled with the weight of the trial's
                 object, although no signal carries it
nothing, without an object: every half second, light and heavy alternately

These are the natural windows; classes are far from equal in number. Two other choices are made:

balanced  dense windows, for a hand in continuous use: of trials with an exact truth every risky
          sample, and evenly spaced ones of everything else, each labelled by its phase; critical
          points play no part. Counts differ, and the plan's class weights make all eight classes
          weigh the same (training/plan.py). The forest sees what a hand mostly does: not slip
dense     as balanced, and closer together where a phase begins: a hand that closes, or has just
          let go, looks like a slip. Few windows of a slip that lasts
thesis    the thesis' undersampled set: natural windows, as many of each class as the rarest has
          that occurs, and within a class every cell of object x action x source gives as equally
          as it can
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from holdfast.core.contract import (
    CLASSES,
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    class_id,
)
from holdfast.core.trial_layout import Mass
from holdfast.data.recording import NO_OBJECT, LabelledRows, Recording, whole_history
from holdfast.data.timeline import Phase
from holdfast.step.spec import HISTORY_S, WINDOW_S, window_samples

if TYPE_CHECKING:
    import pandas as pd

    from holdfast.data.critical_points import CriticalPoint

Choice = Literal["balanced", "dense", "thesis", "natural", "none"]
"""Which windows of a set in the thesis' layout are taken; none for its recordings alone."""
EDGE_S = WINDOW_S
"""How far a phase claims critical points beyond its edges, one window."""
STEADY_MARGIN_S = 0.3
"""A steady window keeps this far from the end of its phase and from every critical point."""
EMPTY_HAND_EVERY_S = 0.5
"""Between two windows of a recording without an object."""
SLIP_EVERY_S = 0.02
"""Between two windows inside a slip."""
MOST_OF_A_SLIP = 12
"""At most so many windows of one slip, however long it lasts."""
DENSE_EVERY_S = {NOTHING: 0.5, GRASP: 0.1, SAFE_SLIP: 0.02, RISKY_SLIP: 0.0}
"""Between two dense windows of a situation; 0 takes every sample."""
BEGIN_S = 0.4
BEGIN_EVERY_S = {NOTHING: 0.013, GRASP: 0.02, SAFE_SLIP: 0.013, RISKY_SLIP: 0.0}
"""While a phase begins, windows of the choice "dense" are no farther apart."""
MOST_RISKY = 40
"""And at most so many of one slip: its first ones, and others evenly spaced."""
STRATA = ["object", "action", "source"]
"""What undersampling keeps as even as it can within a class."""
COLUMNS = ["trial", "row", "label", *STRATA]


@dataclass(frozen=True)
class TimedTrial:
    """A recording with its phases, and whether its object is heavy (None: not known, or no object).

    timed: each sample of a phase is of its situation, which a script does not promise. mass: of the
    object, None where it is not known here. labels_by: what gives the phases. averaged: how many
    samples of its file one of the recording is the mean of. denied: columns with numbers that the
    hand card says are not measured. contact_on: the reading above which a lift's hand touches
    something, where it was taken from the noise.
    """

    recording: Recording
    heavy: bool | None
    timed: bool = False
    mass: Mass | None = None
    labels_by: str = ""
    averaged: int = 1
    denied: tuple[str, ...] = ()
    contact_on: float | None = None

    @property
    def has_object(self) -> bool:
        """Whether it is more than the hand alone."""
        return self.recording.object_name is not None


def classes_of(trials: Sequence[TimedTrial]) -> tuple[str, ...]:
    """The classes that windows are labelled with: eight, or without a mass four situations."""
    for trial in trials:
        if trial.has_object and trial.heavy is None:
            return SITUATIONS
    return CLASSES


@dataclass(frozen=True)
class _Spot:
    """The last row of a window, its situation, and the rule that chose it."""

    row: int
    situation: int
    source: str


def windows_of(trials: Sequence[TimedTrial], choice: Choice) -> pd.DataFrame:
    """The windows of a choice, one line each; for "thesis" all that `undersample` draws from.

    Columns: trial (index), row (the window's last), label (of classes_of), object, action and
    source (band-pass, friction, both, slip, keep, nothing, dense).
    """
    import pandas as pd  # a third of a second, which no command without windows needs

    lines = []
    classes = classes_of(trials)
    for index, trial in enumerate(trials):
        name = trial.recording.object_name or NO_OBJECT
        action = trial.recording.action or NO_OBJECT
        # A script does not say when each sample begins to slip.
        if choice in ("balanced", "dense") and trial.timed and trial.has_object:
            spots = _dense(trial.recording, closer=choice == "dense")
        else:
            spots = _natural(trial)

        # a figure counts a window without an answer as missed, and training leaves it out
        if choice != "natural":
            whole = whole_history(trial.recording)
            spots = [spot for spot in spots if whole[spot.row]]

        for number, spot in enumerate(spots):
            # Without an object windows are light and heavy alternately.
            heavy = bool(number % 2) if trial.heavy is None else trial.heavy
            label = _label(spot.situation, heavy, classes)
            lines.append((index, spot.row, label, name, action, spot.source))
    return pd.DataFrame(lines, columns=COLUMNS)


def undersample(windows: pd.DataFrame, seed: int) -> pd.DataFrame:
    """As many windows of each class as the rarest has, drawn evenly from the cells of a class.

    Cells are dealt from in turn until the class is full, so a small cell gives all it has and large
    ones share the rest. The same seed draws the same windows; order is by trial and row. A class
    that does not occur has none.
    """
    draw = np.random.default_rng(seed).permutation(len(windows))
    shuffled = windows.assign(_draw=draw)
    # The turn of a window is its place in its cell: all firsts come before all seconds.
    turn = shuffled.groupby(["label", *STRATA])["_draw"].rank()
    dealt = shuffled.assign(_turn=turn).sort_values(["_turn", "_draw"])

    fewest = windows["label"].value_counts().min()
    kept = dealt.groupby("label").head(fewest)
    in_order = kept.sort_values(["trial", "row"])
    return in_order[COLUMNS].reset_index(drop=True)


def labelled_rows(
    windows: pd.DataFrame, classes: tuple[str, ...] = CLASSES
) -> LabelledRows:
    """The task of a table of windows. classes: those of its labels."""
    trial, row, label = windows[COLUMNS[:3]].to_numpy(dtype=np.int64).T
    return LabelledRows(trial, row, label, classes)


def sample_counts(trials: Sequence[TimedTrial]) -> dict[str, int]:
    """Samples per class over the whole time lines, of trials with an object."""
    classes = classes_of(trials)
    counts = dict.fromkeys(classes, 0)
    for trial in trials:
        for phase in trial.recording.phases if trial.has_object else ():
            number = _label(phase.situation, bool(trial.heavy), classes)
            counts[classes[number]] += phase.stop - phase.first
    return counts


def _label(situation: int, heavy: bool, classes: tuple[str, ...]) -> int:
    """The number of a situation among classes, which may know no weight."""
    return class_id(situation, heavy=heavy) if classes == CLASSES else situation


def _natural(trial: TimedTrial) -> list[_Spot]:
    """All windows of a trial, each row once, in order of time."""
    if not trial.has_object:
        # windows of the empty hand, evenly spaced
        every = round(EMPTY_HAND_EVERY_S * trial.recording.rate_hz)
        rows = range(every, len(trial.recording.samples), every)
        return [_Spot(row, NOTHING, "nothing") for row in rows]

    # dense windows, the default, need no critical points
    from holdfast.data.critical_points import offline_critical_points

    points = offline_critical_points(trial.recording)
    spots = _critical(trial.recording, points)
    spots += _steady(trial.recording, points)
    # A script does not know when a slip really lasts, so only an exact truth fills it.
    if trial.timed:
        taken = {spot.row for spot in spots}
        for spot in _slipping(trial.recording):
            if spot.row not in taken:
                spots.append(spot)
    return sorted(spots, key=lambda spot: spot.row)


def _dense(recording: Recording, *, closer: bool) -> list[_Spot]:
    """Windows by phase alone. closer: while a phase begins, and few of a slip that lasts."""
    rate_hz = recording.rate_hz
    # Before that a hand answers nothing, because its history is not whole.
    settled = math.ceil(HISTORY_S * rate_hz)
    spots = []
    for phase in recording.phases:
        first = max(phase.first, settled)
        every = max(1, round(DENSE_EVERY_S[phase.situation] * rate_hz))
        rows = list(range(first, phase.stop, every))
        if closer:
            rows = _closer(rows, first, phase, rate_hz)
        for row in rows:
            spots.append(_Spot(row, phase.situation, "dense"))
    return spots


def _closer(rows: list[int], first: int, phase: Phase, rate_hz: float) -> list[int]:
    """The rows of a phase from its row `first` on, and others while it begins."""
    begun = min(phase.stop, first + round(BEGIN_S * rate_hz))
    every = max(1, round(BEGIN_EVERY_S[phase.situation] * rate_hz))
    in_order = sorted({*range(first, begun, every), *rows})
    if phase.situation != RISKY_SLIP or len(in_order) <= MOST_RISKY:
        return in_order
    # A slow slide of a second would outweigh thirty fast slips.
    half = MOST_RISKY // 2
    later = np.linspace(half, len(in_order) - 1, MOST_RISKY - half).round()
    return in_order[:half] + [in_order[int(place)] for place in later]


def _critical(recording: Recording, points: list[CriticalPoint]) -> list[_Spot]:
    """A window at each critical point that falls into a phase with contact."""
    near = round(EDGE_S * recording.rate_hz)
    spots = []
    for point in points:
        # Near an edge two phases claim the point, and the higher situation wins.
        situation = NOTHING
        for phase in recording.phases:
            if phase.first - near <= point.row < phase.stop + near:
                situation = max(situation, phase.situation)
        if situation != NOTHING:
            spots.append(_Spot(point.row, situation, point.source))
    return spots


def _steady(recording: Recording, points: list[CriticalPoint]) -> list[_Spot]:
    """Windows in the middle and near the end of each phase in which nothing happens."""
    margin = round(STEADY_MARGIN_S * recording.rate_hz)
    shortest = window_samples(recording.rate_hz)
    spots = []
    for phase in recording.phases:
        if phase.situation not in (NOTHING, GRASP):
            continue
        middle = (phase.first + phase.stop) // 2
        late = phase.stop - 1 - margin
        # In a phase this short the two windows would overlap, or lie beyond its end.
        if late - middle < shortest:
            continue

        source = "nothing" if phase.situation == NOTHING else "keep"
        for row in (middle, late):
            if all(abs(point.row - row) > margin for point in points):
                spots.append(_Spot(row, phase.situation, source))
    return spots


def _slipping(recording: Recording) -> list[_Spot]:
    """Evenly spaced windows of each slip, at most MOST_OF_A_SLIP."""
    every = SLIP_EVERY_S * recording.rate_hz
    spots = []
    for phase in recording.phases:
        if phase.situation in (NOTHING, GRASP):
            continue

        length = phase.stop - phase.first
        count = int(np.clip(length / every, 1, MOST_OF_A_SLIP))
        # Neither the first nor the last row of the slip: they belong to its edges.
        places = np.linspace(phase.first, phase.stop - 1, count + 2)[1:-1]
        # A slip of few rows has fewer of them than windows.
        rows = np.unique(places.round().astype(np.int64))
        for row in rows.tolist():
            spots.append(_Spot(row, phase.situation, "slip"))
    return spots
