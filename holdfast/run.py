"""`holdfast run MODEL --source URL`: read a hand, answer every sample, until Ctrl-C or SIGTERM.

holdfast run models/holdfast-150hz.onnx --source usb://ft232h
holdfast run models/holdfast-150hz.onnx --source "virtual://ft232h?scene=pull-soft-ball&seed=1"
"""

from __future__ import annotations

import argparse
import errno
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, closing
from typing import TYPE_CHECKING, Any

from edge_runtime.command import path_argument
from edge_runtime.commands import command_port
from edge_runtime.contract import FloatArray, Prediction, Sample
from edge_runtime.errors import OutputError, RateError
from edge_runtime.fit import require_fit
from edge_runtime.live import Command, Measured, Source, Summary, run_live
from edge_runtime.monitor import GripMonitor, Model
from edge_runtime.notify import service_watchdog
from edge_runtime.sample_file import sample_file
from edge_runtime.sinks import Outlets, Sink, file_sink, stream_sink, udp_sink
from edge_runtime.tare import Tare
from edge_runtime.visible import visible
from holdfast.live_options import add_live_options, force_of, resting_of
from holdfast.live_sources import open_live
from holdfast.real_time import RunClock, first_in_line
from holdfast.stopping import output_from_the_background, stop_signals, until

if TYPE_CHECKING:
    from holdfast.view import View


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    add_live_options(parser)
    parser.add_argument(
        "--out", type=path_argument, metavar="FILE", help="JSON lines into a new file too"
    )
    parser.add_argument("--udp", metavar="HOST:PORT", help="JSON lines as datagrams too")
    parser.add_argument(
        "--commands", metavar="HOST:PORT", help="listen for the user's opening and override"
    )
    parser.add_argument(
        "--samples",
        type=path_argument,
        metavar="FILE",
        help="prepared samples into a CSV, to replay",
    )
    parser.add_argument("--quiet", action="store_true", help="no JSON lines on stdout")
    parser.add_argument(
        "--view", action="store_true", help="a picture of the stream in the terminal (needs rich)"
    )
    parser.add_argument(
        "--bias", type=path_argument, metavar="FILE", help="of holdfast bias (default: first rows)"
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="stop after so long")


PACE_READS = 3
STDOUT, STDERR = "stdout", "stderr"
READER_GONE = (errno.EPIPE, errno.EIO, errno.EBADF)
"""Errors of a standard stream that the person at its other end meant: `| head`, a closed terminal,
`>&-`."""
Emit = Callable[[Prediction, Sample, Measured], int | None]


def run(args: argparse.Namespace) -> int:
    """Run until stopped; JSON lines on stdout, what happens and the summary on stderr.

    A log that fails costs its lines and nothing else; the exit code is 5 where a file is
    incomplete.
    """
    clock, model = RunClock(), Model(args.model)
    with output_from_the_background(), closing(stream_sink(sys.stderr, STDERR)) as beside:
        summary, outlets = _run_until_stopped(args, clock, model, beside)
        say_summary(summary, beside)
    return (
        0
        if all(_reader_left(name, error) for name, error in outlets.failures.items())
        else OutputError.exit_code
    )


def _reader_left(name: str, error: OSError) -> bool:
    """Whether a person ended it: what they asked for is not incomplete."""
    return name in (STDOUT, STDERR) and error.errno in READER_GONE


def _run_until_stopped(
    args: argparse.Namespace, clock: RunClock, model: Model, beside: Sink
) -> tuple[Summary, Outlets]:
    """Everything opened, the loop, everything closed: within bounded time, also where a log takes
    nothing."""
    with ExitStack() as open_until_the_end:
        enter = open_until_the_end.enter_context
        stopped = enter(stop_signals())
        view = enter(_view(model)) if args.view else None

        def tell(text: str) -> None:
            line = visible(text)
            if view and view.drawing:
                view.tell(line)
            else:
                beside(line)

        sinks = _sinks(args, enter)
        samples = enter(sample_file(args.samples, model.card.n_channels)) if args.samples else None
        outlets = Outlets(sinks, tell, others=[samples.sink] if samples else [], watched=[beside])
        open_until_the_end.callback(outlets.close)
        command = (
            enter(command_port(args.commands, tell, clock.now_ns)) if args.commands else Command
        )
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
                tell(
                    "no --bias: the first rows count as the unloaded hand; a start under load is not noticed"
                )
            stop = until(lambda: stopped() or outlets.none_acts(), clock, args.seconds)
            summary = answer(source, model, clock, pass_on, stop, resting=resting, command=command)
        finally:
            source.close()
    summary.dropped, summary.lost_sinks = outlets.dropped, outlets.lost()
    return summary, outlets


def _sinks(
    args: argparse.Namespace, enter: Callable[[AbstractContextManager[Sink]], Sink]
) -> list[Sink]:
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
    rate_hz = card.rate_hz if source.rate_hz is None else source.rate_hz
    require_fit(
        card, n_channels=source.n_channels, unit=source.unit, rate_hz=rate_hz, where="source"
    )
    monitor = GripMonitor(model, clock.now_ns, bias_known=resting is not None)
    tare = Tare(card.preparation, card.n_channels, resting)
    require_pace(source, model, clock)
    return run_live(source, monitor, tare, clock, emit, stopped=stopped, command=command)


def require_pace(source: Source, model: Model, clock: Any) -> None:
    """Raise RateError where a hand cannot be read as often as the model wants."""
    if source.rate_hz is not None:
        return
    rate_hz, times = model.card.rate_hz, []
    for _ in range(PACE_READS):
        before_ns = clock.now_ns()
        source.read()
        times.append(1e-9 * (clock.now_ns() - before_ns))
    if min(times) * rate_hz > 1.0:
        raise RateError(
            f"a scan takes {1e3 * min(times):.1f} ms, the model wants {rate_hz:g} of them a second",
            cause="a bridge too slow for this model",
            next_step="holdfast scan says which model it serves",
        )


def _view(model: Model) -> AbstractContextManager[View]:
    from holdfast.view import viewed

    return viewed(model.card.unit)


def say_summary(summary: Summary, tell: Callable[[str], object]) -> None:
    """Counts, which logs were lost, and where the time of a sample went."""
    states = ", ".join(f"{name} {count}" for name, count in summary.states.items())
    lost = "".join(f", {count} {name}" for name, count in summary.lost().items() if count)
    tell(
        f"\n{summary.samples} samples, {summary.overruns} overruns{lost}, {summary.acts} acts; {states}"
    )
    for sink, why in summary.lost_sinks.items():
        tell(f"lost: {sink} ({why})")
    for stage, figures in summary.latency_us().items():
        tell(
            f"{stage:<14}" + "  ".join(f"{name} {value:8.1f} us" for name, value in figures.items())
        )
