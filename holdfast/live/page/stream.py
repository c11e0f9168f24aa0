"""What the live page knows: the last seconds of samples, the messages, and frames of them.

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

SHOWN_S = 10.0
"""How much a new browser sees."""
FRAME_S = 0.06
"""The time between two frames: shorter than a display is read."""
KEPT_FRAMES = 32
"""About two seconds of frames for a slow browser."""
MOST_SAID = 40
"""Lines that the page shows and a new browser gets; older ones are forgotten."""
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
        self._newest: Message | None = None
        self._rows: deque[list[Any]] = deque()
        self._lines: deque[str] = deque(maxlen=MOST_SAID)
        self._news: Message = {"rows": [], "said": [], "restarts": False}
        self._frames: deque[bytes] = deque(maxlen=KEPT_FRAMES)
        self._count = 0
        self._over = False
        self._first_ns = 0
        self._came_s = math.nan

    # -- from the run

    def take(self, message: Message, now_s: float) -> None:
        """One message of the run (link.py), at now_s of a monotonic clock."""
        with self._changed:
            if "sample" in message:
                self._take_sample(message["sample"])
                self._came_s = now_s
            if "said" in message:
                self._lines.append(message["said"])
                self._news["said"].append(message["said"])
            # the first reason counts: what follows a stop is only its consequence
            self.ended = self.ended or message.get("end", "")

    def _take_sample(self, sample: Message) -> None:
        before_ns = self._newest["t_ns"] if self._newest else math.inf
        # time never goes back within a run (holdfast/live/loop.py: restarts)
        if sample["t_ns"] < before_ns:
            self._rows.clear()
            self._news["rows"] = []
            self._news["restarts"] = True
            self._first_ns = sample["t_ns"]
        self._newest = sample

        row = self._row(sample)
        self._rows.append(row)
        self._news["rows"].append(row)
        # by time and not by count: the rate of a hand may change while it runs
        while self._rows[0][0] < row[0] - SHOWN_S:
            self._rows.popleft()

    def publish(self, now_s: float) -> None:
        """Make a frame of everything new, and wake the browsers' threads."""
        with self._changed:
            self._frames.append(event("frame", self._now(now_s) | self._news))
            self._count += 1
            self._news = {"rows": [], "said": [], "restarts": False}
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

        over = False
        while not over:
            with self._changed:
                while self._count == seen and not self._over:
                    self._changed.wait()
                # how many frames were made since this browser took its last one
                missed = self._count - seen
                seen = self._count
                over = self._over
                # where frames that it needs are gone, it begins with a whole picture
                newest = list(self._frames)[-missed:]
                if missed > len(self._frames):
                    newest = [self._whole()]
            # sent without the lock, so that a stalled browser holds up no other
            yield b"".join(newest)

    def _whole(self) -> bytes:
        picture = self._now(self._came_s)
        picture["about"] = {**self.about, "rows": ROW_FIELDS, "shown_s": SHOWN_S}
        picture["rows"] = list(self._rows)
        picture["said"] = list(self._lines)
        return event("whole", picture)

    def _now(self, now_s: float) -> Message:
        """The newest sample as it is shown, and how long none has come."""
        sample = self._as_shown(self._newest) if self._newest else None
        silent_s = _shown(now_s - self._came_s)
        return {"silent_s": silent_s, "sample": sample, "ended": self.ended}

    def _as_shown(self, sample: Message) -> Message:
        """A sample as the browser gets it: forces by finger, and the rate of the last second."""
        shown = dict(sample)
        values = list(map(_shown, shown.pop("x")))
        shown["forces"] = [values[k : k + 3] for k in range(0, len(values), 3)]
        shown["t_s"] = self._since_start(shown.pop("t_ns"))
        recent = [row[0] for row in self._rows if row[0] > shown["t_s"] - 1.0]
        shown["rate_hz"] = None
        if len(recent) > 1:
            # so many samples span one period fewer
            shown["rate_hz"] = _shown((len(recent) - 1) / (recent[-1] - recent[0]))
        return shown

    def _row(self, sample: Message) -> list[Any]:
        """The fields of ROW_FIELDS."""
        answer = sample["answer"]
        load, squeeze = sums(sample["x"], sample["v"])
        # a probability of an unknown state would look like an answer
        p_risky = None if answer["state"] == "unknown" else answer["p_risky"]
        target = sample.get("grip", {}).get("target_n")
        # in the order of ROW_FIELDS: a name in each row would make frames larger
        return [
            self._since_start(sample["t_ns"]),
            answer["state"],
            *map(_shown, (p_risky, load, squeeze, target)),
            int(answer["act"]),
        ]

    def _since_start(self, t_ns: int) -> float:
        return round(1e-9 * (t_ns - self._first_ns), 4)


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
