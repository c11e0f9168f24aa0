"""`holdfast run MODEL --source URL`: read a hand, answer every sample, until Ctrl-C or SIGTERM.

    holdfast run models/holdfast-150hz.onnx --source usb://ft232h
    holdfast run models/holdfast-150hz.onnx --source "virtual://ft232h?scene=pull-soft-ball&seed=1"
"""

from __future__ import annotations

import argparse
import errno
import os
import signal
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edge_runtime.clock import MonotonicClock
from edge_runtime.command import path_argument
from edge_runtime.commands import command_port
from edge_runtime.contract import RATE_TOLERANCE, FloatArray, Prediction, Sample
from edge_runtime.errors import ChannelError, OutputError, RateError, UnitError
from edge_runtime.live import Command, Measured, Source, Summary, run_live
from edge_runtime.monitor import GripMonitor, Model
from edge_runtime.notify import service_watchdog
from edge_runtime.priority import real_time
from edge_runtime.sample_file import sample_file
from edge_runtime.sinks import Outlets, Sink, file_sink, stream_sink, udp_sink
from edge_runtime.tare import Tare
from holdfast.live_sources import open_live

if TYPE_CHECKING:
    from holdfast.view import View


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    parser.add_argument("--source", required=True, metavar="URL", help="usb://ft232h, i2c://1, virtual://ft232h?scene=..")
    parser.add_argument("--out", type=path_argument, metavar="FILE", help="JSON lines into a new file too")
    parser.add_argument("--udp", metavar="HOST:PORT", help="JSON lines as datagrams too")
    parser.add_argument("--commands", metavar="HOST:PORT", help="listen for the user's opening and override")
    parser.add_argument("--samples", type=path_argument, metavar="FILE", help="prepared samples into a CSV, to replay")
    parser.add_argument("--quiet", action="store_true", help="no JSON lines on stdout")
    parser.add_argument("--view", action="store_true", help="a picture of the stream in the terminal (needs rich)")
    parser.add_argument("--calibration", type=path_argument, metavar="FILE", help="field to force, made by calibrate")
    parser.add_argument("--bias", type=path_argument, metavar="FILE", help="of holdfast bias (default: first rows)")
    parser.add_argument("--seconds", type=float, metavar="S", help="stop after so long")


PACE_READS = 3
STDOUT, STDERR = "stdout", "stderr"
READER_GONE = (errno.EPIPE, errno.EIO, errno.EBADF)
"""Errors of a standard stream that the person at its other end meant: `| head`, a closed terminal, `>&-`."""
Emit = Callable[[Prediction, Sample, Measured], int | None]


class RunClock(MonotonicClock):
    """Real time, which a virtual hand's transfers spend by waiting."""

    def spend(self, duration_ns: int) -> None:
        """Let time pass."""
        self.wait_until(self.now_ns() + duration_ns)


def run(args: argparse.Namespace) -> int:
    """Run until stopped; JSON lines on stdout, what happens and the summary on stderr.

    A log that fails costs its lines and nothing else; the exit code is 5 where a file is incomplete.
    """
    clock, model = RunClock(), Model(args.model)
    with output_from_the_background(), closing(stream_sink(sys.stderr, STDERR)) as beside:
        summary, outlets = _run_until_stopped(args, clock, model, beside)
        say_summary(summary, beside)
    return 0 if all(_reader_left(name, error) for name, error in outlets.failures.items()) else OutputError.exit_code


def _reader_left(name: str, error: OSError) -> bool:
    """Whether a person ended it: what they asked for is not incomplete."""
    return name in (STDOUT, STDERR) and error.errno in READER_GONE


def _run_until_stopped(
    args: argparse.Namespace, clock: RunClock, model: Model, beside: Sink
) -> tuple[Summary, Outlets]:
    """Everything opened, the loop, everything closed: within bounded time, also where a log takes nothing."""
    with ExitStack() as open_until_the_end:
        enter = open_until_the_end.enter_context
        stopped = enter(stop_signals())
        view = enter(_view(model)) if args.view else None

        def tell(line: str) -> None:
            if view and view.drawing:
                view.tell(line)
            else:
                beside(line)

        sinks = _sinks(args, enter)
        samples = enter(sample_file(args.samples, model.card.n_channels)) if args.samples else None
        outlets = Outlets(sinks, tell, others=[samples.sink] if samples else [], watched=[beside])
        open_until_the_end.callback(outlets.close)
        command = enter(command_port(args.commands, tell, clock.now_ns)) if args.commands else Command
        alive = enter(service_watchdog())

        def pass_on(prediction: Prediction, sample: Sample, measured: Measured) -> int:
            dropped = outlets.emit(prediction)
            if samples:
                dropped += not samples.write(sample)
            if view:
                view.show(prediction, sample, measured)
            alive(prediction.t_decided_ns)
            return dropped

        source = open_live(args.source, clock=clock, say=tell, to_force=force_of(args.calibration))
        enter(first_in_line(tell))
        try:
            resting = resting_of(args.bias, source)
            if resting is None:
                tell("no --bias: the first rows count as the unloaded hand; a start under load is not noticed")
            stop = until(lambda: stopped() or outlets.none_acts(), clock, args.seconds)
            summary = answer(source, model, clock, pass_on, stop, resting=resting, command=command)
        finally:
            source.close()
    summary.dropped, summary.lost_sinks = outlets.dropped, outlets.lost()
    return summary, outlets


def _sinks(args: argparse.Namespace, enter: Callable[[AbstractContextManager[Sink]], Sink]) -> list[Sink]:
    """Where the predictions go."""
    sinks = [] if args.quiet else [enter(closing(stream_sink(sys.stdout, STDOUT)))]
    sinks += [enter(file_sink(args.out, "--out"))] if args.out else []
    sinks += [enter(udp_sink(args.udp))] if args.udp else []
    return sinks


def answer(
    source: Source,
    model: Model,
    clock: Any,
    emit: Emit,
    stopped: Callable[[], bool],
    *,
    resting: FloatArray | None = None,
    command: Callable[[], Command] = Command,
) -> Summary:
    """The live loop on a source that fits the model. Raises ChannelError, UnitError, RateError."""
    card = model.card
    if source.n_channels != card.n_channels:
        raise ChannelError(
            f"{source.n_channels} channels, the model wants {card.n_channels}", next_step="another layout or model"
        )
    if source.unit != card.unit:
        raise UnitError(
            f"the source is in {source.unit}, the model wants {card.unit}", cause="a hand without its calibration",
            next_step="holdfast calibrate, then --calibration FILE",
        )  # fmt: skip
    monitor = GripMonitor(model, clock.now_ns, bias_known=resting is not None)
    tare = Tare(card.preparation, card.n_channels, resting)
    require_pace(source, model, clock)
    return run_live(source, monitor, tare, clock, emit, stopped=stopped, command=command)


def require_pace(source: Source, model: Model, clock: Any) -> None:
    """Raise RateError where a recording has another rate than the model, or a hand cannot be read so often."""
    rate_hz = model.card.rate_hz
    if source.rate_hz is not None:
        if abs(source.rate_hz / rate_hz - 1.0) > RATE_TOLERANCE:
            raise RateError(
                f"{source.rate_hz:g} Hz, the model wants {rate_hz:g} Hz", next_step="use a model made for this rate"
            )
        return
    times = []
    for _ in range(PACE_READS):
        before_ns = clock.now_ns()
        source.read()
        times.append(1e-9 * (clock.now_ns() - before_ns))
    if min(times) * rate_hz > 1.0:
        raise RateError(
            f"a scan takes {1e3 * min(times):.1f} ms, the model wants {rate_hz:g} of them a second",
            cause="a bridge too slow for this model", next_step="holdfast scan says which model it serves",
        )  # fmt: skip


def resting_of(path: Path | None, source: Source) -> FloatArray | None:
    """A bias file [C] that fits the source, or None. Raises a DataError."""
    if path is None:
        return None
    from drivers.calibration import read_bias

    bias = read_bias(path)
    if bias.unit != source.unit or len(bias.values) != source.n_channels:
        raise UnitError(
            f"{len(bias.values)} channels in {bias.unit}, the source has {source.n_channels} in {source.unit}",
            where=path, cause="taken with another calibration or hand", next_step="holdfast bias again",
        )  # fmt: skip
    return bias.values


def force_of(path: Path | None) -> Callable[[FloatArray], FloatArray] | None:
    """A calibration file as what it does, or None. Raises a DataError."""
    if path is None:
        return None
    from drivers.calibration import read_calibration

    return read_calibration(path).apply


def _view(model: Model) -> AbstractContextManager[View]:
    from holdfast.view import viewed

    return viewed(model.card.unit)


@contextmanager
def first_in_line(say: Callable[[str], None]) -> Iterator[bool]:
    """Real-time priority, or one line that there is none."""
    with real_time() as allowed:
        if not allowed:
            say("usual priority: other programs can delay a sample; holdfast doctor says how to allow real time")
        yield allowed


def until(stopped: Callable[[], bool], clock: Any, seconds: float | None) -> Callable[[], bool]:
    """Stopped by a signal, or after so many seconds."""
    end_ns = None if seconds is None else clock.now_ns() + round(1e9 * seconds)
    return lambda: stopped() or (end_ns is not None and clock.now_ns() >= end_ns)


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """SIGINT, SIGTERM and SIGHUP ask to stop after the sample under way; a second one has its usual effect.

    Not so SIGHUP, which comes twice where an SSH connection drops, from the shell and from the system; under nohup it
    is left ignored. A terminal that is gone with it is replaced by nothing: a word to it would be an error.
    """
    asked = False
    terminals = [handle for handle in (0, 1, 2) if os.isatty(handle)]

    def ask(number: int, frame: object) -> None:
        nonlocal asked
        asked = True
        if number == signal.SIGHUP:
            _let_go(terminals)
        else:
            signal.signal(number, before[number])

    under_nohup = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    wanted = (signal.SIGINT, signal.SIGTERM) if under_nohup else (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before: dict[int, Any] = {number: signal.signal(number, ask) for number in wanted}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def output_from_the_background() -> Iterator[None]:
    """Write to a terminal also where it stops programs in its background that do (`stty tostop`), whole programs."""
    before = signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGTTOU, before)


def _let_go(terminals: list[int]) -> None:
    """Lead the descriptors of terminals that are gone to /dev/null; those still there stay as they are."""
    for handle in terminals:
        try:
            termios.tcgetattr(handle)
        except termios.error:
            nothing = os.open(os.devnull, os.O_RDWR)
            os.dup2(nothing, handle)
            os.close(nothing)


def say(line: str) -> None:
    """What happens, beside the answers."""
    sys.stderr.write(line + "\n")


def say_summary(summary: Summary, tell: Callable[[str], object]) -> None:
    """Counts, which logs were lost, and where the time of a sample went."""
    states = ", ".join(f"{name} {count}" for name, count in summary.states.items())
    lost = "".join(f", {count} {name}" for name, count in summary.lost().items() if count)
    tell(f"\n{summary.samples} samples, {summary.overruns} overruns{lost}, {summary.acts} acts; {states}")
    for sink, why in summary.lost_sinks.items():
        tell(f"lost: {sink} ({why})")
    for stage, figures in summary.latency_us().items():
        tell(f"{stage:<14}" + "  ".join(f"{name} {value:8.1f} us" for name, value in figures.items()))
