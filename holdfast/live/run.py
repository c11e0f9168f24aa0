"""A live run from its opened outputs to its summary: the body of `holdfast run`.

A log that fails costs its lines and nothing else; the exit code is 5 where a file is incomplete.
"""

from __future__ import annotations

import errno
import sys
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.contract import FloatArray
from holdfast.core.errors import OutputError, RateError, UsageError, visible
from holdfast.core.lines import Sink, stream_sink
from holdfast.core.source import Source
from holdfast.core.trial_file import Zero
from holdfast.drivers.hand import LiveHand
from holdfast.drivers.replay import PacedReplay
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.monitor import GripMonitor, require_fit
from holdfast.edge_runtime.preparation import Preparation, Tare
from holdfast.edge_runtime.wearer import Command
from holdfast.live.loop import Emit, Summary, report_summary, run_live
from holdfast.live.outputs import (
    KINDS,
    LineOutput,
    Output,
    OutputUrl,
    SampleFile,
    about_model,
    close_at_end,
    emit_to,
    file_sink,
    output_url,
    udp_sink,
)
from holdfast.live.running import (
    RunClock,
    ServiceWatchdog,
    first_in_line,
    output_from_the_background,
    stop_signals,
    until,
)
from holdfast.live.scene_source import shear_gain_of
from holdfast.live.source_url import is_standard_input
from holdfast.live.sources import SetReader, at_rate, force_of, open_live, resting_of
from holdfast.live.zero import ZeroWatch

if TYPE_CHECKING:
    from holdfast.live.cues import CueOutput
    from holdfast.live.grip import GripOutput
    from holdfast.live.page.run_page import RunPage
    from holdfast.live.view import View

PACE_READS = 30
"""So many scans may be too slow before a hand is: the first ones are, and so is a busy machine."""
NO_SHEAR_GAIN = (
    "the shear gain of these sensors is not known, so the friction estimate takes 1; "
    "holdfast calibrate measures it from loads with shear"
)
STDOUT = "stdout"
STDERR = "stderr"
READER_GONE = (errno.EPIPE, errno.EIO, errno.EBADF)
"""Errors of a standard stream that its reader closed on purpose: `| head`, a closed terminal."""


@dataclass(frozen=True)
class RunOptions:
    """What `holdfast run` was asked for, on the command line and in holdfast.toml."""

    model: ModelChoice
    source: str
    to: tuple[str, ...] = ()
    grip: str | None = None
    wearer: str | None = None
    calibration: Path | None = None
    bias: Path | None = None
    seconds: float | None = None
    controller: str | None = None
    ceiling_n: float | None = None
    feedback: str | None = None
    cues: Path | None = None

    @property
    def moves_scene(self) -> bool:
        """Whether commands go to the hand in the scene of the source."""
        # as a word, or as the beginning of a URL, which --source has taught
        name = "" if self.grip is None else self.grip.partition("?")[0]
        return name.rstrip(":/") == "virtual"

    def outputs(self) -> list[OutputUrl]:
        """Where answers go, in the order of KINDS; JSON lines where nothing is named."""
        named = [output_url(url) for url in self.to] or [OutputUrl("-", "")]
        return sorted(named, key=lambda one: KINDS.index(one.kind))

    @property
    def has_page(self) -> bool:
        """Whether a page shows the run."""
        return any(one.kind == "web" for one in self.outputs())

    def require_consistent(self) -> None:
        """Raise UsageError for what contradicts itself, before the hand is opened."""
        self.outputs()
        if (
            self.wearer
            and is_standard_input(self.wearer)
            and is_standard_input(self.source)
        ):
            what = "--wearer - and --source -: standard input cannot be both"
            raise UsageError(what, next_step="--wearer unix:///run/holdfast/wearer")


def run(options: RunOptions, read_set: SetReader | None = None) -> int:
    """Run until stopped; returns the exit code. read_set: reads SET#N as a source."""
    options.require_consistent()
    clock = RunClock()
    if options.moves_scene:
        from holdfast.live.scene import SceneClock

        clock = SceneClock()

    model = options.model.open()
    # stderr is a sink as well: a terminal that stops reading must not stop the loop
    with (
        output_from_the_background(),
        closing(stream_sink(sys.stderr, STDERR)) as stderr,
    ):
        live = _Run(options, model, clock, stderr)
        summary = live.until_stopped(read_set)
        report_summary(summary, stderr)

    for name, error in live.lines.failures.items():
        # a reader that went away on purpose leaves no incomplete file
        if not _closed_by_reader(name, error):
            return OutputError.exit_code

    return 0


def _closed_by_reader(name: str, error: OSError) -> bool:
    """Whether the reader of a standard stream closed it: then nothing is missing."""
    return name in (STDOUT, STDERR) and error.errno in READER_GONE


class _Run:
    """Everything that a run writes to, opened in order and closed within bounded time."""

    def __init__(
        self, options: RunOptions, model: OpenedModel, clock: RunClock, stderr: Sink
    ) -> None:
        self._options = options
        self._model = model
        self._clock = clock
        self._stderr = stderr
        self._samples: SampleFile | None = None
        self._view: View | None = None
        self._page: RunPage | None = None
        self._grip: GripOutput | None = None
        # read over true; None where never measured
        self._shear_gain: float | None = 1.0
        self._cues: CueOutput | None = None

    def report(self, text: str) -> None:
        """A message: above the picture while it is drawn, else on stderr."""
        line = visible(text)
        if self._view and self._view.drawing:
            self._view.report(line)
        else:
            self._stderr(line)
        if self._page:
            self._page.report(line)

    def until_stopped(self, read_set: SetReader | None) -> Summary:
        """Open everything, run the loop, close everything."""
        options = self._options
        clock = self._clock
        with ExitStack() as stack:
            # first, so that Ctrl-C while outputs are opened ends the run in order
            stopped = stack.enter_context(stop_signals())
            self._shear_gain = known_shear_gain(options, self._model.card)
            outputs = self._open_outputs(stack)
            command = self._open_wearer(stack, outputs)
            self._open_grip(stack)
            self._open_cues(stack)

            # the hand and the wearer come first: their lines must not wait for the others
            moving = [one for one in (self._grip, self._cues) if one is not None]
            source = open_live(
                options.source,
                clock=clock,
                report=self.report,
                to_force=force_of(options.calibration),
                field=None if self._grip is None else self._grip.scene,
                read_set=read_set,
            )

            source = at_rate(source, self._model.card.rate_hz, self.report)
            # after all threads and processes have started: they must not have this priority
            stack.enter_context(first_in_line(self.report))
            # the last commands leave before the source is closed, which may take long
            with closing(source), ExitStack() as before_source:
                for output in moving:
                    close_at_end(before_source, output)
                # only an open source knows when it began, which the commands count from
                if self._grip is not None:
                    self._grip.begin(source)

                for line in about_model(self._model.card, options.model.path):
                    self.report(line)
                resting = resting_of(options.bias, source)
                bare = resting is None and zero_of(source) is None
                if bare and self._model.card.preparation.bias_rows:
                    outputs.append(ZeroWatch(self._model.card, self.report))
                if self._shear_gain is None:
                    self.report(NO_SHEAR_GAIN)
                summary = answer(
                    source,
                    self._model,
                    clock,
                    emit_to([*moving, *outputs]),
                    until(stopped, clock, options.seconds),
                    resting=resting,
                    command=command,
                )
                if summary.source_ended:
                    self.report(f"the source has ended; samples: {summary.samples}")

        # exact only now: while sinks are open, waiting lines count as dropped
        summary.dropped = self.lines.dropped
        summary.lost_sinks = self.lines.lost()
        return summary

    def _open_outputs(self, stack: ExitStack) -> list[Output]:
        """Those that only show or keep answers, in the order in which they get one."""
        open_one = {
            "view": self._open_view,
            "-": self._open_stdout,
            "jsonl": self._open_file,
            "udp": self._open_udp,
            "csv": self._open_samples,
            "web": self._open_page,
            "lsl": self._open_streams,
        }
        # one output for all lines, so that each answer is written as text only once
        self.lines = LineOutput(
            [], self.report, [self._stderr], self._model.card.not_learned
        )
        close_at_end(stack, self.lines)
        outputs: list[Output] = [self.lines]
        for kind, place in self._options.outputs():
            output = open_one[kind](place) if kind in open_one else None
            if output is not None:
                close_at_end(stack, output)
                outputs.append(output)

        # last: a sign of life says that every other output has got the answer
        watchdog = ServiceWatchdog()
        close_at_end(stack, watchdog)
        outputs.append(watchdog)
        return outputs

    def _open_stdout(self, place: str) -> None:
        self.lines.add_lines(stream_sink(sys.stdout, STDOUT))

    def _open_file(self, place: str) -> None:
        self.lines.add_lines(file_sink(Path(place)))

    def _open_udp(self, place: str) -> None:
        self.lines.add_lines(udp_sink(place))

    def _open_samples(self, place: str) -> SampleFile:
        card = self._model.card
        zero: Zero = "measured" if self._options.bias else "first samples"
        self._samples = SampleFile(Path(place), card.n_channels, card.unit, zero)
        self.lines.add(self._samples.sink)
        return self._samples

    def _open_view(self, place: str) -> View:
        from holdfast.core.hand_card import sensor_names
        from holdfast.live.view import open_view

        card = self._model.card
        names = sensor_names(card.hand, card.n_channels // 3)
        self._view = open_view(card.unit, not_learned=card.not_learned, names=names)
        return self._view

    def _open_page(self, place: str) -> RunPage:
        from holdfast.live.page.run_page import open_run_page

        card = self._model.card
        self._page = open_run_page(
            place,
            source=self._options.source,
            card=card,
            model_name=f"{Path(self._options.model.path).name} ({card.model_id})",
            with_grip=self._options.grip is not None,
            shear_gain=self._shear_gain or 1.0,
            report=self.report,
        )
        return self._page

    def _open_streams(self, place: str) -> Output:
        from holdfast.drivers.lsl_library import open_answers

        card = self._model.card
        return open_answers(
            place,
            card.n_channels // 3,
            card.unit,
            card.rate_hz,
            self._clock.now_ns,
            card.not_learned,
        )

    def _open_wearer(
        self, stack: ExitStack, outputs: list[Output]
    ) -> Callable[[], Command]:
        """What the wearer commands at a sample."""
        if self._options.wearer is None:
            return Command
        from holdfast.live.wearer import IntentLog, wearer_monitor

        clock = self._clock
        opened = wearer_monitor(self._options.wearer, clock, self.report)
        wearer = stack.enter_context(opened)
        for shown in (self._view, self._page):
            if shown is not None:
                shown.intent = wearer
        if self._samples is not None:
            log = IntentLog(self._samples.path, wearer, clock.now_ns, self._samples)
            self.lines.add(log.sink)
            # after the file of samples, whose first sample sets the time axis of both
            outputs.insert(outputs.index(self._samples) + 1, log)
        return wearer.command

    def _open_grip(self, stack: ExitStack) -> None:
        options = self._options
        card = self._model.card
        if not options.grip:
            return
        from holdfast.live import grip

        controller = grip.controller_for(
            options.controller or grip.DEFAULT_CONTROLLER,
            card,
            self.report,
            ceiling_n=options.ceiling_n,
            shear_gain=self._shear_gain or 1.0,
        )
        # the scene's hand is part of the source, so its commands go through no wire
        if options.moves_scene:
            self._grip = grip.grip_to_scene(
                options.grip,
                options.source,
                controller,
                options.ceiling_n,
                self._clock,
                self.report,
            )
        else:
            self._grip = grip.grip_to_link(
                options.grip, controller, card.rate_hz, self._clock, self.report
            )

        close_at_end(stack, self._grip)
        if self._page:
            self._page.grip = self._grip

    def _open_cues(self, stack: ExitStack) -> None:
        options = self._options
        if not options.feedback:
            return
        from holdfast.live.cues import open_cues

        self._cues = open_cues(
            options.feedback, options.cues, self._clock.now_ns, self.report
        )
        close_at_end(stack, self._cues)


def known_shear_gain(options: RunOptions, card: ModelCard) -> float | None:
    """Of the calibration or the scene; None where it was never measured."""
    # A calibration file may be older than its gain, and a bare hand has no calibration at all.
    # only these two show friction, and raw fields have no newtons to correct
    if not (options.grip or options.has_page) or card.unit != "N":
        return 1.0
    return shear_gain_of(options.source, options.calibration)


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
    # a polled hand has no rate of its own: the loop reads it at that of the model
    rate_hz = card.rate_hz if source.rate_hz is None else source.rate_hz
    require_fit(
        card,
        n_channels=source.n_channels,
        unit=source.unit,
        rate_hz=rate_hz,
        where="source",
    )

    zero = zero_of(source)
    monitor = GripMonitor(
        model,
        clock.now_ns,
        bias_known=resting is not None or zero == "measured",
        has_counters=isinstance(source, LiveHand),
    )
    # the samples of another run have lost sign and zero already
    preparation = card.preparation if zero is None else Preparation()
    tare = Tare(preparation, card.n_channels, resting)
    # after the tare is ready and before the schedule: reads that are too slow would all be
    # overruns
    require_pace(source, model, clock)
    return run_live(
        source, monitor, tare, clock, emit, stopped=stopped, command=command
    )


def zero_of(source: Source) -> Zero | None:
    """What was removed from the samples of a source already: a run's own, replayed."""
    return source.zero if isinstance(source, PacedReplay) else None


def require_pace(source: Source, model: OpenedModel, clock: Any) -> None:
    """Read until one scan is as fast as the model's rate.

    Raises RateError where none of PACE_READS scans is.
    """
    # a source with a rate of its own is paced by it: only a polled bridge can be too slow
    if source.rate_hz is not None:
        return
    rate_hz = model.card.rate_hz
    fastest_s = float("inf")
    # one fast scan is enough: what a bridge can do once it can do again
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
