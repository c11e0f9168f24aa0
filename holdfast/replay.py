"""`holdfast replay MODEL TRIAL`: what the hand would have said, one JSON line a sample."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from drivers.replay import Replay, open_replay
from edge_runtime.errors import DataNotFound
from edge_runtime.fit import require_fit
from edge_runtime.monitor import GripMonitor, Model
from edge_runtime.output import to_json_line

SCHEME = "replay://"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    parser.add_argument(
        "trial", metavar="TRIAL", help="a trial's CSV or folder, or SET#N: trial N (or its name) of a data set"
    )


def run(args: argparse.Namespace) -> int:
    """Replay the whole trial to stdout."""
    model = Model(args.model)
    source = open_trial(args.trial, model)
    monitor = GripMonitor(model, clock := ReplayClock())
    for sample in source:
        clock.at(sample.t_ns)
        sys.stdout.write(to_json_line(monitor.feed(sample)) + "\n")
    return 0


def open_trial(trial: str, model: Model) -> Replay:
    """A prepared stream that fits the model. Raises a DataError."""
    name = trial.removeprefix(SCHEME)
    from_set = "#" in name and not Path(name).exists()
    source = _from_set(name, model) if from_set else open_replay(name)
    require_fit(model.card, n_channels=source.values.shape[1], unit=source.unit, rate_hz=source.rate_hz, where=trial)
    return source if from_set else source.prepared(model.card.preparation)


class ReplayClock:
    """Recorded time plus the time since the sample was handed in: latency is what computing really took."""

    def __init__(self) -> None:
        self.at(0)

    def at(self, t_ns: int) -> None:
        """The sample recorded at t_ns is handed in now."""
        self._offset_ns = t_ns - time.perf_counter_ns()

    def __call__(self) -> int:
        return time.perf_counter_ns() + self._offset_ns


def _from_set(name: str, model: Model) -> Replay:
    """SET#N: sets come prepared from their reader."""
    from training.datasets import load

    folder, _, chosen = name.rpartition("#")
    data = load(folder, channels=model.card.n_channels, balanced=False)
    names = [recording.trial_id for recording in data.recordings]
    index = names.index(chosen) if chosen in names else int(chosen) if chosen.isdecimal() else len(names)
    if index >= len(names):
        raise DataNotFound(
            f"no trial {chosen!r} among {len(names)}",
            where=folder,
            next_step=f"give 0..{len(names) - 1} or {names[0]!r}",
        )
    recording = data.recordings[index]
    t_ns = np.round(np.arange(len(recording.samples)) / recording.rate_hz * 1e9).astype(np.int64)
    return Replay(t_ns, recording.samples, recording.valid, recording.rate_hz, recording.unit)
