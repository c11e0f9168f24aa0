"""A study on a virtual clock: an operator who types when the console waits, and protocols."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from recorder_bench import meta_of, never

from holdfast.cli.command import Parser
from holdfast.cli.people import add_study_arguments
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.sessions.recorder.plan import RecordOptions
from holdfast.sessions.recorder.terminal import Display, Keys, RunContext
from holdfast.sessions.study.protocol import StudyProtocol, read_study
from holdfast.sessions.study.run import require_consistent, run_parts

TALK = """
title = "Two steps of talk"
before = ["Paper and pen"]
[[steps]]
title = "Welcome"
kind = "say"
minutes = 2
say = "Hello."
[[steps]]
kind = "questions"
minutes = 1
[[steps]]
kind = "mount"
minutes = 1
"""
TRIALS = """
title = "Two objects"
[objects.soft-ball]
name = "soft ball"
actions = ["pass", "pull"]
[objects.hard-ball]
actions = ["fall"]
[actions.pull]
how = "pull it away"
[[steps]]
title = "Welcome"
kind = "say"
minutes = 1
[[steps]]
objects = ["soft-ball", "hard-ball"]
begin_object = "Start the video"
[[steps.each]]
title = "Training"
kind = "video"
minutes = 0.5
show = "{object}"
[[steps.each]]
title = "Testing"
kind = "record"
minutes = 2
repetitions = 2
hand_over = "{object}"
"""


class Typing(Keys):
    """Types while the console waits, a key every `pause_s`; in_trials: by the sample of all trials.

    After its last key none can be pressed any more.
    """

    def __init__(
        self,
        clock: VirtualClock,
        typed: str,
        *,
        pause_s: float = 20.0,
        in_trials: Mapping[int, str] | None = None,
    ) -> None:
        super().__init__(None)
        self.clock, self.pause_s = clock, pause_s
        self.typed = [bytes([byte]) for byte in typed.encode()]
        self.in_trials, self.samples = in_trials or {}, 0

    @property
    def closed(self) -> bool:
        return not self.typed

    def ended(self) -> bool:
        return self.closed

    def byte(self, wait_s: float = 0.0) -> bytes:
        if wait_s == 0.0:
            self.samples += 1
            return self.in_trials.get(self.samples, "").encode()
        self.clock.spend(round(1e9 * self.pause_s))
        return self.typed.pop(0) if self.typed else b""


def protocol_of(folder: Path, text: str) -> Path:
    """A protocol on the disk."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "protocol.toml"
    path.write_text(text, encoding="utf-8")
    return path


def options(protocol: Path, out: Path, *words: object) -> argparse.Namespace:
    """The options of the verb."""
    parser = Parser(prog="holdfast study")
    add_study_arguments(parser)
    given = [protocol, "--out", out, "--person", "p01", *words]
    return parser.parse_args([str(one) for one in given])


class Study:
    """One person's study in a folder, run as often as a test wants."""

    def __init__(
        self,
        folder: Path,
        text: str = TALK,
        source: object = "virtual://ft232h",
        *words: object,
    ) -> None:
        self.path, self.out = protocol_of(folder, text), folder / "study"
        self.protocol: StudyProtocol = read_study(self.path)
        self.args = options(self.path, self.out, "--source", source, *words)
        self.home = self.out / self.args.person
        self.messages: list[str] = []

    def run(
        self,
        typed: str,
        *,
        stopped: Callable[[], bool] = never,
        show: Any = None,
        **typing: Any,
    ) -> str:
        """One run of the program, with these keys; returns how it ended."""
        clock = VirtualClock(7_000_000_000)
        keys = Typing(clock, typed, **typing)
        display = Display(self.messages.append)
        if show is not None:
            display.show = show  # type: ignore[method-assign]
        chosen = RecordOptions.of(self.args)
        require_consistent(chosen, self.protocol)
        context = RunContext(clock, keys, display, stopped)
        return run_parts(chosen, self.protocol, context)

    def entries(self, *events: str) -> list[dict[str, Any]]:
        """The lines of the journal, of all events or of some."""
        text = (self.home / "study.jsonl").read_text("utf-8")
        lines = [json.loads(line) for line in text.splitlines()]
        return [one for one in lines if not events or one["event"] in events]

    def done(self) -> list[int]:
        """The parts that were done, in order."""
        return [entry["part"] for entry in self.entries("done")]

    def states(self) -> dict[str, str]:
        """Trial -> its state."""
        return {
            path.parent.relative_to(self.home).as_posix(): meta_of(path.parent)["state"]
            for path in sorted(self.home.rglob("trial_*/meta.json"))
        }
