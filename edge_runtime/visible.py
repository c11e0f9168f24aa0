"""Text from outside, made safe for a terminal: control characters are shown, not obeyed."""

from __future__ import annotations

LONGEST_LINE = 2000
"""Characters of one message; a name may have a hundred thousand."""


def visible(text: str) -> str:
    r"""The text, with what does not print as its escape: ESC as \x1b, an RTL override as \u202e.

    A terminal obeys such characters: they move its cursor, rename its window or hide the text
    before them.

    >>> visible("cup\x1b[2J")
    'cup\\x1b[2J'
    """
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in text
    )


def one_line(text: str) -> str:
    """The same on one line: white space as single spaces, a very long text shortened inside."""
    line = visible(" ".join(text.split()))
    if len(line) <= LONGEST_LINE:
        return line
    return f"{line[: LONGEST_LINE // 2]} .. {line[-LONGEST_LINE // 2 :]}"


def visible_lines(text: str) -> str:
    """Several lines, each made safe."""
    return "\n".join(visible(line) for line in text.split("\n"))


def listed(names: list[str], most: int = 8) -> str:
    """Names for a message: the first ones, and how many more there are.

    >>> listed(["X1", "Y1", "Z1"], most=2)
    'X1, Y1 and 1 more'
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(f"{name:.40}" for name in names[:most]) + more
