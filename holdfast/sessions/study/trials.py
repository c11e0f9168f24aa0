"""The recording steps: each trial is one run of the recorder, with its own code and layout.

A virtual participant: the trial of a source's scene that fits what is recorded.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

from holdfast.core.errors import UsageError
from holdfast.core.trial_layout import DISCARDED
from holdfast.live.hand_files import force_of
from holdfast.live.sources import open_live
from holdfast.sessions.recorder.folder import (
    KEPT,
    RECORDING,
    alone,
    discard,
    done,
    number,
    opened,
    repair,
    task_folder,
    trials_of,
)
from holdfast.sessions.recorder.plan import Plan, RecordOptions
from holdfast.sessions.recorder.protocol import NOTHING, Task
from holdfast.sessions.recorder.recording import kind_of, record_plan
from holdfast.sessions.recorder.session import RunContext
from holdfast.sessions.set_source import read_set_trial
from holdfast.sessions.study.console import ADVERSE
from holdfast.sessions.study.protocol import StudyProtocol


def url_for(url: str, task: Task, nth: int) -> str:
    """The source of the n-th trial of a task, from 0: a scene's trials of it come in turn.

    The URL itself where it has no scene, or names a trial. Raises UsageError where a scene has no
    such trial.
    """
    parts = urlsplit(url)
    options = dict(parse_qsl(parts.query))
    scene = options.get("scene", "")
    if parts.scheme == "sim":
        scene = parts.netloc + parts.path
    seed = options.get("seed", "0")
    is_chosen = "trial" in options or "trials" in options
    if parts.scheme not in ("sim", "virtual") or not scene or is_chosen:
        return url

    fitting = []
    for k, (name, action) in enumerate(_scene_trials(scene, int(seed))):
        if (name, action) == (task.object, task.action):
            fitting.append(k)
    if not fitting:
        raise UsageError(
            f"the scene {scene} has no trial of {task.object}, {task.action}",
            cause="a scene with other objects or actions than the protocol's",
            next_step="take a scene with them, such as sim://p1 for the protocol thesis",
        )

    # A scene may have fewer trials than the protocol asks for.
    trial = fitting[nth % len(fitting)]
    separator = "&" if parts.query else "?"
    return f"{url}{separator}trial={trial}"


@lru_cache(maxsize=1)
def _scene_trials(name: str, seed: int) -> list[tuple[str, str]]:
    """(object, action) of each trial of a scene. Raises CardError."""
    from holdfast.simulation.scene import Scene
    from holdfast.simulation.scene_file import read_scene_file

    trials = []
    for trial in Scene(read_scene_file(name), seed).trials():
        # A scene names an object even for the empty hand.
        held = NOTHING if trial.action == NOTHING else trial.object.name
        trials.append((held, trial.action))
    return trials


@dataclass
class Trials:
    """Records and counts the trials of one person. options: of every trial."""

    options: RecordOptions
    protocol: StudyProtocol
    context: RunContext

    def __post_init__(self) -> None:
        self.root = self.options.out
        self.person = self.options.person
        self.report = self.context.display.report

    def require_hand(self) -> None:
        """Open the source once, so that a hand that does not answer is seen before the person is.

        It also makes the folder of recordings. Raises the errors of the source, and UsageError for
        a virtual participant who does not do what the protocol asks for.
        """
        tasks = [part.task for part in self.protocol.parts if part.task]
        urls = [url_for(self.options.source, task, 0) for task in tasks]
        url = urls[0] if urls else self.options.source
        source = open_live(
            url,
            clock=self.context.clock,
            report=self.report,
            to_force=force_of(self.options.calibration),
            read_set=read_set_trial,
        )
        # Closed at once: every trial opens the hand for itself.
        with closing(source), opened(self.root, source.unit, kind_of(url)):
            n_sensors = source.n_channels // 3
            self.report(f"the hand answers: {n_sensors} sensors, in {source.unit}")

    def repair(self) -> None:
        """Mark trials that a kill left as interrupted. Raises a DataError or OutputError."""
        for folder, meta in trials_of(self.root, self.person):
            if meta.get("state") == RECORDING:
                repaired = ", ".join(repair(folder))
                self.report(f"{folder}: {repaired}; it is recorded again")

    def kept(self, task: Task) -> int:
        """How many trials of a task are kept."""
        return done(self.root, self.person).count(task)

    def record(self, task: Task) -> None:
        """Record one trial. Raises a HoldfastError; the study may go on after it."""
        # Discarded trials count, so that a repeated trial of a scene is another one.
        options = replace(
            self.options,
            source=url_for(self.options.source, task, self._begun(task)),
            protocol=self.protocol.name,
            trials=1,
            at_once=True,
        )
        stopped = self.context.stopped
        keys = self.context.keys
        # An adverse event stops a trial at once, as a signal does; and after a redo the operator
        # says when the next one begins.
        context = replace(
            self.context, stopped=lambda: stopped() or keys.last in (ADVERSE, "r")
        )
        plan = Plan(self.protocol, [task], self.kept(task))
        record_plan(options, plan, context)

    def discard_last(self, task: Task) -> Path:
        """Move the last kept trial of a task to the discarded ones; returns its new path."""
        place = task_folder(self.root, self.person, task)
        kept = []
        with alone(self.root):
            for folder, meta in trials_of(self.root, self.person):
                if folder.parent == place and meta.get("state") == KEPT:
                    kept.append(folder)
            # The highest number is the newest.
            return discard(self.root, self.person, max(kept, key=number))

    def _begun(self, task: Task) -> int:
        """How many trials of a task were begun, the discarded ones counted too."""
        home = self.root / self.person
        place = task_folder(self.root, self.person, task)
        moved = home / DISCARDED / place.relative_to(home)
        return len([*place.glob("trial_*"), *moved.glob("trial_*")])
