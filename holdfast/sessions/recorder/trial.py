"""One trial while it is recorded: its samples, its events, and its meta.json."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

from holdfast.core.errors import DataError, HoldfastError, OutputError
from holdfast.core.reading import Json
from holdfast.core.source import SourceReading
from holdfast.core.tactile_file import TactileFile
from holdfast.core.trial_layout import EVENTS, META, TACTILE, intent_path
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.intent import IntentMonitor, intent_header, intent_row
from holdfast.sessions.recorder.about import Quality, QualityFigures
from holdfast.sessions.recorder.folder import FORMAT, INTERRUPTED, KEPT, RECORDING
from holdfast.sessions.recorder.labels import truth_in, write_truth


@dataclass(frozen=True)
class ClosedTrial:
    """How a trial ended. state: as in meta.json. why: of an interrupted trial, else empty."""

    quality: QualityFigures
    state: str
    why: str


class TrialRecorder:
    """Writes one trial's folder; about: content of meta.json besides state and quality."""

    def __init__(
        self,
        folder: Path,
        n_channels: int,
        about: Json,
        quality: Quality,
        host_after_ns: int,
        intent: IntentMonitor | None = None,
    ) -> None:
        self.folder, self.about, self.quality, self.intent = (
            folder,
            about,
            quality,
            intent,
        )
        self._host_after_ns = host_after_ns
        self.t_s = 0.0
        self._write_meta(RECORDING)
        self._file = TactileFile(folder / TACTILE, n_channels)
        self._events = (folder / EVENTS).open("a", encoding="utf-8", buffering=1)
        self._beside = None if intent is None else self._open_intent(intent)

    @property
    def started(self) -> bool:
        """Whether there is a sample."""
        return self._file.rows > 0

    @property
    def span_ns(self) -> tuple[int, int]:
        """Times of the first and the last sample on the recorder's clock."""
        return self.quality.times_ns[0], self.quality.times_ns[-1]

    def write(self, t_ns: int, sequence: int, measured: SourceReading) -> None:
        """Write one sample. Raises OutputError."""
        host_ns = t_ns + self._host_after_ns
        self.t_s = self._file.write(
            t_ns, host_ns, sequence, measured.values, measured.valid
        )
        self.quality.take(t_ns, measured)

    def write_intent(self) -> None:
        """Look at the wearer's own command, and write what came. Raises OutputError."""
        if self.intent is None or self._beside is None:
            return
        self.intent.look()
        if not self.started:
            return
        count = self.intent.n_envelopes
        for item in self.intent.fresh:
            row = intent_row(item, self.span_ns[0], self._host_after_ns, count)
            self._line(self._beside, row)

    def _open_intent(self, intent: IntentMonitor) -> TextIO:
        file = intent_path(self.folder / TACTILE).open(
            "x", encoding="utf-8", buffering=1
        )
        self._line(file, intent_header(intent.n_envelopes))
        return file

    def _line(self, file: TextIO, line: str) -> None:
        try:
            file.write(line + "\n")
        except OSError as error:
            what = f"cannot write ({error.strerror})"
            raise OutputError(
                what, where=Path(file.name), next_step="make room"
            ) from None

    def mark(self, name: str, now_ns: int, provenance: str = "key") -> float:
        """Note that an event happens now; returns its time from the first sample, s."""
        at_s = round(1e-9 * (now_ns - self.span_ns[0]), 6)
        self.note(
            {
                "t_s": at_s,
                "mark": name,
                "provenance": provenance,
                "by": "holdfast record",
            }
        )
        return at_s

    def note(self, event: Json) -> None:
        """Write a line of events.jsonl. Raises OutputError."""
        self._line(self._events, json.dumps(event))

    def close(
        self, state: str, over: str = "", *, why: str = "", camera: Json | None = None
    ) -> ClosedTrial:
        """Flush everything, write meta.json and, of a kept trial, its phases.

        over: why the samples ended, if not by the operator. Such a trial is interrupted, not kept,
        if it is incomplete; so is one that cannot be read again (a single row, most of it lost).
        why: of the state. camera: what the camera's process left. Raises OutputError.
        """
        figures = self.quality.figures()
        self._close_files()
        if state == KEPT:
            why = self._label(over)
            state = INTERRUPTED if why else KEPT
        filmed = {} if camera is None else {"camera": camera}
        self._write_meta(
            state, quality=asdict(figures), **filmed, **({"why": why} if why else {})
        )
        return ClosedTrial(figures, state, why)

    def _close_files(self) -> None:
        """Flush and close them; nothing where that was tried before. Raises OutputError."""
        if self._events.closed:
            return
        try:
            self._file.close()
            os.fsync(self._events.fileno())
        finally:
            for file in (self._events, self._beside):
                with suppress(OSError):
                    if file is not None:
                        file.close()

    def _label(self, over: str) -> str:
        """Write the phases of a trial to keep; returns why it cannot be kept, or nothing."""
        unfinished = f"{over} before the trial was complete"
        try:
            truth = truth_in(self.folder)
        except DataError as error:
            return unfinished if over else str(error)
        if over and not truth.is_complete(self.about["action"]):
            return unfinished
        write_truth(self.folder, truth)
        return ""

    def give_up(self, state: str, why: str) -> None:
        """Close as far as possible after an error, which the caller raises."""
        with suppress(HoldfastError, OSError):
            if (
                not self._events.closed
            ):  # the error may have come after they were closed
                self.note({"t_s": self.t_s, "event": state, "why": why})
        with suppress(HoldfastError, OSError):
            self.close(state, why=why)

    def _write_meta(self, state: str, **more: Any) -> None:
        meta = {"recorder": FORMAT, "state": state, **self.about, **more}
        write_whole(self.folder / META, json.dumps(meta, indent=1, default=str) + "\n")
