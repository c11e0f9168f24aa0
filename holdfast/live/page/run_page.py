"""The live page of `holdfast run --to web`: every sample, its answer, its grip command."""

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
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.wearer import IntentMonitor
from holdfast.live.outputs import STOPPED
from holdfast.live.page.link import PageLink, open_page

if TYPE_CHECKING:
    from holdfast.live.grip import GripOutput

A_ROW, APART_MM = 4, 25.0
"""Sensors of which no card says where they are."""
ANSWER = (
    "state",
    "why",
    "p_risky",
    "weight",
    "latency_us",
    "arm",
    "act",
    "opening",
    "overridden",
    "commands",
    "late",
    "started_loaded",
    "degraded",
)
"""What the page gets of a prediction."""


class RunPage:
    """The page as an output of a run. grip: what runs a controller; None where none does."""

    def __init__(self, link: PageLink, card: ModelCard) -> None:
        self._link = link
        self._risky_not_learned = SITUATIONS[RISKY_SLIP] in card.not_learned
        self.grip: GripOutput | None = None
        self.intent: IntentMonitor | None = None
        self._lost = self._next = 0
        self.why_ended = ""
        """Why the run ended, as far as it is known."""

    def write(
        self, prediction: Prediction, sample: Sample, reading: SourceReading
    ) -> None:
        """Send one sample; nothing waits, and what finds no room is dropped."""
        # a gap in the numbers is what the loop did not read in time
        self._lost += sample.sequence - self._next
        self._next = sample.sequence + 1

        message: Json = {
            "t_ns": sample.t_ns,
            "x": sample.values.tolist(),
            "v": sample.valid.astype(int).tolist(),
            "why": reading.why,
            "lost": self._lost,
            "unsent": self._link.unsent,
            "answer": {name: getattr(prediction, name) for name in ANSWER},
        }
        # A probability of almost 0 would look like an answer.
        if self._risky_not_learned:
            message["answer"]["p_risky"] = None
        if self.grip is not None and self.grip.newest is not None:
            message["grip"] = self.grip.newest._asdict()
        if self.intent is not None:
            wants = self.intent.newest.wants
            message["intent"] = {"wants": wants, "link": self.intent.link}
        self._link.send({"sample": message})

    def report(self, line: str) -> None:
        """Show a message of the run."""
        self._link.send({"said": line})

    def close(self, reason: str) -> None:
        """Show how the run ended."""
        how = "the run has ended" if reason == STOPPED else "the run failed"
        self._link.close(f"{how}: {self.why_ended}" if self.why_ended else how)


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


def open_run_page(
    address: str,
    source: str,
    model: str,
    card: ModelCard,
    report: Callable[[str], None],
    *,
    with_grip: bool,
) -> RunPage:
    """The page of a run, served at [HOST:]PORT. Raises UsageError and OutputError.

    source: a URL; model: a file. with_grip: whether a controller sends commands.
    """
    about: Json = {
        "unit": card.unit,
        "hand": drawn_hand(card.hand, card.n_channels // 3),
        "model": f"{Path(model).name} ({card.model_id})",
        "source": source,
        "grip": with_grip,
    }
    return RunPage(open_page(address, about, report), card)
