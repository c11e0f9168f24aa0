"""What the live page knows: the last 30 s of samples, messages and marks; and frames of them.

All browsers get the same frames. A frame has the newest sample and a short row for each sample
since the frame before, so that no risky sample falls between two frames. A browser that was stalled
for longer than the frames are kept begins anew with a whole picture; none holds up another.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Iterator
from threading import Condition
from typing import Any

Message = dict[str, Any]

KEPT_S, SHOWN_S = 30.0, 10.0
"""How long losses are counted, and how much a new browser sees."""
FRAME_S = 0.06
"""The time between two frames: shorter than a display is read."""
KEPT_FRAMES = 32
"""About two seconds of frames for a slow browser."""
MOST_SAID = 40
"""Lines that the page shows and a new browser gets; older ones are forgotten."""
MOST_MARKS = 100
"""Marks that are kept; the oldest is forgotten first."""
ROW_FIELDS = ("t_s", "state", "p_risky", "load", "grip", "target", "act")
"""What a row of a frame has, in this order; null where it is not known."""
SIGNIFICANT = 6
"""Digits of a shown number."""


class LiveStream:
    """The samples and messages of one run. about: what the page shows of it once.

    One thread takes messages and publishes; any thread reads.
    """

    def __init__(self, about: Message) -> None:
        self.about = about
        self.ended = ""
        self._changed = Condition()
        self._samples: deque[Message] = deque()
        self._rows: deque[list[Any]] = deque()
        self._fresh: list[list[Any]] = []
        self._lines: deque[str] = deque(maxlen=MOST_SAID)
        self._marks: deque[Message] = deque(maxlen=MOST_MARKS)
        self._ready: Message | None = None
        self._news: Message = {}
        self._frames: deque[bytes] = deque(maxlen=KEPT_FRAMES)
        self._count = 0
        self._over = False
        self._first_ns: int | None = None
        self._came_s: float | None = None

    # -- from the run

    def take(self, message: Message, now_s: float) -> None:
        """One message of the run (link.py), at now_s of a monotonic clock."""
        with self._changed:
            if "sample" in message:
                self._take_sample(message["sample"], now_s)
            if "said" in message:
                line = message["said"]
                self._lines.append(line)
                self._news.setdefault("said", []).append(line)
            if "mark" in message:
                mark = dict(message["mark"])
                # the page counts from the first sample, the run in ns of its clock
                mark["t_s"] = self._since_start(mark["t_ns"])
                self._marks.append(mark)
                self._news.setdefault("marks", []).append(mark)
            if "ready" in message:
                self._ready = self._news["ready"] = message["ready"]
            if "about" in message:
                self.about = {**self.about, **message["about"]}
                self._news["about"] = self.about
            # the first reason counts: what follows a stop is only its consequence
            self.ended = self.ended or message.get("end", "")

    def _take_sample(self, sample: Message, now_s: float) -> None:
        self._came_s = now_s
        self._ready = None
        t_ns = sample["t_ns"]

        # time never goes back within a run, so this is the first sample of another one
        if self._samples and t_ns < self._samples[-1]["t_ns"]:
            self._forget()
        if self._first_ns is None:
            self._first_ns = t_ns
        self._samples.append(sample)

        # by time and not by count: the rate of a hand may change while it runs
        oldest_ns = t_ns - 1e9 * KEPT_S
        while self._samples[0]["t_ns"] < oldest_ns:
            self._samples.popleft()

        row = self._row(sample)
        self._rows.append(row)
        self._fresh.append(row)
        # a new browser shows the last 10 s, and gets no rows beyond them
        while self._rows[0][0] < row[0] - SHOWN_S:
            self._rows.popleft()

    def _forget(self) -> None:
        """Begin anew, where the stream's clock went back (holdfast/live/loop.py: restarts)."""
        for kept in (self._samples, self._rows, self._fresh, self._marks):
            kept.clear()
        self._first_ns = None
        self._news["restarts"] = True

    def publish(self, now_s: float) -> None:
        """Make a frame of everything new, and wake the browsers' threads."""
        with self._changed:
            frame = self._now(now_s)
            frame["rows"] = self._fresh
            # messages and marks are rare, so a frame has these keys only where they changed
            frame |= self._news
            self._frames.append(event("frame", frame))
            self._count += 1
            self._fresh = []
            self._news = {}
            # only now: the frame that shows the end must be sent before a browser's loop stops
            self._over = bool(self.ended)
            self._changed.notify_all()

    # -- to a browser

    def frames(self) -> Iterator[bytes]:
        """Events for one browser: a whole picture, then frames as they come; ends with the run."""
        with self._changed:
            seen = self._count
            first = self._whole()

        yield first

        while True:
            with self._changed:
                while self._count == seen and not self._over:
                    self._changed.wait()
                # how many frames were made since this browser took its last one
                missed = self._count - seen
                seen = self._count
                over = self._over

                # frames that this browser needs are gone: it begins with a whole picture
                if missed > len(self._frames):
                    newest = [self._whole()]
                else:
                    newest = list(self._frames)[-missed:]
            # sent without the lock, so that a stalled browser holds up no other
            yield b"".join(newest)
            if over:
                return

    def _whole(self) -> bytes:
        picture = self._now(self._came_s or 0.0)
        picture["about"] = {**self.about, "rows": ROW_FIELDS, "shown_s": SHOWN_S}
        picture["rows"] = list(self._rows)
        picture["said"] = list(self._lines)
        picture["marks"] = list(self._marks)
        picture["ready"] = self._ready
        return event("whole", picture)

    def _now(self, now_s: float) -> Message:
        """The newest sample as it is shown, how long none has come, and losses."""
        silent_s = None
        if self._came_s is not None:
            silent_s = _shown(now_s - self._came_s)
        sample = self._as_shown(self._samples[-1]) if self._samples else None
        return {"silent_s": silent_s, "sample": sample, "ended": self.ended}

    def _as_shown(self, sample: Message) -> Message:
        """A sample as the browser gets it: forces by finger, losses, and the last second."""
        shown = dict(sample)
        # the samples of a recording session have no number
        for name in ("x", "t_ns", "n"):
            shown.pop(name, None)
        values = [_shown(value) for value in sample["x"]]
        forces = [values[k : k + 3] for k in range(0, len(values), 3)]
        shown["t_s"] = self._since_start(sample["t_ns"])
        shown["forces"] = forces
        # `lost` counts from the start of the run, so the difference is that of the kept samples
        shown["lost_30s"] = sample["lost"] - self._samples[0]["lost"]
        return shown | _last_second(self._samples)

    def _row(self, sample: Message) -> list[Any]:
        """The fields of ROW_FIELDS."""
        answer = sample.get("answer", {})
        grip = sample.get("grip", {})
        load, squeeze = sums(sample["x"], sample["v"])
        # a probability of an unknown state would look like an answer
        p_risky = None
        if answer.get("state") != "unknown":
            p_risky = answer.get("p_risky")
        # in the order of ROW_FIELDS: a name in each row would make frames larger
        return [
            self._since_start(sample["t_ns"]),
            answer.get("state"),
            _shown(p_risky),
            _shown(load),
            _shown(squeeze),
            _shown(grip.get("target_n")),
            int(answer.get("act", False)),
        ]

    def _since_start(self, t_ns: int) -> float:
        first_ns = t_ns if self._first_ns is None else self._first_ns
        return round(1e-9 * (t_ns - first_ns), 4)


def sums(values: list[float], valid: list[int]) -> tuple[float, float]:
    """(load, grip) of a sample: force along the skin, all fingers; half of all normal forces.

    Fingers that are not valid do not count, as in holdfast/edge_runtime/grip_control.py.
    """
    load = 0.0
    squeeze = 0.0
    for k, good in enumerate(valid):
        x, y, z = values[3 * k : 3 * k + 3]
        if good and math.isfinite(x + y + z):
            load += math.hypot(x, y)
            # a finger cannot pull at an object: what is below zero is noise
            squeeze += max(z, 0.0)

    # thumb and fingers press against each other, so the grip of either side is half of both
    return load, 0.5 * squeeze


def event(name: str, content: Message) -> bytes:
    """A server-sent event. Its JSON has no number that JavaScript cannot read."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return f"event: {name}\ndata: {text}\n\n".encode()


def _shown(value: float | None) -> float | None:
    """With few digits; None where it is no finite number."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{SIGNIFICANT}g}")


def _last_second(samples: deque[Message]) -> Message:
    """Rate of the last second, Hz, and the median and largest latency of its answers, ms."""
    newest_ns = samples[-1]["t_ns"]
    begin_ns = newest_ns
    count = 0
    late_us = []
    # from the newest back, so that the cost does not grow with what is kept
    for sample in reversed(samples):
        if newest_ns - sample["t_ns"] >= 1_000_000_000:
            break
        begin_ns = sample["t_ns"]
        count += 1
        if "answer" in sample:
            late_us.append(sample["answer"]["latency_us"])

    rate_hz = latency_ms = worst_ms = None
    if newest_ns > begin_ns:
        # `count` samples span one period fewer than their number
        rate_hz = round(1e9 * (count - 1) / (newest_ns - begin_ns), 1)

    if late_us:
        late_us.sort()
        latency_ms = _shown(1e-3 * late_us[len(late_us) // 2])
        worst_ms = _shown(1e-3 * late_us[-1])

    return {
        "rate_hz": rate_hz,
        "latency_ms": latency_ms,
        "latency_worst_ms": worst_ms,
    }
