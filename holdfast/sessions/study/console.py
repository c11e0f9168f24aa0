"""The operator's console: messages, single keys, and lines of text, on a terminal or a pipe."""

from __future__ import annotations

from enum import StrEnum

from holdfast.core.errors import visible
from holdfast.sessions.recorder.terminal import (
    ESCAPE,
    TEXT,
    TEXT_IS_NO_KEY,
    RunContext,
    pasted,
)


class Key(StrEnum):
    """What the operator wants next."""

    NEXT = "next"
    SKIP = "skip"
    REPEAT = "repeat"
    NOTE = "note"
    ADVERSE = "adverse"
    QUIT = "quit"


ADVERSE = "a"
"""The key of an adverse event, in a trial too."""
KEYS = {
    " ": Key.NEXT,
    "\n": Key.NEXT,
    "s": Key.SKIP,
    "r": Key.REPEAT,
    "n": Key.NOTE,
    ADVERSE: Key.ADVERSE,
    "q": Key.QUIT,
}
HELP = "keys: space goes on, s skip, r repeat, n note, a adverse event, q quit"
WAIT_S = 0.1
"""How long a look at the keys waits, so that a signal is seen at once."""
REDRAW_S = 1.0
"""Between two draws of the countdown."""
ENTER = b"\n\r"
"""A terminal sends CR or LF, a pipe LF."""
ERASE = b"\x7f\x08"
NO_KEY = "no key can be pressed any more; run the same command again to go on here"


class Console:
    """The operator at a terminal, or what types in a pipe."""

    def __init__(self, context: RunContext) -> None:
        self.keys = context.keys
        self.report = context.display.report
        self._draw = context.display.draw
        self._clock = context.clock
        self._stopped = context.stopped

    def key(self, left_s: float) -> Key:
        """What to do next; QUIT after a signal or where the terminal is gone.

        left_s: planned time that is left in this part.
        """
        began_ns = self._clock.now_ns()
        drawn_s = -REDRAW_S
        while not self._stopped():
            spent_s = 1e-9 * (self._clock.now_ns() - began_ns)
            if spent_s >= drawn_s + REDRAW_S:
                drawn_s = spent_s
                self._draw(countdown(left_s - spent_s))
            letter = self.keys.choice(KEYS, WAIT_S)
            if letter in KEYS:
                return KEYS[letter]
            if letter == TEXT:
                self.report(TEXT_IS_NO_KEY)
            # Without keys the study would wait for ever.
            if self.keys.closed:
                self.report(NO_KEY)
                break
        return Key.QUIT

    def text(self, prompt: str) -> str | None:
        """A line that is shown as it is typed: "" where it is empty or Escape drops it.

        Pasted lines become one. None where no key can be pressed any more.
        """
        # Also the letters of URGENT: in a text they are letters.
        self.keys.forgotten()
        self.report(prompt)
        typed = b""
        drawn = None
        key = b""
        while not self._stopped():
            if typed != drawn:
                # The end of a long text: that is where the next letter appears.
                self._draw(f"> {visible(typed.decode('utf-8', 'replace'))[-60:]}")
                drawn = typed
            # With a time limit, so that a signal ends the question too.
            key = key or self.keys.key(WAIT_S)
            if key and key in ENTER:
                # A line end that more follows at once was pasted.
                key = self.keys.following()
                if key:
                    typed += b" "
                    continue
                line = typed.decode("utf-8", "replace").strip()
                self.report(f"> {line}")
                return line
            if key == ESCAPE:
                return ""
            if not key and self.keys.closed:
                self.report(NO_KEY)
                return None
            typed = _typed(typed, key)
            key = b""

        return None


def _typed(text: bytes, key: bytes) -> bytes:
    """What a key makes of a text: a letter is added; arrows and control characters do nothing."""
    if key and key in ERASE:
        # A letter of several bytes goes as a whole.
        return text.decode("utf-8", "ignore")[:-1].encode()
    # Control characters would move the cursor of the reader.
    is_letter = len(key) == 1 and key >= b" "
    return text + (key if is_letter else pasted(key))


def countdown(left_s: float) -> str:
    """Planned time that is left of a part, or how far it is over."""
    what = "left" if left_s >= 0.0 else "over"
    return f"{clock_text(abs(left_s))} {what}"


def clock_text(seconds: float) -> str:
    """Minutes and seconds.

    >>> clock_text(125.0)
    '2:05'
    """
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
