"""Figures of eflesh_slip as `make real` writes them: windows, trials, and how late alarms come."""

from __future__ import annotations

from dataclasses import dataclass

from holdfast.edge_runtime.reading import Json
from holdfast.training.datasets.eflesh_slip import ThresholdAccuracy
from holdfast.training.figures import Interval


@dataclass(frozen=True)
class DelaySpread:
    """Delay of n alarms after the field departs, s; None without an alarm."""

    n: int
    p5: float | None
    p50: float | None
    p95: float | None


@dataclass(frozen=True)
class EfleshFigures:
    """Figures with blocks of neighbouring trials held out. Accuracies and F1 are from 0 to 1.

    delay_s, held_trials_with_an_alarm: by the name of the detector.
    """

    n_trials: int
    n_groups: int
    window_accuracy: float
    f1: dict[str, float | None]
    f1_ci: dict[str, Interval | None]
    trial_vote_accuracy: float
    one_threshold: ThresholdAccuracy
    delay_s: dict[str, DelaySpread]
    held_trials_with_an_alarm: dict[str, str]
    caveat: str

    @staticmethod
    def from_json(written: Json) -> EfleshFigures:
        """Read what `asdict` gave. Raises KeyError or TypeError where a figure is missing."""
        delays = {name: DelaySpread(**one) for name, one in written["delay_s"].items()}
        threshold = ThresholdAccuracy(**written["one_threshold"])
        return EfleshFigures(**written | {"delay_s": delays, "one_threshold": threshold})
