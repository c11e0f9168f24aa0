"""The acting end of a run: one grip command a sample, to a hand or to a scene.

The controller runs in the live loop, right after the prediction. Where its commands do not arrive,
the run goes on and reports it (holdfast/live/grip_outputs.py).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from holdfast.core.contract import Prediction, Sample
from holdfast.core.errors import ChannelError
from holdfast.core.source import Source
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.supervisor import GripCommand, Limits, last_line, to_line
from holdfast.live.grip_outputs import LineSink, line_sink

if TYPE_CHECKING:
    from holdfast.live.scene import LiveScene

DEFAULT_CONTROLLER = "holdfast"
FINGERS = 6
"""The controllers take half of the sum of all normal forces as the grip of either side."""
Say = Callable[[str], None]
Emit = Callable[[Prediction, Sample, Any], int | None]


def is_virtual(url: str | None) -> bool:
    """Whether commands go to the hand in the scene of the source."""
    return url is not None and url.partition("?")[0] == "virtual"


def controller_for(
    name: str, card: ModelCard, say: Say, *, ceiling_n: float | None = None
) -> GripControl:
    """A controller that fits a model. ceiling_n: largest grip of the hand, None for the usual one.

    say: gets one line where it runs in reduced mode. Raises UsageError, ChannelError.
    """
    if card.n_channels != 3 * FINGERS:
        raise ChannelError(
            f"the controllers are for {FINGERS} fingers, the model is for {card.n_channels // 3}",
            where="--grip",
            next_step="use a model for six fingers, or run without --grip",
        )
    limits = Limits() if ceiling_n is None else Limits(ceiling_n=ceiling_n)
    control = GripControl(
        name, card.rate_hz, unit=card.unit, n_fingers=FINGERS, limits=limits
    )
    if control.reduced:
        say(
            f"reduced mode: the model reads {card.unit}, not N; commands have no target in N"
        )
    return control


class GripOutput:
    """Controller and wire of a run. field: what a virtual hand's chips measure, or None.

    newest: the command of the last sample, None before the first.
    """

    def __init__(
        self,
        controller: GripControl,
        clock: Any,
        say: Say,
        *,
        wire: LineSink | None = None,
        scene: LiveScene | None = None,
    ) -> None:
        self._controller, self._clock = controller, clock
        self._say, self._wire, self.field = say, wire, scene
        self.newest: GripCommand | None = None

    def before(self, emit: Emit) -> Emit:
        """An emit that first sends the command of a sample, and then calls another emit."""

        def both(prediction: Prediction, sample: Sample, measured: Any) -> int | None:
            self.act(prediction, sample)
            return emit(prediction, sample, measured)

        return both

    def act(self, prediction: Prediction, sample: Sample) -> None:
        """Send the command of one sample."""
        command = self._controller.step(prediction, sample.values, sample.valid)
        self.newest = command
        if self._wire is not None:
            self._wire(to_line(command), command.sequence)
        if self.field is not None:
            self.field.obey(command, self._clock.now_ns())

    @contextmanager
    def running(self, source: Source) -> Iterator[None]:
        """The time of the loop: its last command is `hold`, sent before anything is closed."""
        if self.field is not None:
            self.field.began_ns = getattr(source, "began_ns", 0)
        reason = "failed"
        try:
            yield
            reason = "stopped"
        finally:
            if self._wire is not None:
                self._wire.finish(reason)
                if self._wire.dropped:
                    self._say(
                        f"{self._wire.name}: {self._wire.dropped} lines did not leave"
                    )
            if self.field is not None:
                self._say(self.field.outcome().line())


@contextmanager
def grip_output(
    args: argparse.Namespace, card: ModelCard, clock: Any, say: Say
) -> Iterator[GripOutput]:
    """The acting end that the options ask for, opened; card: of the model.

    Raises UsageError, ChannelError, DeviceError, OutputError.
    """
    name = args.controller or DEFAULT_CONTROLLER
    control = controller_for(name, card, say, ceiling_n=args.ceiling)
    scene = wire = None
    with ExitStack() as stack:
        if is_virtual(args.grip):
            scene = _scene(args, clock)
        else:
            wire = stack.enter_context(
                line_sink(args.grip, "--grip", last_line, say, clock.now_ns)
            )
            _report_slow_wire(wire, card.rate_hz, say)
        yield GripOutput(control, clock, say, wire=wire, scene=scene)


def _report_slow_wire(wire: LineSink, rate_hz: float, say: Say) -> None:
    if wire.most_hz < rate_hz:
        carried = f"carries about {wire.most_hz:.0f} of {rate_hz:.0f} commands a second"
        say(
            f"{wire.name}: {carried}; the others are left out (baud=460800 carries them)"
        )


def _scene(args: argparse.Namespace, clock: Any) -> LiveScene:
    from holdfast.live.scene import drive_of, live_scene

    drive = drive_of(args.grip)
    if args.ceiling is not None:
        drive = replace(drive, ceiling_n=min(drive.ceiling_n, args.ceiling))
    return live_scene(args.source, drive, getattr(clock, "still", nullcontext))
