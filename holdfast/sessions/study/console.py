"""The operator's desk: messages, single keys, and lines of text, on a terminal or a pipe.

`Desk` is the operator's terminal. `Rehearsal` has no operator: every part takes its planned time on
a clock that jumps, and no question is answered.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from holdfast.core.errors import HoldfastError, visible
from holdfast.sessions.recorder.keys import KEYS as TRIAL_KEYS
from holdfast.sessions.recorder.keys import Keys

NEXT, SKIP, REPEAT, NOTE, ADVERSE = "next", "skip", "repeat", "note", "adverse"
PAUSE, WITHDRAW, QUIT = "pause", "withdraw", "quit"
KEYS = {
    " ": NEXT,
    "\n": NEXT,
    "s": SKIP,
    "r": REPEAT,
    "n": NOTE,
    "a": ADVERSE,
    "p": PAUSE,
    "w": WITHDRAW,
    "q": QUIT,
}
HELP = (
    "keys: space goes on, s skip, r repeat, n note, a adverse event, p pause, w withdraw, q quit "
    "(goes on later)"
)
WAIT_S, REDRAW_S = 0.1, 1.0
ENTER, ERASE, ESCAPE = b"\n\r", b"\x7f\x08", b"\x1b"
LONGEST_TEXT = 1000
LEFT_OUT = "-"
"""Typed where a question is not to be answered."""
NO_KEY = "no key can be pressed any more; run the same command again to go on here"


class TrialKeys(Keys):
    """Keys during a trial: those of the recorder, and `a`, which ends the trial at once.

    A trial that is redone ends too, so that the operator says when the next one begins.
    """

    def __init__(self, keys: Keys) -> None:
        super().__init__(None)
        self._keys = keys
        self.adverse = self.ends = False

    @property
    def closed(self) -> bool:
        """Whether no key can be pressed any more."""
        return self._keys.closed

    def ended(self) -> bool:
        """`closed` after a look, without waiting."""
        return self._keys.ended()

    def pressed(self, wait_s: float = 0.0) -> str:
        """The next key of the recorder by its name, or ""."""
        letter = letter_of(self._keys, wait_s)
        self.adverse |= letter == "a"
        key = TRIAL_KEYS.get(letter, "")
        self.ends |= self.adverse or key == "redo"
        return key


class AnyDesk(Protocol):
    """What the runner needs of either desk."""

    rehearsal: bool
    say: Callable[[str], None]

    def key(self, left_s: float, *, ends_part: bool, paused: bool = False) -> str:
        """What to do next, one of KEYS; left_s: planned time that is left in this part."""
        ...

    def text(self, prompt: str) -> str | None:
        """A line of text, "" for none, LEFT_OUT without an operator; None without any key."""
        ...

    def trial_keys(self) -> TrialKeys:
        """The keys of one trial."""
        ...

    def failed(self, error: HoldfastError) -> None:
        """An error that the operator may correct while the study waits."""
        ...


class Desk:
    """The operator at a terminal, or what types in a pipe."""

    rehearsal = False

    def __init__(
        self,
        keys: Keys,
        say: Callable[[str], None],
        draw: Callable[[str], None],
        clock: Any,
        stopped: Callable[[], bool],
    ) -> None:
        self._keys, self.say, self._draw = keys, say, draw
        self._clock, self._stopped = clock, stopped

    def key(self, left_s: float, *, ends_part: bool, paused: bool = False) -> str:
        """What to do next; QUIT after a signal or where the terminal is gone."""
        began_ns, drawn_s = self._clock.now_ns(), -REDRAW_S
        while not self._stopped():
            spent_s = 1e-9 * (self._clock.now_ns() - began_ns)
            if spent_s >= drawn_s + REDRAW_S:
                over = f"paused for {clock_text(spent_s)}"
                self._draw(over if paused else _left_in_words(left_s - spent_s))
                drawn_s = spent_s
            letter = letter_of(self._keys, WAIT_S)
            if letter in KEYS:
                return KEYS[letter]
            if self._keys.closed:
                self.say(NO_KEY)
                return QUIT
        return QUIT

    def text(self, prompt: str) -> str | None:
        """A line that is shown as it is typed; Escape or an empty line: none."""
        self.say(prompt)
        typed, drawn = b"", None
        while not self._stopped():
            if typed != drawn:
                self._draw(f"> {visible(typed.decode('utf-8', 'replace'))[-60:]}")
                drawn = typed
            byte = self._keys.byte(WAIT_S)
            if byte and byte in ENTER:
                line = typed.decode("utf-8", "replace").strip()
                self.say(f"> {line}")
                return line
            if byte == ESCAPE:
                _drop_the_rest(self._keys)
                return ""
            if byte and byte in ERASE:
                typed = typed.decode("utf-8", "ignore")[:-1].encode()
            elif byte and len(typed) < LONGEST_TEXT and (byte >= b" " or byte == b"\t"):
                typed += byte
            elif self._keys.closed:
                self.say(NO_KEY)
                return None
        return None

    def trial_keys(self) -> TrialKeys:
        """The keys of one trial."""
        return TrialKeys(self._keys)

    def failed(self, error: HoldfastError) -> None:
        """Say what failed; the operator corrects it, tries again or skips."""
        self.say(f"error: {type(error).__name__}: {error}")
        self.say("space tries again, s skips this step, q quits and goes on later")


class Rehearsal:
    """No operator: every part takes its planned time, and every question is left out."""

    rehearsal = True

    def __init__(
        self, say: Callable[[str], None], clock: Any, stopped: Callable[[], bool]
    ) -> None:
        self.say, self._clock, self._stopped = say, clock, stopped

    def key(self, left_s: float, *, ends_part: bool, paused: bool = False) -> str:
        """Go on, after the time that is left."""
        if self._stopped():
            return QUIT
        if ends_part and left_s > 0.0:
            self._clock.wait_until(self._clock.now_ns() + round(1e9 * left_s))
        return NEXT

    def text(self, prompt: str) -> str | None:
        """No answer."""
        return LEFT_OUT

    def trial_keys(self) -> TrialKeys:
        """No key."""
        return TrialKeys(Keys(None))

    def failed(self, error: HoldfastError) -> None:
        """End with the error: no operator can correct it."""
        raise error


def letter_of(keys: Keys, wait_s: float) -> str:
    """The next key as a small letter, or ""; an arrow key, which ends in a letter, is none."""
    byte = keys.byte(wait_s)
    if byte == ESCAPE:
        _drop_the_rest(keys)
        return ""
    return byte.decode("ascii", "replace").lower()


def _drop_the_rest(keys: Keys) -> None:
    """Drop what came with an Escape: the rest of an arrow key, say."""
    while keys.byte():
        pass


def _left_in_words(left_s: float) -> str:
    """The countdown of a part."""
    return (
        f"{clock_text(left_s)} left" if left_s >= 0.0 else f"{clock_text(-left_s)} over"
    )


def clock_text(seconds: float) -> str:
    """Minutes and seconds.

    >>> clock_text(125.0)
    '2:05'
    """
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
