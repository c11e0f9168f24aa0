"""What `holdfast record --web` sends to the live page, and the keys that the page presses."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from holdfast.core.reading import Json
from holdfast.core.source import SourceReading
from holdfast.live.page.link import PageLink, live_page
from holdfast.live.page.run_page import intent_message
from holdfast.sessions.recorder.keys import Keys
from holdfast.sessions.recorder.session import Show
from holdfast.sessions.recorder.trial import TrialRecorder

ACTIONS = [
    {"do": "start", "label": "Start", "key": " ", "when": "ready"},
    {"do": "load", "label": "Load onset", "key": "l", "when": "trial"},
    {"do": "released", "label": "Released", "key": "e", "when": "trial"},
    {"do": "keep", "label": "Keep", "key": "k", "when": "trial"},
    {"do": "redo", "label": "Redo", "key": "r", "when": "always"},
    {"do": "stop", "label": "Stop recording", "key": "q", "when": "always"},
]
"""The buttons: each presses a key of holdfast/sessions/recorder/keys.py."""


class RecordPage:
    """A session's messages and samples go to the page, and on to the terminal."""

    def __init__(self, link: PageLink, say: Callable[[str], None], show: Show) -> None:
        self._link, self._say, self._show = link, say, show
        self._task, self._unit = "", ""

    def say(self, line: str) -> None:
        """A message."""
        self._say(line)
        self._link.send({"said": line})

    def announce(self, task: str, left: int) -> None:
        """The next trial, before it begins."""
        self._task = task
        self._link.send({"ready": {"task": task, "left": left}})

    def show(self, trial: TrialRecorder, measured: SourceReading, now_ns: int) -> None:
        """One sample, less the bias; nothing waits."""
        quality = trial.quality
        if quality.unit != self._unit:
            self._unit = quality.unit
            self._link.send({"about": {"unit": self._unit}})
        values = measured.values - np.nan_to_num(quality.bias)
        sample: Json = {
            "t_ns": now_ns,
            "x": values.tolist(),
            "v": [int(good) for good in measured.valid],
            "why": measured.why,
            "lost": quality.lost,
            "unsent": self._link.unsent,
            "task": self._task,
            "trial_s": round(trial.t_s, 3),
            **intent_message(trial.intent),
        }
        self._link.send({"sample": sample})
        self._show(trial, measured, now_ns)


@contextmanager
def record_page(
    args: argparse.Namespace, keys: Keys, say: Callable[[str], None], show: Show
) -> Iterator[RecordPage]:
    """The page of a recording, served on args.web until its end; its buttons press keys.

    Raises UsageError, OutputError.
    """
    about: Json = {
        "verb": f"record {args.person}",
        "unit": "",
        "source": args.source,
        "answers": False,
        "grip": False,
        "saves": False,
        "actions": ACTIONS,
    }
    with live_page(args.web, about, say, "the recording") as link:
        keys.listen_to(link.handle)
        yield RecordPage(link, say, show)
