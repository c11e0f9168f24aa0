"""What `holdfast run --web` sends to the live page: every sample, its answer, its grip command.

Without --grip no controller runs; the friction margin is then computed for the page alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from holdfast.core.contract import Prediction, Sample
from holdfast.core.reading import Json
from holdfast.core.source import SourceReading
from holdfast.edge_runtime.batch import ONE_HAND
from holdfast.edge_runtime.grip_control import FrictionMargin, sense_of
from holdfast.edge_runtime.intent import IntentMonitor
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.supervisor import GripCommand
from holdfast.live.page.link import PageLink, live_page

MARK = b"m"
ACTIONS = [{"do": "mark", "label": "Mark", "key": MARK.decode(), "when": "always"}]


class RunPage:
    """Sends samples to the page, and takes its marks. say: gets a line for each mark.

    newest_command: of the grip controller that runs, None where none does.
    """

    def __init__(
        self, link: PageLink, card: ModelCard, say: Callable[[str], None]
    ) -> None:
        self._link, self._say = link, say
        self._margin = FrictionMargin(ONE_HAND, card.rate_hz)
        self.newest_command: Callable[[], GripCommand | None] = lambda: None
        self.intent: IntentMonitor | None = None
        self._lost = self._next = self._marks = 0
        self._first_ns: int | None = None

    def show(
        self, prediction: Prediction, sample: Sample, measured: SourceReading
    ) -> None:
        """Send one sample; nothing waits, and what finds no room is dropped."""
        self._lost += sample.sequence - self._next
        self._next = sample.sequence + 1
        self._first_ns = sample.t_ns if self._first_ns is None else self._first_ns
        self._link.send(
            {
                "sample": {
                    **sample_message(sample, measured, self._lost, self._link.unsent),
                    "answer": _answer(prediction),
                    "grip": self._grip(prediction, sample),
                    **intent_message(self.intent),
                }
            }
        )
        if self._link.action() == MARK:
            self._mark(sample)

    def said(self, line: str) -> None:
        """Show a message of the run."""
        self._link.send({"said": line})

    def _mark(self, sample: Sample) -> None:
        self._marks += 1
        self._link.send({"mark": {"number": self._marks, "t_ns": sample.t_ns}})
        at_s = 1e-9 * (sample.t_ns - (self._first_ns or 0))
        self._say(f"mark {self._marks} at {at_s:.3f} s, sample {sample.sequence}")

    def _grip(self, prediction: Prediction, sample: Sample) -> Json:
        command = self.newest_command()
        if command is not None:
            return command._asdict()
        margin = self._margin
        margin.step(sense_of(prediction, sample.values, sample.valid))
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
    """The wearer's own command for the page; empty where none is received."""
    if intent is None:
        return {}
    newest = intent.newest
    said = {"wants": newest.wants, "envelope": newest.envelope, "link": intent.link}
    return {"intent": said}


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


@contextmanager
def run_page(
    args: argparse.Namespace, card: ModelCard, say: Callable[[str], None]
) -> Iterator[RunPage]:
    """The page of a run, served on args.web until the end. Raises UsageError, OutputError."""
    about: Json = {
        "verb": "run",
        "unit": card.unit,
        "model": f"{Path(args.model).name} ({card.model_id})",
        "source": args.source,
        "answers": True,
        "grip": args.grip is not None,
        "saves": True,
        "actions": ACTIONS,
    }
    with live_page(args.web, about, say, "the run") as link:
        yield RunPage(link, card, say)
