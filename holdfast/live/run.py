"""A live run from its opened outputs to its summary: the body of `holdfast run`.

A log that fails costs its lines and nothing else; the exit code is 5 where a file is incomplete.
"""

from __future__ import annotations

import argparse
import errno
import sys
from collections.abc import Callable, Iterator
from contextlib import (
    AbstractContextManager,
    ExitStack,
    closing,
    contextmanager,
    nullcontext,
)
from typing import TYPE_CHECKING, Any

from holdfast.cli.options import (
    chosen_model,
    require_grip,
    require_intent,
)
from holdfast.core.contract import FloatArray, Prediction, Sample
from holdfast.core.errors import OutputError, RateError, visible
from holdfast.core.source import Source, SourceReading
from holdfast.edge_runtime.commands import Command, command_port
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.intent import IntentMonitor
from holdfast.edge_runtime.monitor import GripMonitor, require_fit
from holdfast.edge_runtime.preparation import Tare
from holdfast.live.hand_sources import open_live
from holdfast.live.intent import intended, intent_monitor
from holdfast.live.log_sink import Sink, stream_sink
from holdfast.live.loop import Summary, run_live
from holdfast.live.outputs import Outlets, SampleFile, file_sink, sample_file, udp_sink
from holdfast.live.real_time import RunClock, SceneClock, first_in_line
from holdfast.live.sources import force_of, resting_of
from holdfast.live.stopping import (
    output_from_the_background,
    service_watchdog,
    stop_signals,
    until,
)

if TYPE_CHECKING:
    from holdfast.drivers.lsl import LslAnswers
    from holdfast.live.cues import CueOutput
    from holdfast.live.grip import GripOutput
    from holdfast.live.intent import IntentLog
    from holdfast.live.page.run_page import RunPage
    from holdfast.live.view import View

PACE_READS = 30
"""So many scans may be too slow before a hand is: the first ones are, and so is a busy machine."""
UNLOADED = (
    "no --bias: the first samples must be of the unloaded hand; this is not checked"
)
STDOUT, STDERR = "stdout", "stderr"
READER_GONE = (errno.EPIPE, errno.EIO, errno.EBADF)
"""Errors of a standard stream that its reader closed on purpose: `| head`, a closed terminal."""
Emit = Callable[[Prediction, Sample, SourceReading], int | None]


def run_live_verb(args: argparse.Namespace) -> int:
    """Run until stopped; returns the exit code."""
    require_grip(args)
    require_intent(args)
    from holdfast.live.grip import is_virtual

    clock = SceneClock() if is_virtual(args.grip) else RunClock()
    model = chosen_model(args).open()
    with (
        output_from_the_background(),
        closing(stream_sink(sys.stderr, STDERR)) as beside,
    ):
        summary, failures = _run_until_stopped(args, clock, model, beside)
        say_summary(summary, beside)
    complete = all(_closed_by_reader(name, error) for name, error in failures.items())
    return 0 if complete else OutputError.exit_code


def _closed_by_reader(name: str, error: OSError) -> bool:
    """Whether the reader of a standard stream closed it: then nothing is missing."""
    return name in (STDOUT, STDERR) and error.errno in READER_GONE


class _Outputs:
    """Everything that a run writes to, opened in order and closed within bounded time."""

    def __init__(
        self,
        args: argparse.Namespace,
        model: OpenedModel,
        beside: Sink,
        enter: Callable[[AbstractContextManager[Any]], Any],
        at_end: Callable[[Callable[[], None]], object],
    ) -> None:
        self._beside = beside
        self.page: RunPage | None = None
        self.lsl: LslAnswers | None = None
        self._intent: IntentLog | None = None
        self._view: View | None = enter(_view(model)) if args.view else None
        sinks = _sinks(args, enter)
        n_channels = model.card.n_channels
        self._samples: SampleFile | None = (
            enter(sample_file(args.samples, n_channels)) if args.samples else None
        )
        others = [self._samples.sink] if self._samples else []
        self.outlets = Outlets(sinks, self.tell, others=others, watched=[beside])
        at_end(self.outlets.close)
        self.page = enter(_page(args, model, self.tell)) if args.web else None
        self._alive: Callable[[int], None] = enter(service_watchdog())

    def tell(self, text: str) -> None:
        """A message: above the picture while it is drawn, else on stderr."""
        line = visible(text)
        if self._view and self._view.drawing:
            self._view.tell(line)
        else:
            self._beside(line)
        if self.page:
            self.page.said(line)

    def take_intent(self, intent: IntentMonitor, log: IntentLog | None) -> None:
        """Show the wearer's own command, and write it to a log."""
        if self._view:
            self._view.intent = intent
        if self.page:
            self.page.intent = intent
        if log:
            self._intent = log
            self.outlets.add(log.sink)

    def emit(
        self, prediction: Prediction, sample: Sample, measured: SourceReading
    ) -> int:
        """Pass on one answer; returns how many lines were dropped."""
        dropped = self.outlets.emit(prediction)
        if self._samples:
            dropped += not self._samples.write(sample)
            if self._intent:
                dropped += self._intent.write(self._samples.first_ns)
        if self._view:
            self._view.show(prediction, sample, measured)
        if self.lsl:
            self.lsl.push(prediction, sample)
        if self.page:
            self.page.show(prediction, sample, measured)
        self._alive(prediction.t_decided_ns)
        return dropped


def _run_until_stopped(
    args: argparse.Namespace, clock: RunClock, model: OpenedModel, beside: Sink
) -> tuple[Summary, dict[str, OSError]]:
    """(summary, failed outputs): everything opened, the loop, everything closed."""
    with ExitStack() as stack:
        stopped = stack.enter_context(stop_signals())
        outputs = _Outputs(args, model, beside, stack.enter_context, stack.callback)
        outputs.lsl = _lsl(args, model, clock)
        outlets, tell = outputs.outlets, outputs.tell
        port = (
            command_port(args.commands, tell, clock.now_ns) if args.commands else None
        )
        command = Command if port is None else stack.enter_context(port)
        intent = stack.enter_context(
            intent_monitor(args.intent, clock, tell, args.obey_intent)
        )
        if intent is not None:
            log = stack.enter_context(_intent_log(args, intent, clock))
            outputs.take_intent(intent, log)
            command = intended(command, intent, obeyed=args.obey_intent is not None)
        grip = stack.enter_context(_grip(args, model, clock, tell))
        if grip is not None and outputs.page is not None:
            outputs.page.newest_command = lambda: grip.newest
        cues = stack.enter_context(_cues(args, clock, tell))
        field = None if grip is None else grip.field
        to_force = force_of(args.calibration)
        source = open_live(
            args.source,
            clock=clock,
            say=tell,
            to_force=to_force,
            field=field,
        )
        stack.enter_context(first_in_line(tell))
        with closing(source), _acting(grip, cues, source, tell):
            resting = resting_of(args.bias, source)
            if resting is None:
                tell(UNLOADED)
            stop = until(lambda: stopped() or outlets.none_acts(), clock, args.seconds)
            emit = outputs.emit if cues is None else cues.before(outputs.emit)
            emit = emit if grip is None else grip.before(emit)
            summary = answer(
                source, model, clock, emit, stop, resting=resting, command=command
            )
    summary.dropped, summary.lost_sinks = outlets.dropped, outlets.lost()
    return summary, outlets.failures


def _grip(
    args: argparse.Namespace,
    model: OpenedModel,
    clock: RunClock,
    tell: Callable[[str], None],
) -> AbstractContextManager[GripOutput | None]:
    if not args.grip:
        return nullcontext()
    from holdfast.live.grip import grip_output

    return grip_output(args, model.card, clock, tell)


def _lsl(
    args: argparse.Namespace, model: OpenedModel, clock: RunClock
) -> LslAnswers | None:
    if not args.lsl:
        return None
    from holdfast.drivers.lsl_library import open_answers

    card = model.card
    return open_answers(
        args.lsl, card.n_channels // 3, card.unit, card.rate_hz, clock.now_ns
    )


def _intent_log(
    args: argparse.Namespace, intent: IntentMonitor, clock: RunClock
) -> AbstractContextManager[IntentLog | None]:
    if not args.samples:
        return nullcontext()
    from holdfast.live.intent import intent_log

    return intent_log(args.samples, intent, clock.now_ns)


def _cues(
    args: argparse.Namespace, clock: RunClock, tell: Callable[[str], None]
) -> AbstractContextManager[CueOutput | None]:
    if not args.feedback:
        return nullcontext()
    from holdfast.live.cues import cue_output

    return cue_output(args, clock, tell)


@contextmanager
def _acting(
    grip: GripOutput | None,
    cues: CueOutput | None,
    source: Source,
    tell: Callable[[str], None],
) -> Iterator[None]:
    """The time of the loop, after which hand and wearer get their last lines."""
    with ExitStack() as stack:
        if cues is not None:
            stack.enter_context(cues.running(tell))
        if grip is not None:
            stack.enter_context(grip.running(source))
        yield


def _sinks(
    args: argparse.Namespace, enter: Callable[[AbstractContextManager[Sink]], Sink]
) -> list[Sink]:
    """Outputs of the predictions."""
    sinks = [] if args.quiet else [enter(closing(stream_sink(sys.stdout, STDOUT)))]
    sinks += [enter(file_sink(args.out, "--out"))] if args.out else []
    sinks += [enter(udp_sink(args.udp))] if args.udp else []
    return sinks


def answer(
    source: Source,
    model: OpenedModel,
    clock: Any,
    emit: Emit,
    stopped: Callable[[], bool],
    *,
    resting: FloatArray | None = None,
    command: Callable[[], Command] = Command,
) -> Summary:
    """Run the live loop. Raises ChannelError, UnitError, RateError if source and model differ."""
    card = model.card
    rate_hz = card.rate_hz if source.rate_hz is None else source.rate_hz
    require_fit(
        card,
        n_channels=source.n_channels,
        unit=source.unit,
        rate_hz=rate_hz,
        where="source",
    )
    monitor = GripMonitor(model, clock.now_ns, bias_known=resting is not None)
    tare = Tare(card.preparation, card.n_channels, resting)
    require_pace(source, model, clock)
    return run_live(
        source, monitor, tare, clock, emit, stopped=stopped, command=command
    )


def require_pace(source: Source, model: OpenedModel, clock: Any) -> None:
    """Read until one scan is as fast as the model's rate.

    Raises RateError where none of PACE_READS scans is.
    """
    if source.rate_hz is not None:
        return
    rate_hz, fastest_s = model.card.rate_hz, float("inf")
    for _ in range(PACE_READS):
        before_ns = clock.now_ns()
        source.read()
        fastest_s = min(fastest_s, 1e-9 * (clock.now_ns() - before_ns))
        if fastest_s * rate_hz <= 1.0:
            return
    raise RateError(
        f"the fastest of {PACE_READS} scans takes {1e3 * fastest_s:.1f} ms, "
        f"the model needs {rate_hz:g} a second",
        cause="a bridge too slow for this model",
        next_step="holdfast scan shows the rate that it serves",
    )


def _view(model: OpenedModel) -> AbstractContextManager[View]:
    from holdfast.live.view import viewed

    return viewed(model.card.unit)


def _page(
    args: argparse.Namespace, model: OpenedModel, say: Callable[[str], None]
) -> AbstractContextManager[RunPage]:
    from holdfast.live.page.run_page import run_page

    return run_page(args, model.card, say)


def say_summary(summary: Summary, tell: Callable[[str], object]) -> None:
    """Print counts, lost outputs, and the latency of each stage."""
    states = ", ".join(f"{name} {count}" for name, count in summary.states.items())
    lost = "".join(
        f", {count} {name}" for name, count in summary.lost().items() if count
    )
    counts = f"{summary.samples} samples, {summary.overruns} overruns{lost}, {summary.acts} acts"
    tell(f"\n{counts}; {states}")
    for sink, why in summary.lost_sinks.items():
        tell(f"lost: {sink} ({why})")
    for stage, figures in summary.latency_us().items():
        each = "  ".join(f"{name} {value:8.1f} us" for name, value in figures.items())
        tell(f"{stage:<14}{each}")
