"""The grip as an output of a run: one grip command a sample, to a hand or to a scene.

The controller runs in the live loop, right after the prediction. Where its commands do not arrive,
the run goes on and reports it (holdfast/live/hand_link.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from holdfast.core.contract import GripCommand, Prediction, Sample
from holdfast.core.errors import ChannelError, UsageError
from holdfast.core.schema import checked, ranges
from holdfast.core.source import Source
from holdfast.edge_runtime.grip import ASSUMED_GAIN, AnswerRules
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.supervisor import Limits, last_line, to_line
from holdfast.live.hand_link import HandLink, open_hand_link
from holdfast.live.outputs import STOPPED
from holdfast.live.sources import source_url

if TYPE_CHECKING:
    from holdfast.live.scene import LiveScene

WHO_LETS_GO = "the hand obeys its wearer's opening (rule of the receiver)"
"""The link is one-way: a run states the rule, and cannot test it."""
NO_SHEAR_GAIN = (
    "the shear gain of these sensors is not known: the friction estimate takes 1, and a load is "
    f"followed as if it were {ASSUMED_GAIN:g}; holdfast calibrate measures it from loads with shear"
)
VIRTUAL = "virtual"
"""The grip of the hand in the scene of the source."""
Report = Callable[[str], None]


def checked_rules(
    given: Mapping[str, Any], where: Path | str = "rules"
) -> dict[str, float]:
    """The table [rules] of a file of settings: numbers of AnswerRules. Raises CardError.

    Called once, where the file is read: there a mistake is named with its file, also in a run
    without a grip.
    """
    kinds = {
        name: Annotated[float, one] | None for name, one in ranges(AnswerRules).items()
    }
    table = msgspec.defstruct(
        "Rules", [(*one, None) for one in kinds.items()], forbid_unknown_fields=True
    )
    read = msgspec.structs.asdict(checked(given, table, where))
    return {name: value for name, value in read.items() if value is not None}


def controller_for(
    name: str,
    card: ModelCard,
    report: Report,
    *,
    ceiling_n: float | None = None,
    most_over_n: float | None = None,
    shear_gain: float | None = None,
    rules: Mapping[str, float] | None = None,
) -> GripControl:
    """A controller that fits a model. ceiling_n: largest grip of the hand, None for the usual one.

    most_over_n: no target is further above the wearer's grip, None for no such end.
    shear_gain: read over true, of the hand's calibration; None where it was not measured.
    rules: numbers of AnswerRules, as checked_rules gives them, that take the place of the model's.
    report: gets one line where it runs in reduced mode. Raises UsageError, ChannelError.
    """
    n_sensors = card.n_channels // 3
    if card.thumb is None:
        raise ChannelError(
            f"the model is for {n_sensors} sensors and does not say which side they press from",
            where="--grip",
            next_step="export it for the hand (holdfast export MODEL --hand CARD --out FILE), "
            "or run without --grip",
        )

    others = {"most_over_n": most_over_n or math.inf, **(rules or {})}
    answers = AnswerRules.of(card.decision, **others)
    if answers.from_p >= answers.full_p:
        raise UsageError(
            f"from_p = {answers.from_p:g} is not below full_p = {answers.full_p:g}",
            where="rules",
            next_step="give both: an answer begins at from_p and is a full one at full_p",
        )
    control = GripControl(
        name,
        card.rate_hz,
        unit=card.unit,
        n_fingers=n_sensors,
        limits=Limits(ceiling_n=ceiling_n or Limits.ceiling_n),
        shear_gain=shear_gain,
        thumb=card.thumb,
        rules=answers,
    )
    # a raw field gives no force in N, so there is no target to command
    if control.reduced:
        report(
            f"reduced mode: the model reads {card.unit}, not N; commands have no target in N"
        )

    return control


@dataclass
class GripOutput:
    """Controller of a run, and the link or the scene that its commands go to.

    newest: the command of the last sample, None before the first.
    """

    controller: GripControl
    clock: Any
    report: Report
    link: HandLink | None = None
    scene: LiveScene | None = None
    newest: GripCommand | None = None

    @property
    def leaves(self) -> bool:
        """Whether commands reach the hand: a link can break."""
        return self.link is None or self.link.works

    def begin(self, source: Source) -> None:
        """The loop begins to read this source."""
        self.report(WHO_LETS_GO)
        if self.scene is not None:
            self.scene.began_ns = getattr(source, "began_ns", 0)

    def write(
        self,
        prediction: Prediction,
        sample: Sample,
        reading: object = None,
        command: object = None,
    ) -> None:
        """Send the command of one sample; command: of the sample before."""
        # here and not in a thread: the command is as fresh as the answer it follows
        fresh = self.controller.step(prediction, sample.values, sample.valid)
        # for the outputs after this one, which get it with the same sample
        self.newest = fresh
        if self.link is not None:
            self.link(to_line(fresh), fresh.sequence)
        if self.scene is not None:
            self.scene.obey(fresh, self.clock.now_ns())

    def close(self, reason: str = STOPPED) -> None:
        """Send `hold` as the last command; report what became of a scene."""
        if self.link is not None:
            self.link.close(reason)
        # only once, and not for a run whose source did not open
        if self.scene is not None and self.newest is not None:
            self.report(self.scene.outcome().line())
        self.newest = None


def open_grip(
    url: str,
    controller: GripControl,
    rate_hz: float,
    source: str,
    clock: Any,
    report: Report,
) -> GripOutput:
    """Commands to unix:// or serial://, or by virtual?lag_ms=.. to the hand in a source's scene.

    clock: of a run with a scene a SceneClock, or a virtual one. Raises UsageError, DeviceError,
    CardError.
    """
    if url.startswith(VIRTUAL):
        from holdfast.live.scene import SceneClock, drive_of, live_scene

        drive = drive_of(url, controller.limits.ceiling_n)
        # a virtual clock stands still by itself: computing takes no time on it
        still = clock.still if isinstance(clock, SceneClock) else nullcontext
        scene = live_scene(source_url(source), drive, still)
        return GripOutput(controller, clock, report, scene=scene)

    link = open_hand_link(url, "grip", last_line, report, clock.now_ns)
    # reported at the start, since otherwise the dropped lines would look like a fault
    if link.port.most_hz < rate_hz:
        carried = (
            f"carries about {link.port.most_hz:.0f} of {rate_hz:.0f} commands a second"
        )
        report(
            f"{link.name}: {carried}; the others are left out (baud=460800 carries them)"
        )
    return GripOutput(controller, clock, report, link)
