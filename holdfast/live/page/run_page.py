"""The live page of `holdfast run --to web`: every sample, its answer, its grip command.

Without --grip no controller runs; the friction margin is then computed for the page alone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.core.contract import (
    RISKY_SLIP,
    SITUATIONS,
    Json,
    Prediction,
    Sample,
)
from holdfast.core.hand_card import SIDES, HandCard, hand_or_usual, sensor_names
from holdfast.core.source import SourceReading
from holdfast.edge_runtime.batch import ONE_HAND
from holdfast.edge_runtime.grip_control import FrictionMargin, sense_of
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.wearer import IntentMonitor
from holdfast.live.outputs import STOPPED
from holdfast.live.page.link import PageLink, open_page

if TYPE_CHECKING:
    from holdfast.live.grip import GripOutput
    from holdfast.live.run import RunOptions

MARK = b"m"
A_ROW, APART_MM = 4, 25.0
"""Sensors of which no card says where they are."""
ACTIONS = [{"do": "mark", "label": "Mark", "key": MARK.decode(), "when": "always"}]


class RunPage:
    """The page as an output of a run: it gets every sample and gives marks.

    report: gets a line for each mark. shear_gain: read over true, of the calibration. grip: the
    output that runs a controller; None where none does.
    """

    def __init__(
        self,
        link: PageLink,
        card: ModelCard,
        report: Callable[[str], None],
        shear_gain: float = 1.0,
    ) -> None:
        self._link = link
        self._report = report
        self._margin = FrictionMargin(ONE_HAND, card.rate_hz, shear_gain)
        self._thumb = None if card.hand is None else card.hand.of_thumb
        self._risky_not_learned = SITUATIONS[RISKY_SLIP] in card.not_learned
        self.grip: GripOutput | None = None
        self.intent: IntentMonitor | None = None
        self._lost = self._next = self._marks = 0
        self._first_ns: int | None = None

    def write(
        self, prediction: Prediction, sample: Sample, reading: SourceReading
    ) -> None:
        """Send one sample; nothing waits, and what finds no room is dropped."""
        # a gap in the numbers is what the loop did not read in time
        self._lost += sample.sequence - self._next
        self._next = sample.sequence + 1
        if self._first_ns is None:
            self._first_ns = sample.t_ns

        message = sample_message(sample, reading, self._lost, self._link.unsent)
        message["answer"] = _answer(prediction)
        # A probability of almost 0 would look like an answer.
        if self._risky_not_learned:
            message["answer"]["p_risky"] = None
        message["grip"] = self._grip(prediction, sample)
        message |= intent_message(self.intent)

        self._link.send({"sample": message})
        # asked once a sample: a mark belongs to the newest sample
        if self._link.action() == MARK:
            self._mark(sample)

    def report(self, line: str) -> None:
        """Show a message of the run."""
        self._link.send({"said": line})

    def close(self, reason: str) -> None:
        """Show how the run ended."""
        self._link.close("the run has ended" if reason == STOPPED else "the run failed")

    def _mark(self, sample: Sample) -> None:
        self._marks += 1
        self._link.send({"mark": {"number": self._marks, "t_ns": sample.t_ns}})
        at_s = 1e-9 * (sample.t_ns - (self._first_ns or 0))
        self._report(f"mark {self._marks} at {at_s:.3f} s, sample {sample.sequence}")

    def _grip(self, prediction: Prediction, sample: Sample) -> Json:
        command = None if self.grip is None else self.grip.newest
        if command is not None:
            return command._asdict()

        # no controller runs, so the margin is stepped here, from the same prediction
        margin = self._margin
        sense = sense_of(prediction, sample.values, sample.valid, self._thumb)
        margin.step(sense)
        # before a first slip nothing is known of the friction
        observed = margin.mu_hat > 0.0

        return {
            "mu_hat": margin.mu_hat if observed else None,
            "margin": margin.margin if observed else None,
            "needed_n": margin.needed_n if observed else None,
        }


def sample_message(
    sample: Sample, measured: SourceReading, lost: int, unsent: int
) -> Json:
    """A sample for the page. lost: so far. unsent: messages that the page's process missed."""
    return {
        "n": sample.sequence,
        "t_ns": sample.t_ns,
        "x": sample.values.tolist(),
        "v": [int(good) for good in sample.valid],
        "why": measured.why,
        "lost": lost,
        "unsent": unsent,
    }


def intent_message(intent: IntentMonitor | None) -> Json:
    """The wearer's command for the page; empty where none is received."""
    if intent is None:
        return {}
    newest = intent.newest
    wish = {"wants": newest.wants, "link": intent.link}
    return {"intent": wish}


def drawn_hand(card: HandCard | None, n_sensors: int) -> list[Json]:
    """The contacts of a hand for the page, sensors in the order of their channels.

    side: 0 or 1, left and right of the object; null, with places in a row, without a card.
    """
    hand = hand_or_usual(card, n_sensors)
    if hand is not None:
        names = iter(hand.sensor_names)
        return [
            {
                "name": next(names) if one.sensed else "",
                "side": SIDES.index(one.side),
                "x_mm": one.across_mm,
                "y_mm": one.along_mm,
                "pad": one.pad,
                "sensed": one.sensed,
            }
            for one in hand.contacts
        ]

    contacts: list[Json] = []
    for k, name in enumerate(sensor_names(None, n_sensors)):
        place = {"x_mm": APART_MM * (k % A_ROW), "y_mm": -APART_MM * (k // A_ROW)}
        contacts.append(
            {"name": name, "side": None, **place, "pad": "", "sensed": True}
        )
    return contacts


def _answer(prediction: Prediction) -> Json:
    return {
        "state": prediction.state,
        "why": prediction.why,
        "p_risky": prediction.p_risky,
        "weight": prediction.weight,
        "latency_us": prediction.latency_us,
        "arm": prediction.arm,
        "act": prediction.act,
        "opening": prediction.opening,
        "overridden": prediction.overridden,
        "commands": prediction.commands,
        "late": prediction.late,
        "started_loaded": prediction.started_loaded,
        "degraded": prediction.degraded,
    }


def open_run_page(
    address: str,
    options: RunOptions,
    card: ModelCard,
    shear_gain: float,
    report: Callable[[str], None],
) -> RunPage:
    """The page of a run, served at [HOST:]PORT until it is closed.

    shear_gain: read over true, of the calibration. Raises UsageError and OutputError.
    """
    about: Json = {
        "verb": "run",
        "unit": card.unit,
        "hand": drawn_hand(card.hand, card.n_channels // 3),
        "model": f"{Path(options.model).name} ({card.model_id})",
        "source": options.source,
        "answers": True,
        "grip": options.grip is not None,
        "actions": ACTIONS,
    }
    return RunPage(open_page(address, about, report), card, report, shear_gain)
