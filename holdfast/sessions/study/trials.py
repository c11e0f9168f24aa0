"""The recording steps: each trial is one run of the recorder, with its own code and layout.

A virtual participant: the scene of a source, and the trial of it that fits what is recorded.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from urllib.parse import parse_qs

from holdfast.core.errors import UsageError
from holdfast.core.source import SourceReading
from holdfast.core.trial_layout import DISCARDED, META
from holdfast.live.running import NO_PRIORITY
from holdfast.live.source_url import SIM, split_url
from holdfast.live.sources import force_of, open_live
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
from holdfast.sessions.recorder.labels import read_meta
from holdfast.sessions.recorder.plan import Plan, RecordOptions
from holdfast.sessions.recorder.protocol import NOTHING, Task
from holdfast.sessions.recorder.recording import kind_of, record_plan
from holdfast.sessions.recorder.session import Display, RunContext
from holdfast.sessions.recorder.trial import TrialRecorder
from holdfast.sessions.set_source import read_set_trial
from holdfast.sessions.study.console import TrialKeys
from holdfast.sessions.study.protocol import StudyProtocol

REVERSED = "warning: the magnet is reversed"
REPEATED = (NO_PRIORITY, REVERSED)
"""How messages begin that every trial would repeat."""


def scene_in(url: str) -> tuple[str, int] | None:
    """(name, seed) of a source whose scene's trials can be chosen; None where it names a trial."""
    if "://" not in url:
        return None

    parts = split_url(url)
    options = parse_qs(parts.query, keep_blank_values=True)
    # The user chose the trial: it is taken as it is.
    if "trial" in options or "trials" in options:
        return None

    name = options.get("scene", [""])[-1]
    if url.startswith(SIM):
        name = parts.netloc + parts.path
    # The last of repeated options counts, as it does where the source is opened.
    seed = options.get("seed", ["0"])[-1]
    if parts.scheme in ("sim", "virtual") and name and seed.isdecimal():
        return name, int(seed)

    return None


def url_for(url: str, task: Task, nth: int) -> str:
    """The source of the n-th trial of a task, from 0; the URL itself where it has no scene.

    A scene's trials of that object and action come in turn. Raises UsageError where it has none.
    """
    scene = scene_in(url)
    if scene is None:
        return url

    wanted = task.object, task.action
    fitting = [k for k, trial in enumerate(_scene_trials(*scene)) if trial == wanted]
    if not fitting:
        raise UsageError(
            f"the scene {scene[0]} has no trial of {task.object}, {task.action}",
            cause="a scene with other objects or actions than the protocol's",
            next_step="take a scene with them, such as sim://p1 for the protocol thesis",
        )

    # A scene may have fewer trials than the protocol asks for; they come again in turn.
    trial = fitting[nth % len(fitting)]
    separator = "&" if "?" in url else "?"
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


class _ReportedOnce(Display):
    """Shows what another display shows, but reports only once what every trial would repeat."""

    def __init__(self, display: Display) -> None:
        super().__init__(display.report)
        self._display = display
        self._reported: set[str] = set()

    def report(self, line: str) -> None:
        # Only these: a repeated error must be seen every time.
        if line in self._reported and line.startswith(REPEATED):
            return
        self._reported.add(line)
        super().report(line)

    def show(self, trial: TrialRecorder, measured: SourceReading, now_ns: int) -> None:
        self._display.show(trial, measured, now_ns)


@dataclass
class Trials:
    """Records and counts the trials of one person. options: of every trial."""

    options: RecordOptions
    protocol: StudyProtocol
    context: RunContext
    display: Display = field(init=False)

    def __post_init__(self) -> None:
        self.display = _ReportedOnce(self.context.display)
        self.root = self.options.out
        self.person = self.options.person

    def require_hand(self) -> None:
        """Open the source once, so that a hand that does not answer is seen before the person is.

        It also makes the folder of recordings. Raises the errors of the source, and UsageError for
        a virtual participant who does not do what the protocol asks for.
        """
        tasks = [part.task for part in self.protocol.parts if part.task]
        urls = [url_for(self.options.source, task, 0) for task in tasks]
        url = urls[0] if urls else self.options.source
        # Simulated or recorded, as it stands in the folder's meta.json
        kind = kind_of(url)
        # Simulated and recorded trials in one folder would be scored together.
        before = read_meta(self.root).get("kind", kind)
        if before != kind:
            raise UsageError(
                f"{self.root}: holds trials that are {before}, these would be {kind}",
                next_step="name another folder, so that rehearsals stay apart from people",
            )

        # A later run of the study: the hand is opened with its first trial.
        if (self.root / META).exists():
            return

        source = open_live(
            url,
            clock=self.context.clock,
            report=self.display.report,
            to_force=force_of(self.options.calibration),
            read_set=read_set_trial,
        )
        # Closed at once: every trial opens the hand for itself.
        with closing(source), opened(self.root, source.unit, kind):
            n_sensors = source.n_channels // 3
            self.display.report(
                f"the hand answers: {n_sensors} sensors, in {source.unit}"
            )

    def repair(self) -> None:
        """Mark trials that a kill left as interrupted. Raises a DataError or OutputError."""
        with alone(self.root):
            for folder, meta in trials_of(self.root, self.person):
                if meta.get("state") == RECORDING:
                    repaired = ", ".join(repair(folder))
                    self.display.report(f"{folder}: {repaired}; it is recorded again")

    def kept(self, task: Task) -> int:
        """How many trials of a task are kept."""
        return done(self.root, self.person).count(task)

    def record(self, task: Task, keys: TrialKeys) -> None:
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
        context = replace(
            self.context,
            keys=keys,
            display=self.display,
            # A key that ends a trial at once, such as an adverse event, stops it as a signal
            # does.
            stopped=lambda: stopped() or keys.ends,
        )
        protocol = self.protocol.recording_protocol()
        record_plan(options, Plan(protocol, [task], self.kept(task)), context)

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
