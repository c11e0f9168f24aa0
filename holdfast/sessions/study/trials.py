"""The recording steps: each trial is one run of the recorder, with its own code and layout.

A virtual participant: the scene of a source, and the trial of it that fits what is recorded.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from holdfast.core.errors import UsageError
from holdfast.core.trial_layout import DISCARDED, META
from holdfast.live.hand_sources import open_live
from holdfast.live.real_time import NO_PRIORITY
from holdfast.live.sources import SIM, force_of, split_url
from holdfast.sessions.recorder.folder import (
    KEPT,
    RECORDING,
    alone,
    discard,
    done,
    number,
    opened,
    repaired,
    task_folder,
    trials_of,
)
from holdfast.sessions.recorder.labels import read_meta
from holdfast.sessions.recorder.plan import Plan
from holdfast.sessions.recorder.protocol import NOTHING, Task
from holdfast.sessions.recorder.recording import kind_of, record_plan
from holdfast.sessions.recorder.session import Show
from holdfast.sessions.study.console import TrialKeys
from holdfast.sessions.study.steps import StudyCard


def scene_in(url: str) -> tuple[str, int] | None:
    """(card, seed) of a source whose scene's trials can be chosen; None where it names a trial."""
    parts = split_url(url) if "://" in url else None
    options = {} if parts is None else parse_qs(parts.query, keep_blank_values=True)
    if parts is None or "trial" in options or "trials" in options:
        return None
    name = (
        parts.netloc + parts.path
        if url.startswith(SIM)
        else options.get("scene", [""])[-1]
    )
    seed = options.get("seed", ["0"])[-1]
    known = parts.scheme in ("sim", "virtual") and name and seed.isdecimal()
    return (name, int(seed)) if known else None


def url_for(url: str, task: Task, nth: int) -> str:
    """The source of the n-th trial of a task, from 0; the URL itself where it has no scene.

    A scene's trials of that object and action come in turn. Raises UsageError where it has none.
    """
    scene = scene_in(url)
    if scene is None:
        return url
    fitting = [
        k
        for k, one in enumerate(_tasks(*scene))
        if one == Task(task.thing, task.action)
    ]
    if not fitting:
        raise UsageError(
            f"the scene {scene[0]} has no trial of {task.thing}, {task.action}",
            cause="a card with other objects or actions than the protocol's",
            next_step="take a scene with them, such as sim://p1 for the card thesis",
        )
    return f"{url}{'&' if '?' in url else '?'}trial={fitting[nth % len(fitting)]}"


@lru_cache(maxsize=1)
def _tasks(name: str, seed: int) -> list[Task]:
    """What each trial of a scene is. Raises CardError."""
    from holdfast.simulation.card import read_card
    from holdfast.simulation.scene import Scene

    trials = Scene(read_card(name), seed).trials()
    things = [NOTHING if one.action == NOTHING else one.thing.name for one in trials]
    return [Task(thing, one.action) for thing, one in zip(things, trials, strict=True)]


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
            url,
            clock=self._clock,
            say=self._say,
            to_force=force_of(self._args.calibration),
        )
        with closing(source), opened(self._root, source.unit, kind_of(url)):
            self._say(
                f"the hand answers: {source.n_channels // 3} fingers, in {source.unit}"
            )

    def mend(self) -> None:
        """Mark trials that a kill left as interrupted. Raises a DataError or OutputError."""
        with alone(self._root):
            for folder, meta in trials_of(self._root, self._person):
                if meta.get("state") == RECORDING:
                    self._say(
                        f"{folder}: {', '.join(repaired(folder))}; it is recorded again"
                    )

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
            **given,
            source=url,
            protocol=self._card.name,
            seed=0,
            trials=1,
            at_once=True,
        )

    def _say(self, line: str) -> None:
        """Messages of the recorder; those that every trial would repeat, once."""
        if line in self._said and line.startswith((NO_PRIORITY, REVERSED)):
            return
        self._said.add(line)
        self._tell(line)
