"""The states of the model on whole streams: delay, stability, calibration and confusion.

Everything counts samples of labelled phases, in natural proportion. A state is the answer to a
single sample, before the decision's debounce and hold.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import CLASSES, RISKY_SLIP, SITUATIONS, BoolArray
from holdfast.data.metrics import Share, SituationFigures, situation_scores
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.alarms import EventMatch, event_scores, match_alarms
from holdfast.evaluation.formats import Spread, share
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.evaluation.trials import voluntary_actions, without_samples

if TYPE_CHECKING:
    import pandas as pd

BINS = 15
"""Equal bins of the probability, as in Guo et al. (ICML 2017)."""
States = npt.NDArray[np.int64]
"""[T] a situation at every sample; below 0 where there is none."""


@dataclass(frozen=True)
class CalibrationBin:
    """n samples in a bin. said: mean predicted probability. was: share that came true."""

    n: int
    said: float
    was: float


@dataclass(frozen=True)
class CalibrationFigures:
    """Expected calibration error of the most probable situation, and of risky_slip alone."""

    n: int
    bins: int
    ece: float
    ece_risky: float
    reliability_risky: list[CalibrationBin]


@dataclass(frozen=True)
class ConfusionFigures(SituationFigures):
    """counts: truth (rows) by answer (columns, the last unknown); F1 with intervals over groups."""

    classes: tuple[str, ...]
    counts: list[list[int]]


@dataclass(frozen=True)
class StateFigures:
    """Everything a report shows of the states. confusion: of the four situations, as "four"."""

    per: str
    to_risky_state_ms: Spread | None
    risky_state_recall: float | None
    safe_acts_state_called: Share
    unknown_share: float | None
    changes_per_s: float | None
    true_changes_per_s: float | None
    calibration: CalibrationFigures | None
    confusion: dict[str, ConfusionFigures]


def risky_states(outputs: Sequence[ModelOutputs], permille: int) -> list[EventMatch]:
    """The state itself as an alarm: risky_slip with this confidence, without debounce or hold."""
    matches = []
    for one in outputs:
        # The same confidence as the decision's, so that both differ by debounce and hold alone.
        confident = one.risky_permille >= permille
        risky = (one.situation == RISKY_SLIP) & confident
        matches.append(match_alarms(without_samples(one.recording), risky))
    return matches


def state_figures(
    outputs: Sequence[ModelOutputs],
    risky: Sequence[EventMatch],
    seed: int,
    not_learned: Collection[str] = (),
) -> StateFigures:
    """All figures of the states.

    risky: of `risky_states`. not_learned: situations that the model cannot tell.
    """
    # Matched like alarms, so the state's delay compares with that of the request.
    delay = event_scores(risky, seed=seed)
    called = []
    for one in outputs:
        for action in voluntary_actions(one.recording):
            # One risky sample is enough: it would be shown to the wearer.
            during = one.situation[action.first : action.stop]
            called.append(bool((during == RISKY_SLIP).any()))

    samples = LabelledSamples.of(outputs)
    return StateFigures(
        per="sample of a labelled phase",
        to_risky_state_ms=delay.delay_ms,
        risky_state_recall=delay.recall,
        safe_acts_state_called=share(called),
        # Of all samples, also those between labelled phases: an unknown state helps at none.
        unknown_share=float(np.mean(samples.state == UNKNOWN)),
        changes_per_s=changes_per_s(outputs, [one.situation for one in outputs]),
        true_changes_per_s=changes_per_s(outputs, [labels_of(one) for one in outputs]),
        calibration=calibration(samples),
        confusion={"four": confusion(samples, seed, not_learned)},
    )


@dataclass(frozen=True)
class LabelledSamples:
    """Every sample of some recordings. state, label [N]: UNKNOWN where there is none.

    p [N, 4]: probabilities of the situations. group [N]: what the recording is held out with.
    """

    state: States
    label: States
    p: npt.NDArray[np.float32]
    group: npt.NDArray[np.str_]

    @classmethod
    def of(cls, outputs: Sequence[ModelOutputs]) -> LabelledSamples:
        """Those of recordings, one after another."""
        lengths = [len(one.situation) for one in outputs]
        return cls(
            state=np.concatenate([one.situation for one in outputs]),
            label=np.concatenate([labels_of(one) for one in outputs]),
            p=np.concatenate([one.p_situation for one in outputs]),
            group=np.repeat([one.recording.group for one in outputs], lengths),
        )

    def where(self, rows: BoolArray) -> LabelledSamples:
        picked = [values[rows] for values in vars(self).values()]
        return LabelledSamples(*picked)


def labels_of(of: ModelOutputs) -> States:
    """[T] the true situation of every sample, UNKNOWN between labelled phases."""
    label = np.full(len(of.situation), UNKNOWN)
    for phase in of.recording.phases:
        label[phase.first : phase.stop] = phase.situation
    return label


def changes_per_s(
    outputs: Sequence[ModelOutputs], states: Sequence[States]
) -> float | None:
    """Changes a second from one known state to another. states: [T] of each recording."""
    changes = 0
    seconds = 0.0
    for one, state in zip(outputs, states, strict=True):
        # A state that comes back after an unknown stretch has not changed.
        known = state[state != UNKNOWN]
        changes += int((np.diff(known) != 0).sum())
        seconds += len(known) / one.recording.rate_hz

    return changes / seconds if seconds else None


def calibration(samples: LabelledSamples) -> CalibrationFigures | None:
    """Calibration in BINS equal bins; None without a sample that has an answer and a label.

    Guo et al., ICML 2017: sum over bins of their share of the samples times |mean probability -
    share that came true|.
    """
    answered = (samples.state != UNKNOWN) & (samples.label != UNKNOWN)
    if not answered.any():
        return None

    known = samples.where(answered)
    top = _bins(known.p.max(axis=1), known.p.argmax(axis=1) == known.label)
    # Apart: risky slips are rare, and would hardly show among the most probable situations.
    risky = _bins(known.p[:, RISKY_SLIP], known.label == RISKY_SLIP)

    return CalibrationFigures(
        n=len(known.p),
        bins=BINS,
        ece=_ece(top),
        ece_risky=_ece(risky),
        reliability_risky=risky,
    )


def _bins(
    probability: npt.NDArray[np.float32], true: BoolArray
) -> list[CalibrationBin]:
    # A probability of exactly 1 belongs to the last bin.
    bin_of = (BINS * probability).astype(np.int64)
    place = np.minimum(bin_of, BINS - 1)

    counts = np.bincount(place, minlength=BINS)
    said = np.bincount(place, weights=probability, minlength=BINS)
    was = np.bincount(place, weights=true, minlength=BINS)
    bins = []
    for n, all_said, all_was in np.stack([counts, said, was], axis=1).tolist():
        if n:
            bins.append(CalibrationBin(int(n), all_said / n, all_was / n))
    return bins


def _ece(bins: list[CalibrationBin]) -> float:
    total = sum(one.n for one in bins)
    error = 0.0
    for one in bins:
        # Weighted by samples: a nearly empty bin hardly counts.
        error += one.n / total * abs(one.said - one.was)
    return error


def confusion(
    samples: LabelledSamples, seed: int, not_learned: Collection[str] = ()
) -> ConfusionFigures:
    """Count the truth against the answer, and score it.

    Samples without a label are left out; withheld answers count.
    """
    n = len(SITUATIONS)
    labelled = samples.where(samples.label != UNKNOWN)
    # A withheld answer has a column of its own, and misses whatever was there.
    answered = np.where(labelled.state == UNKNOWN, n, labelled.state)
    pair = (n + 1) * labelled.label + answered
    cells = np.bincount(pair, minlength=n * (n + 1))

    # The interval draws whole groups, since samples of one recording are alike.
    scores = situation_scores(
        labelled.label,
        answered,
        labelled.group,
        not_learned=not_learned,
        seed=seed,
    )

    return ConfusionFigures(
        **vars(scores),
        classes=(*SITUATIONS, "unknown"),
        counts=cells.reshape(n, n + 1).tolist(),
    )


# -- as a table


def to_frame(of: Sequence[ModelOutputs]) -> pd.DataFrame:
    """The answers of `run_model`, a line a sample.

    Columns: trial_id, person, object, action, t_s, truth (None without a label), state, a p_ for
    each situation, risky_share of the votes, class (None where the model knows no weight).
    """
    import pandas as pd  # late: figures need none

    return pd.concat([_answers(one) for one in of], ignore_index=True)


def _answers(of: ModelOutputs) -> pd.DataFrame:
    import pandas as pd

    recording = of.recording
    n_rows = len(of.situation)
    # Between labelled phases there is no truth, which is None in the column.
    truth = labels_of(of)
    frame = pd.DataFrame(
        {
            "trial_id": recording.trial_id,
            "person": recording.person,
            "object": recording.object_name,
            "action": recording.action,
            "t_s": np.arange(n_rows) / recording.rate_hz,
            "truth": _named(truth, SITUATIONS, None),
            "state": _named(of.situation, SITUATIONS, "unknown"),
        }
    )
    for k, name in enumerate(SITUATIONS):
        frame[f"p_{name}"] = of.p_situation[:, k]

    # Thousandths become a share, like the probabilities next to it.
    frame["risky_share"] = of.risky_permille / 1000.0
    frame["class"] = _named(of.eight, CLASSES, None)
    return frame


def _named(
    codes: npt.NDArray[np.int64], names: Sequence[str], without: str | None
) -> npt.NDArray[np.object_]:
    """[T] names of codes; a code of -1 has none."""
    # numpy reads the index -1 from the end, where the missing name stands.
    with_none = np.array([*names, without], dtype=object)
    return with_none[codes]
