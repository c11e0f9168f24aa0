"""A live run from its opened outputs to its summary: the body of `holdfast run`.

A log that fails costs its lines and nothing else; the exit code is 5 where a file is incomplete, or
where not one command reached the hand.
"""

from __future__ import annotations

import errno
import sys
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec

from holdfast.core.contract import Command, FloatArray, GripCommand
from holdfast.core.errors import HoldfastError, OutputError, UsageError, visible
from holdfast.core.lines import Sink, stream_sink
from holdfast.core.schema import DEFAULT_MODEL
from holdfast.core.source import Source
from holdfast.core.trial_file import Zero
from holdfast.drivers.hand import Hand
from holdfast.drivers.replay import at_rate, zero_of
from holdfast.edge_runtime.engine import AUTO, ONNXRUNTIME, ModelChoice, OpenedModel
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.live.hand_files import (
    AnswerWatch,
    ZeroWatch,
    force_of,
    resting_of,
    shear_gain_of,
    tare_of,
)
from holdfast.live.loop import Emit, LiveRun, Summary, report_summary
from holdfast.live.output_table import KINDS, STDOUT, OutputUrl, output_url
from holdfast.live.outputs import (
    LineOutput,
    Output,
    SampleFile,
    about_model,
    close_at_end,
    emit_to,
)
from holdfast.live.running import (
    RunClock,
    ServiceWatchdog,
    StopRequest,
    output_from_the_background,
    real_time_priority,
    stop_signals,
    until,
)
from holdfast.live.sources import SetReader, is_standard_input, open_live

if TYPE_CHECKING:
    from holdfast.live.grip import GripOutput
    from holdfast.live.hand_link import HandLink
    from holdfast.live.page.run_page import RunPage
    from holdfast.live.scene import LiveScene
    from holdfast.live.view import View

STDERR = "stderr"
READER_GONE = (errno.EPIPE, errno.EIO, errno.EBADF)
"""Errors of a standard stream that its reader closed on purpose: `| head`, a closed terminal."""
Text = Annotated[str, msgspec.Meta(min_length=1)]


class RunOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What may stand in holdfast.toml; what is typed takes its place (holdfast/cli/options.py).

    model: a shipped one or a file; hand: the hand card of recordings; library: its C form;
    ceiling_n: largest grip of the hand, N of either side; most_over_wearers_n: no target is further
    above the wearer's grip, N of either side; feedback: where cues go; cues: their table; rules:
    other numbers of the grip's answers, by name (AnswerRules).
    """

    source: Text = ""
    model: Text = DEFAULT_MODEL
    calibration: Text = ""
    bias: Text = ""
    wearer: Text = ""
    hand: Text = ""
    grip: Text = ""
    to: tuple[Text, ...] = ()
    engine: Literal["auto", "onnxruntime", "c"] = AUTO
    library: Text = ""
    controller: Text = "holdfast"
    ceiling_n: Annotated[float, msgspec.Meta(gt=0.0, le=1e4)] | None = None
    most_over_wearers_n: Annotated[float, msgspec.Meta(gt=0.0, le=1e4)] | None = None
    feedback: Text = ""
    cues: Text = ""
    rules: dict[str, Any] = {}

    def __post_init__(self) -> None:
        if self.most_over_wearers_n and "most_over_n" in self.rules:
            what = "most_over_wearers_n and most_over_n of [rules] are the same number"
            raise ValueError(f"{what}; allowed: one of them")

    @property
    def moves_scene(self) -> bool:
        """Whether commands go to the hand in the scene of the source."""
        return self.grip.startswith("virtual")

    def outputs(self) -> list[OutputUrl]:
        """Where answers go, in the order of KINDS; JSON lines where nothing is named."""
        named = map(output_url, self.to or ("-",))
        order = list(KINDS)
        return sorted(named, key=lambda one: order.index(one.kind))

    def choice(self) -> ModelChoice:
        """The model and its engine."""
        library = "" if self.engine == ONNXRUNTIME else self.library
        return ModelChoice(str(self.model), self.engine, library or None)


def run(
    options: RunOptions,
    seconds: float | None = None,
    read_set: SetReader | None = None,
) -> int:
    """Run until stopped, or for some seconds; returns the exit code.

    read_set: reads SET#N as a source. Raises what the hand, the model and the outputs raise.
    """
    # what contradicts itself is refused before anything is opened
    options.outputs()
    if is_standard_input(options.wearer) and is_standard_input(options.source):
        what = "--wearer - and --source -: standard input cannot be both"
        raise UsageError(what, next_step="--wearer unix:///run/holdfast/wearer")
    clock = RunClock()
    if options.moves_scene:
        from holdfast.live.scene import SceneClock

        clock = SceneClock()

    model = options.choice().open()
    # stderr is a sink as well: a terminal that stops reading must not stop the loop
    with (
        output_from_the_background(),
        closing(stream_sink(sys.stderr, STDERR)) as stderr,
    ):
        live = OpenRun(options, model, clock, stderr)
        report_summary(live.until_stopped(seconds, read_set), stderr)
        code = live.stopped.exit_code
        for name, error in live.lines.failures.items():
            # named once more: its message may have scrolled away
            stderr(f"lost: {name} ({error.strerror or error})")
            # a reader that went away on purpose leaves no incomplete file
            if name not in (STDOUT, STDERR) or error.errno not in READER_GONE:
                code = OutputError.exit_code
        for link in live.links:
            if link.carried_none:
                stderr(f"lost: {link.name} (not one line left)")
                code = OutputError.exit_code
    return code


@dataclass
class OpenRun:
    """Everything that a run writes to, opened in order and closed within bounded time."""

    options: RunOptions
    model: OpenedModel
    clock: RunClock
    stderr: Sink

    def __post_init__(self) -> None:
        self.card = self.model.card
        # one output for all lines, so that each answer is written as text only once
        self.lines = LineOutput([], self.report, [self.stderr], self.card.not_learned)
        self.samples: SampleFile | None = None
        self.view: View | None = None
        self.page: RunPage | None = None
        self._grip: GripOutput | None = None
        self._scene: LiveScene | None = None
        self._answers = AnswerWatch(self.card, self.report)
        self.new_files: list[Path] = []
        self.links: list[HandLink] = []
        self.stopped = StopRequest()

    def report(self, text: str) -> None:
        """A message: above the picture while it is drawn, else on stderr."""
        line = visible(text)
        if self.view and self.view.drawing:
            self.view.report(line)
        else:
            self.stderr(line)
        if self.page:
            self.page.report(line)

    def until_stopped(
        self, seconds: float | None, read_set: SetReader | None
    ) -> Summary:
        """Open everything, run the loop, close everything."""
        options, clock = self.options, self.clock
        with ExitStack() as stack:
            # first, so that Ctrl-C while outputs are opened ends the run in order
            self.stopped = stack.enter_context(stop_signals())
            stack.push(self._leave_nothing_behind)
            outputs = self._open_outputs(stack)
            # called before they are closed
            stack.push(self._show_failure)
            command = self._open_wearer(stack, outputs)
            moving = self._open_moving(stack)
            source = open_live(
                options.source,
                clock=clock,
                report=self.report,
                to_force=force_of(options.calibration),
                field=self._scene,
                read_set=read_set,
            )
            source = at_rate(source, self.card.rate_hz, self.report)

            # after all threads and processes have started: they must not have this priority
            stack.enter_context(real_time_priority(self.report))
            # the last commands leave before the source is closed, which may take long
            with closing(source), ExitStack() as before_source:
                for output in moving:
                    close_at_end(before_source, output)
                # only an open source knows when it began, which the commands count from
                if self._grip is not None:
                    self._grip.begin(source)
                resting = self._begin(source, outputs)
                # from here on its files hold answers
                self.new_files.clear()
                summary = answer(
                    source,
                    self.model,
                    clock,
                    # the hand and the wearer come first: their lines must not wait for the others
                    emit_to([*moving, *outputs], self._newest_command),
                    until(self.stopped, clock, seconds, self._scene),
                    resting=resting,
                    command=command,
                )
                self._report_end(summary)

        # exact only now: while sinks are open, waiting lines count as dropped
        summary.lost["dropped"] = self.lines.dropped
        return summary

    def _show_failure(
        self, kind: object, error: BaseException | None, trace: object
    ) -> None:
        """What ended the run, for the page: on the terminal it is printed at the very end."""
        if self.page and isinstance(error, HoldfastError):
            self.page.why_ended = visible(str(error))

    def _leave_nothing_behind(self, kind: type | None, *_: object) -> None:
        """Remove the new files of a run that was refused: they would stop the next one."""
        if kind is not None:
            for path in self.new_files:
                path.unlink(missing_ok=True)

    def _report_end(self, summary: Summary) -> None:
        """Why the loop has ended, for the terminal and the page."""
        why = "it was stopped" if self.stopped() else "its time is over"
        if self._scene is not None and self._scene.ended:
            why = "the scene has ended"
        if summary.source_ended:
            why = "the source has ended"
        if why.endswith("ended"):
            self.report(f"{why}; samples: {summary.samples}")
        if self.page:
            self.page.why_ended = why
        self._answers.close()

    def _begin(self, source: Source, outputs: list[Output]) -> FloatArray | None:
        """Report what the run begins with; returns the measured bias, if there is one."""
        for line in about_model(self.model):
            self.report(line)
        options = self.options
        bias = resting_of(options.bias, source, options.calibration)
        zero, measured = zero_of(source), ""
        if bias is not None:
            measured = f"{options.bias} ({bias.date or 'without a date'})"
        elif zero == "measured":
            measured = "that recording"
        if measured or (zero is None and self.card.preparation.bias_rows):
            outputs.append(ZeroWatch(self.card, self.report, measured))
        outputs.append(self._answers)
        return None if bias is None else bias.values

    def _open_outputs(self, stack: ExitStack) -> list[Output]:
        """Those that only show or keep answers, in the order in which they get one."""
        outputs: list[Output] = [self.lines]
        close_at_end(stack, self.lines)
        for kind, place in self.options.outputs():
            output = KINDS[kind].opened(self, place)
            if output is not None:
                close_at_end(stack, output)
                outputs.append(output)

        # last: a sign of life says that every other output has got the answer
        watchdog = ServiceWatchdog()
        close_at_end(stack, watchdog)
        return [*outputs, watchdog]

    def keep(self, sink: Sink, path: Path) -> None:
        """Watch and close the sink of a new file, which goes where the run is refused."""
        self.lines.also_closed.append(sink)
        self.new_files.append(path)

    @property
    def zero(self) -> Zero:
        """What is removed from the samples."""
        return "measured" if self.options.bias else "first samples"

    def _newest_command(self) -> GripCommand | None:
        return None if self._grip is None else self._grip.newest

    def _open_wearer(
        self, stack: ExitStack, outputs: list[Output]
    ) -> Callable[[], Command]:
        """What the wearer commands at a sample."""
        if not self.options.wearer:
            return Command
        from holdfast.live.wearer import IntentLog, wearer_monitor

        clock = self.clock
        opened = wearer_monitor(self.options.wearer, clock, self.report)
        wearer = stack.enter_context(opened)
        for shown in (self.view, self.page):
            if shown is not None:
                shown.intent = wearer
        if self.samples is not None:
            log = IntentLog(wearer, clock.now_ns, self.samples)
            self.keep(log.sink, Path(log.sink.name))
            # after the file of samples, whose first sample sets the time axis of both
            outputs.insert(-1, log)
        return wearer.command

    def _open_moving(self, stack: ExitStack) -> list[Output]:
        """The grip and the wearer's cues."""
        options = self.options
        moving: list[Output] = []
        if options.grip:
            self._grip = self._open_grip(options.grip)
            self._scene = self._grip.scene
            moving.append(self._grip)
            if self._grip.link is not None:
                self.links.append(self._grip.link)
        if self.page:
            self.page.grip = self._grip
        if options.feedback:
            from holdfast.live.cues import SHIPPED, open_cues

            table, now_ns = options.cues or SHIPPED, self.clock.now_ns
            cues = open_cues(options.feedback, table, now_ns, self.report)
            moving.append(cues)
            self.links.append(cues.link)
        for output in moving:
            close_at_end(stack, output)
        return moving

    def _open_grip(self, url: str) -> GripOutput:
        from holdfast.live.grip import NO_SHEAR_GAIN, controller_for, open_grip

        options, card = self.options, self.card
        # only the grip needs friction, and raw fields have no newtons to correct
        # read over true; None where it was never measured
        gain: float | None = None
        if card.unit == "N":
            gain = shear_gain_of(options.source, options.calibration)
            # a calibration file may be older than its gain, a bare hand has no calibration at all
            if gain is None:
                self.report(NO_SHEAR_GAIN)
        controller = controller_for(
            options.controller,
            card,
            self.report,
            ceiling_n=options.ceiling_n,
            most_over_n=options.most_over_wearers_n,
            shear_gain=gain,
            rules=options.rules,
        )
        source, clock = options.source, self.clock
        return open_grip(url, controller, card.rate_hz, source, clock, self.report)


def answer(
    source: Source,
    model: OpenedModel,
    clock: Any,
    emit: Emit,
    stopped: Callable[[], bool],
    *,
    resting: FloatArray | None = None,
    command: Callable[[], Command] = Command,
    summary: Summary | None = None,
) -> Summary:
    """Run the live loop. Raises ChannelError, UnitError, RateError if source and model differ.

    summary: of an earlier part, which is counted on.
    """
    tare = tare_of(model.card, source, resting)
    monitor = GripMonitor(
        model,
        clock.now_ns,
        bias_known=resting is not None or zero_of(source) == "measured",
        has_counters=isinstance(source, Hand),
    )
    counted = summary or Summary()
    run = LiveRun(source, monitor, tare, clock, emit, command, counted)
    return run.until(stopped)
