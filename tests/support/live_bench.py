"""The live loop on a source that comes steadily, on a virtual clock, or with a hand in a scene."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
import pytest

from holdfast.core.contract import Prediction, Sample
from holdfast.core.source import SourceReading
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.monitor import Model
from holdfast.live.grip import GripOutput
from holdfast.live.loop import Summary
from holdfast.live.outputs import Output, close_at_end, emit_to
from holdfast.live.run import answer
from holdfast.live.sources import open_live

ROOT = Path(__file__).resolve().parents[2]
AnyOutput = TypeVar("AnyOutput", bound=Output)
DEFAULT = ROOT / "models" / "holdfast-150hz.onnx"
# of fewer trees, quicker to open
TINY = ROOT / "models" / "holdfast-150hz-tiny.onnx"


RUN = [
    sys.executable,
    "-m",
    "holdfast",
    "run",
    str(TINY),
    "--source",
    "virtual://ft232h",
]
"""The command line on the tiny model and a virtual hand at rest."""


@pytest.fixture(scope="session")
def model() -> Model:
    """The default model, opened once."""
    return Model(DEFAULT)


def free_port() -> int:
    """A UDP port that nothing on this machine uses."""
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def closing_output(output: AnyOutput) -> Iterator[AnyOutput]:
    """An output that is closed as a run closes it."""
    with ExitStack() as stack:
        close_at_end(stack, output)
        yield output


class Steady:
    """A source of noise that takes no time, but for stalls: {reading: seconds}."""

    unit, n_channels, rate_hz = "N", 18, None

    def __init__(
        self, clock: VirtualClock, n: int, stalls: dict[int, float] | None = None
    ) -> None:
        self.clock, self.n, self.stalls, self.k = clock, n, stalls or {}, 0
        self.times: list[int] = []

    def read(self) -> SourceReading | None:
        if self.k == self.n:
            return None
        self.times.append(self.clock.now_ns())
        self.clock.spend(round(1e9 * self.stalls.get(self.k, 0.0)))
        self.k += 1
        values = 0.02 * np.random.default_rng(self.k).normal(size=18)
        return SourceReading(self.times[-1], values, np.ones(6, dtype=np.bool_))

    def close(self) -> None:
        pass


def go(
    model: Model, source: Any, clock: VirtualClock, **options: Any
) -> tuple[Summary, list[Prediction], list[Sample]]:
    answered: list[tuple[Prediction, Sample]] = []
    summary = answer(
        source,
        model,
        clock,
        lambda prediction, sample, measured: answered.append((prediction, sample)),
        options.pop("stopped", lambda: False),
        **options,
    )
    return summary, [one for one, _ in answered], [one for _, one in answered]


def run_on(
    grip: GripOutput,
    model: Model,
    url: str,
    seconds: float,
    clock: Any = None,
    each: Callable[..., object] = lambda *_: None,
) -> int:
    """Run on virtual time; returns the number of samples. each: called after every answer."""
    clock = clock or VirtualClock()
    source = open_live(url, clock=clock, report=lambda line: None, field=grip.scene)
    end_ns = clock.now_ns() + round(1e9 * seconds)
    grip.begin(source)
    summary = answer(
        source,
        model,
        clock,
        emit_to([grip, SimpleNamespace(write=each)]),
        lambda: clock.now_ns() >= end_ns,
    )
    return summary.samples
