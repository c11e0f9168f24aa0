"""Holds with less force than the model's contact rule needs: called nothing, by design.

Force decides "nothing" (`add_contact` in holdfast/export/guard.py), so an object that is held with
less than the force at which contact begins cannot be seen. These holds stay in all other figures,
and are counted apart as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from holdfast.core.contract import GRASP, NOTHING, BoolArray
from holdfast.core.errors import count_of
from holdfast.core.reading import Json
from holdfast.edge_runtime.model_file import CONTACT_KEY, ModelCard
from holdfast.evaluation.alarms import match_alarms
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.evaluation.states import States, labels_everywhere
from holdfast.evaluation.statistics import share
from holdfast.training.figures import Share, in_words
from holdfast.training.recording import Recording


@dataclass(frozen=True)
class BelowFloor:
    """Holds below the contact floor (unit: of the model), and the trials that have one.

    called_nothing: of their samples; without an interval, since samples of one hold are alike.
    slips_found: of the risky events that begin in them, with the exact interval.
    """

    floor: float
    unit: str
    trials: int
    holds: int
    samples: int
    called_nothing: int
    slips_found: Share

    @property
    def share_nothing(self) -> float:
        """Share of the samples that are called nothing; a hold has a sample, so there is one."""
        return self.called_nothing / self.samples

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        return asdict(self) | {"share_called_nothing": self.share_nothing}

    def in_words(self) -> str:
        """The row as a sentence."""
        of = self.slips_found
        found = round((of.share or 0.0) * of.n)
        slips = (
            f"{found} of {count_of(of.n, 'slip')} found" if of.n else "no slip in them"
        )
        trials = in_words(self.trials, "trial")
        samples = count_of(self.samples, "sample")
        return (
            f"holds below the contact floor ({self.floor:g} {self.unit}): {self.holds} of them in "
            f"{trials}, {self.share_nothing:.3f} of {samples} called nothing, "
            f"{slips}; all other figures include them"
        )


def below_floor(
    card: ModelCard, outputs: Sequence[ModelOutputs], requests: Sequence[BoolArray]
) -> BelowFloor | None:
    """Count the holds below the floor; None where no force decides, or no hold is so light.

    requests: of each recording [T], an act is requested.
    """
    if not card.decides_by_force:
        return None
    floor = float(card.raw[CONTACT_KEY]["on"])

    trials = 0
    holds = 0
    samples = 0
    called_nothing = 0
    found: list[bool] = []
    for one, on in zip(outputs, requests, strict=True):
        light = light_holds(one.recording, floor)
        for first, stop in light:
            said = one.situation[first:stop]
            samples += len(said)
            called_nothing += int((said == NOTHING).sum())
            found += _slips_found(one.recording, on, first, stop)
        holds += len(light)
        trials += bool(light)

    if not holds:
        return None
    return BelowFloor(
        floor=floor,
        unit=card.unit,
        trials=trials,
        holds=holds,
        samples=samples,
        called_nothing=called_nothing,
        slips_found=share(found),
    )


def light_holds(recording: Recording, floor: float) -> list[tuple[int, int]]:
    """Rows [first, stop) of the holds with less force than the floor.

    A hold is a stretch of rows with any label but nothing.
    """
    label = labels_everywhere(recording.phases, len(recording.samples))
    # A row on either side, so that a hold may begin and end with the recording.
    held = np.pad(label > NOTHING, 1)
    edges = np.flatnonzero(held[1:] != held[:-1])

    light = []
    for first, stop in edges.reshape(-1, 2).tolist():
        force = _force(recording, label, first, stop)
        if force is not None and force < floor:
            light.append((first, stop))
    return light


def _force(recording: Recording, label: States, first: int, stop: int) -> float | None:
    """Length of the median of all channels in a hold; None where no sensor delivers.

    The length is what the rule judges. Medians come first: the length of noise is not 0.
    """
    rows = np.arange(first, stop)
    quiet = rows[label[first:stop] == GRASP]
    # The slip itself may pull harder than the hand holds, so it counts only where nothing else is.
    if len(quiet):
        rows = quiet

    squares = 0.0
    sensors = 0
    for sensor in range(recording.n_sensors):
        good = rows[recording.valid[rows, sensor]]
        if not len(good):
            continue
        axes = recording.samples[good, 3 * sensor : 3 * sensor + 3]
        middle = np.median(axes, axis=0)
        squares += float(middle @ middle)
        sensors += 1
    return squares**0.5 if sensors else None


def _slips_found(
    recording: Recording, requests: BoolArray, first: int, stop: int
) -> list[bool]:
    """Of each risky event that begins in the hold, whether an alarm found it."""
    found = []
    for outcome in match_alarms(recording, requests).outcomes:
        row = outcome.event.onset_s * recording.rate_hz
        # Events have times and holds have rows: a hold may begin with its event, rounded up.
        if first - 1 < row < stop:
            found.append(outcome.alarm_s is not None)
    return found
