"""An hour of a live run in which every second something fails: nothing is lost, nothing released.

Each second has a fault of the virtual hand, a signal, a pause of the whole process, a full disk, or
a datagram of anybody to the port of the wearer's commands; drawn by a seed. Signals that end a run
end it, and the next life begins at once. After every sample the laws of Witness must hold, and the
memory of the process may not grow: a line is fitted, and its slope is within the noise.

HOLDFAST_SOAK_S=600 makes the hour ten minutes. The tests play a part of it on a virtual clock.
`pytest -s` prints the figures.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import resource
import signal
import socket
import subprocess
import sys
from collections import Counter
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hazard_marks import TROUBLE_EVERY_SECOND

from holdfast.core.contract import GripCommand, Prediction
from holdfast.core.source import Source, SourceReading
from holdfast.drivers.virtual.faults import KINDS, OF_A_SENSOR, VirtualClock
from holdfast.drivers.virtual.virtual_hand import Track
from holdfast.edge_runtime.model import Model
from holdfast.live.grip import controller_for, open_grip
from holdfast.live.loop import Summary
from holdfast.live.outputs import LineOutput, Output, close_at_end, emit_to, file_sink
from holdfast.live.run import answer
from holdfast.live.running import stop_signals
from holdfast.live.scene import SceneClock, Still, field_of
from holdfast.live.sources import open_live, source_url
from holdfast.live.wearer import wearer_monitor

SOAK_S = float(os.environ.get("HOLDFAST_SOAK_S", "3600"))
SEED = int(os.environ.get("HOLDFAST_SOAK_SEED", "1"))
SHORT_S, SHORT_EVERY_S = 6.0, 0.12
"""Of the virtual clock, which the tests have time for: eight troubles a second."""
LIFE_TROUBLES = (4.0, 16.0)
"""How long a run lasts until a signal ends it, in times between two troubles."""
KINDS_OF_TROUBLE = ("fault", "fault", "signal", "pause", "full disk", "datagram")
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
HARMLESS = (
    signal.SIGWINCH,
    signal.SIGCONT,
    signal.SIGCHLD,
    signal.SIGURG,
    signal.SIGPIPE,
)
PAUSE_S = 0.05
DATAGRAMS = (
    b"",
    b"{}",
    b"1",
    b"null",
    b"[" * 900,
    b"\x00\xff" * 500,
    b'{"wants": "open"}',
    b'{"wants": "stop"}',
    b'{"wants": "override"}',
    b'{"wants": 1}',
    b'{"wants": "open", "wants": "stop"}',
    b'{"t_ns": 9223372036854775808, "target_n": 500}',
    b'{"wants": Infinity}',
)
WARM = 0.2
"""Share of a soak in which memory may still grow: caches fill, rings are laid out."""
NOISE_MB, SHORT_NOISE_MB = 1.0, 4.0
"""Of a process's resident memory: an arena of libc more or less; and while caches still fill."""


class Looping:
    """A recorded field again and again: the hand closes, holds, is pulled and opens."""

    def __init__(self, track: Track) -> None:
        self._track = track
        self.n_sensors = track.n_sensors
        self._lasts_s = float(track.t_s[-1])

    def at(self, now_s: float, sensor: int) -> list[float]:
        return self._track.at(now_s % self._lasts_s, sensor)


class Untimed:
    """A source whose readings take no time: an emulated hand costs more than a real one does."""

    def __init__(self, source: Source, still: Still) -> None:
        self._source, self._still = source, still
        self.unit, self.n_channels = source.unit, source.n_channels
        self.rate_hz = source.rate_hz

    def read(self) -> SourceReading | None:
        with self._still():
            reading: SourceReading | None = self._source.read()
            return reading

    def close(self) -> None:
        self._source.close()


@dataclass
class Witness:
    """Sees every answer and every command, and holds them against the laws.

    arrived: sequence numbers of the commands that came by the link in this life. unknown: answers
    with an unknown state.
    """

    receiver: socket.socket
    arrived: list[int] = field(default_factory=list)
    sequences: list[int] = field(default_factory=list)
    unknown: int = 0
    last_mode: str = ""
    _target_n: float | None = None
    _acted: bool = False

    def write(
        self,
        prediction: Prediction,
        sample: object,
        reading: object,
        command: GripCommand | None,
    ) -> None:
        """One answer: an unknown state ends no request and lets nothing go."""
        assert command is not None
        wearer = prediction.opening or prediction.overridden
        if prediction.state == "unknown":
            self.unknown += 1
            if not wearer:
                assert command.mode == "hold"
                assert command.target_n == self._target_n
                assert prediction.act == self._acted
        self._target_n = command.target_n
        self._acted = prediction.act
        self.sequences.append(prediction.sequence)
        self.receive()

    def receive(self) -> None:
        """Wait for the next line on the link."""
        line = json.loads(self.receiver.recv(4096))
        self.arrived.append(line["sequence"])
        self.last_mode = line["mode"]

    def close(self, reason: str = "") -> None:
        """Nothing to close."""


class Trouble:
    """An output that makes trouble every soak.every_s, and ends the life at its time."""

    def __init__(self, soak: Soak, log: Path, port: Path, life_s: float) -> None:
        self._soak, self._log, self._port = soak, log, port
        self._begin_ns = soak.clock.now_ns()
        self._next_s, self._life_s = soak.every_s, life_s
        self._sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._sender.setblocking(False)
        self.disk_is_full = False

    def faults(self) -> str:
        """Those of this life, for the URL of its hand."""
        rng, words, every_s = self._soak.rng, [], self._soak.every_s
        for turn in range(1, int(self._life_s / every_s)):
            if rng.choice(KINDS_OF_TROUBLE) == "fault":
                kind = str(rng.choice(list(KINDS)))
                at_s = every_s * (turn + rng.uniform(0.0, 0.9))
                of = f":{rng.integers(1, 7)}" if kind in OF_A_SENSOR else ""
                words.append(
                    f"&fault={kind}{of}@{at_s:.3f}%2B{rng.uniform(0.01, 0.4):.3f}"
                )
                self._soak.done["fault"] += 1
        return "".join(words)

    def write(
        self,
        prediction: object,
        sample: object,
        reading: object = None,
        command: object = None,
    ) -> None:
        """One sample: whether it is time for the next trouble."""
        passed_s = 1e-9 * (self._soak.clock.now_ns() - self._begin_ns)
        if passed_s >= self._life_s:
            signal.raise_signal(self._soak.rng.choice(ENDING))
            self._soak.done["ending signal"] += 1
            self._life_s = float("inf")
        elif passed_s >= self._next_s:
            self._next_s += self._soak.every_s
            kind = str(self._soak.rng.choice(KINDS_OF_TROUBLE[2:]))
            self._soak.done[kind] += 1
            self._make(kind)

    def _make(self, kind: str) -> None:
        rng = self._soak.rng
        if kind == "signal":
            signal.raise_signal(rng.choice(HARMLESS))
        elif kind == "pause":
            self._soak.pause()
        elif kind == "datagram":
            for _ in range(int(rng.choice([1, 3, 60]))):
                data = DATAGRAMS[rng.integers(len(DATAGRAMS))]
                with suppress(BlockingIOError):
                    self._sender.sendto(data, str(self._port))
        elif kind == "full disk" and not self.disk_is_full:
            self._fill_disk()

    def _fill_disk(self) -> None:
        """From now on the log's descriptor is one on which every write finds no room."""
        for handle in Path("/proc/self/fd").iterdir():
            with suppress(OSError):
                if handle.readlink() == self._log:
                    full = os.open("/dev/full", os.O_WRONLY)
                    os.dup2(full, int(handle.name))
                    os.close(full)
                    self.disk_is_full = True

    def close(self, reason: str = "") -> None:
        self._sender.close()


class Soak:
    """Lives of a run, one after another, until the time is over."""

    def __init__(self, model: Model, clock: Any, folder: Path, every_s: float) -> None:
        self.model, self.clock, self._folder = model, clock, folder
        self.every_s = every_s
        self.rng = np.random.default_rng(SEED)
        self.done: Counter[str] = Counter()
        self.memory: list[tuple[float, float]] = []
        self.samples = self.overruns = self.unknown = self.lives = 0
        self._begin_ns = clock.now_ns()
        url = "virtual://ft232h?scene=pull-soft-ball&seed=1"
        self._field = Looping(field_of(source_url(url), lambda line: None))

    def passed_s(self) -> float:
        return 1e-9 * (self.clock.now_ns() - self._begin_ns)

    def note_memory(self) -> None:
        """What is in use between two lives, MB: what libc keeps in reserve is given back first."""
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
        self.memory.append((self.passed_s(), pages * resource.getpagesize() / 2**20))

    def pause(self) -> None:
        """The machine does nothing else for a while; on the real clock, by SIGSTOP."""
        if isinstance(self.clock, VirtualClock):
            self.clock.spend(round(1e9 * PAUSE_S))
        else:
            script = (
                f"kill -STOP {os.getpid()}; sleep {PAUSE_S}; kill -CONT {os.getpid()}"
            )
            subprocess.run(["sh", "-c", script], check=True)

    def live(self) -> None:
        """One run, from its start to the signal that ends it."""
        life_s = self.every_s * float(self.rng.uniform(*LIFE_TROUBLES))
        log, port = self._folder / f"life-{self.lives}.jsonl", self._folder / "commands"
        with ExitStack() as stack:
            wire = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            hand_path = self._folder / "grip"
            hand_path.unlink(missing_ok=True)
            wire.bind(str(hand_path))
            wire.settimeout(60.0)
            stopped = stack.enter_context(stop_signals())
            lines = LineOutput([file_sink(log)], lambda line: None)
            close_at_end(stack, lines)
            trouble = Trouble(self, log, port, life_s)
            close_at_end(stack, trouble)
            wearer = stack.enter_context(
                wearer_monitor(f"unix://{port}", self.clock, lambda line: None)
            )
            control = controller_for("holdfast", self.model.card, lambda line: None)
            url = f"unix://{hand_path}"
            rate_hz = self.model.card.rate_hz
            grip = open_grip(url, control, rate_hz, "", self.clock, lambda line: None)
            close_at_end(stack, grip)
            witness = Witness(wire)
            # one seed: the emulated chips keep their noise, 3 MB, which is no memory of the run
            hand = open_live(
                f"virtual://ft232h?seed=1{trouble.faults()}",
                clock=self.clock,
                report=lambda line: None,
                field=self._field,
            )
            stack.callback(hand.close)
            still = getattr(self.clock, "still", nullcontext)
            source = Untimed(hand, still)
            grip.begin(source)
            outputs: list[Output] = [grip, lines, witness, trouble]
            summary = answer(
                source,
                self.model,
                self.clock,
                emit_to(outputs, lambda: grip.newest),
                stopped,
                command=wearer.command,
            )
            grip.close()
            lines.close(wait_s=60.0)
            witness.receive()
        self._judge(summary, witness, lines, log, trouble.disk_is_full)

    def _judge(
        self,
        summary: Summary,
        witness: Witness,
        lines: LineOutput,
        log: Path,
        disk_is_full: bool,
    ) -> None:
        """Nothing is lost that is not counted, and the last command of every life is hold."""
        n = summary.samples
        assert len(witness.sequences) == n
        # every turn up to the last answer was answered, or counted as an overrun
        unanswered = witness.sequences[-1] + 1 - n
        assert unanswered <= summary.overruns
        assert witness.arrived[:n] == witness.sequences
        assert witness.last_mode == "hold"
        written = log.read_text("utf-8").split("\n")
        assert written.pop() == ""
        sequences = [json.loads(line)["sequence"] for line in written]
        assert sequences == witness.sequences[: len(sequences)]
        # a log that has failed is not offered lines any more
        assert bool(lines.failures) == disk_is_full
        assert disk_is_full or (len(sequences), lines.dropped) == (n, 0)
        log.unlink()
        self.samples += n
        self.overruns += summary.overruns
        self.unknown += witness.unknown
        self.lives += 1
        self.note_memory()

    def growth_mb(self) -> tuple[float, float]:
        """(growth over the soak by the fitted line, three standard errors of it)."""
        points = np.array(self.memory)
        points = points[points[:, 0] >= WARM * points[-1, 0]]
        (slope, _), covariance = np.polyfit(points[:, 0], points[:, 1], 1, cov=True)
        spans_s = points[-1, 0] - points[0, 0]
        return slope * spans_s, 3.0 * float(np.sqrt(covariance[0, 0])) * spans_s


@TROUBLE_EVERY_SECOND.mark
@pytest.mark.parametrize(
    ("seconds", "every_s", "clock"),
    [
        pytest.param(SHORT_S, SHORT_EVERY_S, VirtualClock, id="virtual clock"),
        pytest.param(SOAK_S, 1.0, SceneClock, id="real clock", marks=pytest.mark.soak),
    ],
)
def test_trouble_every_second_loses_nothing_and_releases_nothing(
    model: Model, tmp_path: Path, seconds: float, every_s: float, clock: Any
) -> None:
    soak = Soak(model, clock(), tmp_path, every_s)
    while soak.passed_s() < seconds:
        soak.live()
    growth_mb, error_mb = soak.growth_mb()
    sys.stdout.write(
        f"seed {SEED}, {soak.passed_s():.0f} s, {soak.lives} lives, {soak.samples} samples, "
        f"{soak.overruns} overruns, {soak.unknown} unknown; {dict(soak.done)}; memory grew by "
        f"{growth_mb:.2f} MB (three standard errors: {error_mb:.2f}), "
        f"{soak.memory[0][1]:.0f} to {soak.memory[-1][1]:.0f} MB\n"
    )
    noise_mb = SHORT_NOISE_MB if clock is VirtualClock else NOISE_MB
    assert growth_mb <= max(error_mb, noise_mb)
