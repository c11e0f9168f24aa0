"""The wearer's command next to the sensors: the stream behind the URL of --intent, and its log.

unix:///PATH or lsl://NAME. The log of `holdfast run
--samples FILE` is FILE.intent.csv.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from holdfast.core.contract import CommandLink
from holdfast.core.errors import UsageError
from holdfast.core.hand_lines import line_port
from holdfast.core.trial_layout import intent_path
from holdfast.edge_runtime.commands import Command
from holdfast.edge_runtime.intent import (
    INTENT_HEADER,
    IntentMonitor,
    PortIntent,
    intent_row,
)
from holdfast.live.outputs import STOPPED, SampleFile, file_sink

ADDRESSES = "unix:///run/holdfast/intent or lsl://NAME"


class IntentLog:
    """An output: a file of the items that came at each sample.

    path: of the samples; the log is a new file next to it. now_ns: the run's clock. Raises
    OutputError.
    """

    def __init__(
        self,
        path: Path,
        intent: IntentMonitor,
        now_ns: Callable[[], int],
        samples: SampleFile,
    ) -> None:
        self.sink = file_sink(intent_path(path), "--intent", INTENT_HEADER)
        self._intent = intent
        self._now_ns = now_ns
        self._samples = samples

    def write(
        self, prediction: object = None, sample: object = None, reading: object = None
    ) -> None:
        """The items of one sample, on the time axis of the samples' file."""
        first_ns = self._samples.first_ns
        # without a first sample there is no time axis for the items yet
        if first_ns is None or self.sink.failure is not None:
            return
        # the file has both times of an item: a run with a scene has a clock of its own
        after_ns = time.monotonic_ns() - self._now_ns()
        for item in self._intent.fresh:
            self.sink(intent_row(item, first_ns, after_ns))

    def close(self, reason: str = STOPPED) -> None:
        """Wait for the last lines."""
        self.sink.close()


@contextmanager
def intent_monitor(
    url: str | None,
    clock: Any,
    report: Callable[[str], None],
) -> Iterator[IntentMonitor | None]:
    """The stream of --intent, opened; None without it.

    Raises UsageError, DeviceNotFound, LibraryMissing.
    """
    if url is None:
        yield None
    elif url.startswith("lsl://"):
        from holdfast.drivers.lsl import LslIntent
        from holdfast.drivers.lsl_library import LslInlet

        with closing(LslInlet(_stream_name(url))) as inlet:
            stream = LslIntent(inlet, clock.now_ns, report)
            yield IntentMonitor(stream, clock.now_ns, report)
    else:
        with line_port(url, "intent", report, clock.now_ns) as port:
            words = PortIntent(port, clock.now_ns)
            yield IntentMonitor(words, clock.now_ns, report)


def _stream_name(url: str) -> str:
    name = unquote(url.removeprefix("lsl://"))
    if not name or "'" in name:
        raise UsageError(
            f"--intent {url[:80]!r}: no name of a stream", next_step="lsl://NAME"
        )
    return name


def intended(
    command: Callable[[], Command], intent: IntentMonitor, *, obeyed: bool
) -> Callable[[], Command]:
    """A command that also looks at the stream, once a sample, and adds its word if obeyed."""

    def ask() -> Command:
        # also where it is not obeyed: the display and the log need the newest item
        intent.look()
        given = command()
        if not obeyed:
            return given
        # either may open the hand, and neither keeps the other from it
        opening = given.opening or intent.opening
        return replace(given, opening=opening, link=_worse(given.link, intent.link))

    return ask


def _worse(one: CommandLink, other: CommandLink) -> CommandLink:
    """An expired sender is never hidden by another that is live."""
    # from the worst on: a sender that is not there at all is no fault
    order: tuple[CommandLink, ...] = ("expired", "live", "none")
    return min(one, other, key=order.index)
