"""The demo's pictures in the terminal: an unseen trial, its truth above the model's answers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from examples.demo.demo_stream import StreamPicture, picture_of
from holdfast.core.contract import RISKY_SLIP, SAFE_SLIP, SITUATIONS, Prediction, Sample
from holdfast.data.recording import Recording
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.monitor import GripMonitor, Model

LETTERS = ".gsR"
"""nothing, grasp, safe slip, risky slip; unknown is a question mark."""
COLUMN_S = 0.02
SHOWN_S = (-0.3, 0.7)
"""What is printed, from the beginning of the slip."""
LEGEND = f"""
two unseen trials as the shipped model answers them; a letter is {1e3 * COLUMN_S:.0f} ms:
  . empty hand   g grasp   s safe slip (meant)   R risky slip (not meant)   ! the alarm begins"""
SLIPS = ("fall",)
MEANING = {"pass": "handed over", "fall": "slips out"}
"""What happens in each action."""


def watch(model: Model, folder: Path, recording: Recording) -> StreamPicture:
    """Feed a trial to the edge runtime sample by sample."""
    monitor = GripMonitor(model, None)
    t_ns = (
        np.round(1e9 * np.arange(len(recording.samples)) / recording.rate_hz)
        .astype(np.int64)
        .tolist()
    )
    samples = zip(t_ns, recording.samples, recording.valid, strict=True)
    answers = [
        monitor.feed(Sample(t, row, valid, k))
        for k, (t, row, valid) in enumerate(samples)
    ]
    acts = np.array([answer.act for answer in answers])
    return picture_of(
        folder, recording, np.array([_situation(answer) for answer in answers]), acts
    )


def _situation(answer: Prediction) -> int:
    return SITUATIONS.index(answer.state) if answer.state in SITUATIONS else UNKNOWN


def show(one: StreamPicture) -> None:
    """Print truth, answers and alarms about the slip of a trial."""
    truth = np.repeat(
        [phase.situation for phase in one.phases],
        [phase.stop - phase.first for phase in one.phases],
    )
    meaning = MEANING[str(one.recording.action)]
    answered = list(_letters(one, one.answer))
    for k, acts in enumerate(_columns(one, _begin(one.acts))):
        answered[k] = "!" if acts.any() else answered[k]
    print(f"{one.recording.object_name}, {meaning}: {_right(one)}")
    print(f"  truth  {_letters(one, truth)}")
    print(f"  model  {''.join(answered)}  {_outcome(one)}")


def _begin(acts: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """The first sample of each alarm."""
    return acts & ~np.concatenate(([False], acts[:-1]))


def _columns(
    picture: StreamPicture, values: npt.NDArray[Any]
) -> list[npt.NDArray[Any]]:
    """The samples of each column of what is shown."""
    rate_hz = picture.recording.rate_hz
    borders_s = np.arange(SHOWN_S[0], SHOWN_S[1] + COLUMN_S / 2, COLUMN_S)
    borders = _begins(picture) + np.round(borders_s * rate_hz).astype(int)
    return np.split(values, borders)[1:-1]


def _letters(picture: StreamPicture, states: npt.NDArray[np.int64]) -> str:
    """Of each column the state that lasts longest in it."""
    lasts = [
        np.bincount(one - UNKNOWN).argmax() + UNKNOWN
        for one in _columns(picture, states)
    ]
    return "".join("?" if one == UNKNOWN else LETTERS[one] for one in lasts)


def _begins(picture: StreamPicture) -> int:
    """The sample at which the object begins to move in the hand."""
    slips = (SAFE_SLIP, RISKY_SLIP)
    return next(phase.first for phase in picture.phases if phase.situation in slips)


def _right(picture: StreamPicture) -> str:
    """What the model should do."""
    if picture.recording.action not in SLIPS:
        return "it should give no alarm"
    events = picture.events
    slides_ms = 1e3 * (events["gross_slip_s"] - events["load_onset_s"])
    return f"it should alarm within {slides_ms:.0f} ms, before all fingers slide"


def _outcome(picture: StreamPicture) -> str:
    acts_s = np.flatnonzero(picture.acts) / picture.recording.rate_hz
    if picture.recording.action not in SLIPS:
        return "FALSE ALARM" if len(acts_s) else "no alarm"

    onset_s = picture.events["load_onset_s"]
    if (acts_s < onset_s).any():
        return "FALSE ALARM before"
    if not len(acts_s):
        return "MISSED"
    after_ms = 1e3 * (acts_s[0] - onset_s)
    late = "" if acts_s[0] <= picture.events["gross_slip_s"] else ", LATE"
    return f"alarm after {after_ms:.0f} ms{late}"
