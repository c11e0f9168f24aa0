"""The demo's pictures in the terminal: an unseen trial, its truth above the model's answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS, Prediction, Sample
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.evaluation.stream_pictures import StreamPicture, picture_of
from holdfast.training.recording import Recording

LETTERS = ".gsR"
"""nothing, grasp, safe slip, risky slip; unknown is a question mark."""
COLUMN_S = 0.2


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


def show(picture: StreamPicture) -> None:
    """Print truth, answers, and the time from load onset to the act."""
    recording = picture.recording
    truth = np.repeat(
        [phase.situation for phase in picture.phases],
        [p.stop - p.first for p in picture.phases],
    )
    step = round(COLUMN_S * recording.rate_hz)
    print(f"\n{recording.object_name}/{recording.action}")
    for name, states in (("truth", truth), ("model", picture.answer)):
        columns = (_letter(states[k : k + step]) for k in range(0, len(states), step))
        print(f"  {name}  {''.join(columns)}")
    print(f"  {_outcome(picture)}")


def _letter(states: npt.NDArray[np.int64]) -> str:
    """The riskiest state of a column, since a slip can be shorter than one."""
    riskiest = int(np.max(states))
    return "?" if riskiest == UNKNOWN else LETTERS[riskiest]


def _outcome(picture: StreamPicture) -> str:
    rate_hz = picture.recording.rate_hz
    acts_s = np.flatnonzero(picture.acts) / rate_hz
    if picture.recording.action == "pass":
        return f"hand-over: {'FALSE ALARM' if len(acts_s) else 'no alarm'}"
    onset_s, gross_s = picture.events["load_onset_s"], picture.events["gross_slip_s"]
    slipped = f"gross slip {1e3 * (gross_s - onset_s):.0f} ms after load onset"
    is_early = len(acts_s) and acts_s[0] < onset_s
    early = f"; FALSE ALARM before, at {acts_s[0]:.1f} s" if is_early else ""
    after_s = acts_s[acts_s >= onset_s]
    if not len(after_s):
        return f"{slipped}; MISSED{early}"
    delay_ms, late = (
        1e3 * (after_s[0] - onset_s),
        "" if after_s[0] <= gross_s else "LATE, ",
    )
    sample = f"a sample is {1e3 / rate_hz:.0f} ms"
    return f"{slipped}; the hand acts {late}after {delay_ms:.0f} ms ({sample}){early}"
