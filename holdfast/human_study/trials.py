"""The recording steps: each trial is one run of the recorder, with its own code and layout."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from holdfast.edge_runtime.errors import UsageError
from holdfast.edge_runtime.trial_layout import DISCARDED, META
from holdfast.human_study.card import StudyCard
from holdfast.human_study.desk import TrialKeys
from holdfast.human_study.virtual import url_for
from holdfast.live_options import force_of
from holdfast.live_sources import open_live
from holdfast.real_time import NO_PRIORITY
from holdfast.recorder.card import Task
from holdfast.recorder.folder import (
    KEPT,
    RECORDING,
    alone,
    discard,
    done,
    number,
    opened,
    task_folder,
    trials_of,
)
from holdfast.recorder.labels import read_meta
from holdfast.recorder.mending import repaired
from holdfast.recorder.plan import Plan
from holdfast.recorder.recording import kind_of, record_plan
from holdfast.recorder.session import Show

REVERSED = "warning: the magnet is reversed"


class Trials:
    """Records and counts the trials of one person; args: the checked options of the verb."""

    def __init__(
        self,
        args: argparse.Namespace,
        card: StudyCard,
        clock: Any,
        say: Callable[[str], None],
        stopped: Callable[[], bool],
        show: Show,
    ) -> None:
        self._args, self._card, self._clock = args, card, clock
        self._stopped, self._show, self._tell = stopped, show, say
        self._root, self._person = args.out, args.person
        self._said: set[str] = set()

    def require_hand(self) -> None:
        """Open the source once, so that a hand that does not answer is seen before the person is.

        It also makes the folder of recordings. Raises the errors of the source, and UsageError for
        a virtual participant who does not do what the card asks for.
        """
        tasks = [part.task for part in self._card.parts if part.task]
        urls = [url_for(self._args.source, task, 0) for task in tasks]
        url = urls[0] if urls else self._args.source
        there = read_meta(self._root).get("kind", kind_of(url))
        if there != kind_of(url):
            raise UsageError(
                f"{self._root}: holds trials that are {there}, these would be {kind_of(url)}",
                next_step="name another folder, so that rehearsals stay apart from people",
            )
        if (self._root / META).exists():
            return
        source = open_live(
            url, clock=self._clock, say=self._say, to_force=force_of(self._args.calibration)
        )
        with closing(source), opened(self._root, source.unit, kind_of(url)):
            self._say(f"the hand answers: {source.n_channels // 3} fingers, in {source.unit}")

    def mend(self) -> None:
        """Mark trials that a kill left as interrupted. Raises a DataError or OutputError."""
        with alone(self._root):
            for folder, meta in trials_of(self._root, self._person):
                if meta.get("state") == RECORDING:
                    self._say(f"{folder}: {', '.join(repaired(folder))}; it is recorded again")

    def kept(self, task: Task) -> int:
        """How many trials of a task are kept."""
        return done(self._root, self._person).count(task)

    def record(self, task: Task, keys: TrialKeys) -> None:
        """Record one trial. Raises a HoldfastError; the study may go on after it."""
        nth = self._recorded(task)
        options = self._options(url_for(self._args.source, task, nth))
        record_plan(
            options,
            Plan(self._card.protocol(), [task], self.kept(task)),
            self._clock,
            keys,
            self._say,
            lambda: self._stopped() or keys.ends,
            self._show,
        )

    def discard_last(self, task: Task) -> Path:
        """Move the last kept trial of a task to the discarded ones; returns its new path."""
        with alone(self._root):
            last = max(
                (
                    folder
                    for folder, meta in trials_of(self._root, self._person)
                    if meta.get("state") == KEPT
                    and folder.parent == task_folder(self._root, self._person, task)
                ),
                key=number,
            )
            return discard(self._root, self._person, last)

    def _recorded(self, task: Task) -> int:
        """How many trials of a task were begun, the discarded ones counted too."""
        place = task_folder(self._root, self._person, task)
        home = self._root / self._person
        moved = home / DISCARDED / place.relative_to(home)
        return sum(1 for folder in (place, moved) for _ in folder.glob("trial_*"))

    def _options(self, url: str) -> argparse.Namespace:
        """The options of `holdfast record` for one trial, begun by the operator of the study."""
        shared = ("calibration", "out", "person", "rate", "anyway", "seconds", "intent")
        camera = ("camera", "tag_mm", "fps", "exposure_ms")
        given = {name: getattr(self._args, name) for name in (*shared, *camera)}
        return argparse.Namespace(
            **given, source=url, protocol=self._card.name, seed=0, trials=1, at_once=True
        )

    def _say(self, line: str) -> None:
        """Messages of the recorder; those that every trial would repeat, once."""
        if line in self._said and line.startswith((NO_PRIORITY, REVERSED)):
            return
        self._said.add(line)
        self._tell(line)
