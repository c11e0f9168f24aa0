"""Where the answers of a run may go: one entry of OUTPUTS for each kind of output.

`--help`, the errors and docs/on-a-hand.md list these entries. A new kind is one entry here, and a
class with `write` and `close` (outputs.py says what they promise). Nothing heavy is imported before
an output opens, since `--help` reads this table.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from holdfast.core.errors import UsageError

if TYPE_CHECKING:
    from holdfast.live.outputs import Output
    from holdfast.live.run import OpenRun

WEB_PORT = "8000"
STDOUT = "stdout"


class OutputUrl(NamedTuple):
    """Where answers go: a kind of OUTPUTS, and the address or path behind it."""

    kind: str
    place: str


class OutputKind(NamedTuple):
    """One kind of output.

    typed: how it is named after --to. about: what it gets, in words. place_of: the address or path
    in what was typed, "" for a kind without one, None where another kind is meant. opened: opens it
    for a run; None where the run's own lines write it, or nothing does.
    """

    kind: str
    typed: str
    about: str
    place_of: Callable[[str], str | None]
    opened: Callable[[OpenRun, str], Output | None]


# -- which kind a typed output is


def _word(word: str) -> Callable[[str], str | None]:
    """The very word, without a place."""
    return lambda typed: "" if typed == word else None


def _after(prefix: str, suffix: str = "") -> Callable[[str], str | None]:
    """What stands after a prefix, where it ends with the suffix."""

    def place_of(typed: str) -> str | None:
        place = typed.removeprefix(prefix)
        # `samples://x` is a mistake, and no file at the root of the disk
        is_place = place not in ("", typed) and not place.startswith("//")
        return place if is_place and place.endswith(suffix) else None

    return place_of


def _file(suffix: str) -> Callable[[str], str | None]:
    """A path that ends so, unless it begins with the name of a kind or is a URL."""

    def place_of(typed: str) -> str | None:
        name, colon, _ = typed.partition(":")
        is_kind = colon and name in ("csv", *KINDS)
        is_path = not is_kind and "://" not in typed
        return typed if is_path and Path(typed).suffix == suffix else None

    return place_of


def _samples_place(typed: str) -> str | None:
    return _after("samples:")(typed) or _file(".csv")(typed)


def _web_place(typed: str) -> str | None:
    name, _, port = typed.partition(":")
    return (port or WEB_PORT) if name == "web" else None


# -- how a kind is opened


def _open_view(run: OpenRun, place: str) -> Output:
    from holdfast.live.view import open_view

    run.view = open_view(run.card)
    return run.view


def _open_stdout(run: OpenRun, place: str) -> None:
    from holdfast.core.lines import stream_sink

    run.lines.sinks.append(stream_sink(sys.stdout, STDOUT))


def _open_lines(run: OpenRun, place: str) -> None:
    from holdfast.live.outputs import file_sink

    run.lines.sinks.append(file_sink(Path(place)))
    run.new_files.append(Path(place))


def _open_udp(run: OpenRun, place: str) -> None:
    from holdfast.live.outputs import udp_sink

    run.lines.sinks.append(udp_sink(place))


def _open_answers(run: OpenRun, place: str) -> Output:
    from holdfast.live.outputs import AnswerFile

    answers = AnswerFile(Path(place), run.card.not_learned)
    run.keep(answers.sink, Path(place))
    return answers


def _open_samples(run: OpenRun, place: str) -> Output:
    from holdfast.live.outputs import SampleFile

    card, zero = run.card, run.zero
    run.samples = SampleFile(Path(place), card.n_channels, card.unit, zero, card.hand)
    run.keep(run.samples.sink, Path(place))
    return run.samples


def _open_web(run: OpenRun, place: str) -> Output:
    from holdfast.live.page.run_page import open_run_page

    source, model = run.options.source, run.options.model
    with_grip = bool(run.options.grip)
    run.page = open_run_page(
        place, source, model, run.card, run.report, with_grip=with_grip
    )
    return run.page


def _open_lsl(run: OpenRun, place: str) -> Output:
    from holdfast.drivers.lsl import LslAnswers

    card, now_ns = run.card, run.clock.now_ns
    sensors, gaps = card.n_channels // 3, card.not_learned
    return LslAnswers(place, sensors, card.unit, card.rate_hz, now_ns, gaps, card.hand)


def _open_nothing(run: OpenRun, place: str) -> None:
    """Only the grip is wanted."""


OUTPUTS = (
    OutputKind("view", "view", "a picture in the terminal", _word("view"), _open_view),
    OutputKind("-", "-", "JSON lines on stdout, the default", _word("-"), _open_stdout),
    OutputKind(
        "jsonl", "FILE.jsonl", "JSON lines in a new file", _file(".jsonl"), _open_lines
    ),
    OutputKind(
        "udp", "udp://HOST:PORT", "JSON lines as datagrams", _after("udp://"), _open_udp
    ),
    OutputKind(
        "answers",
        "answers:FILE.csv",
        "a table of time, state, p_risky, act and target, a row an answer",
        _after("answers:", ".csv"),
        _open_answers,
    ),
    OutputKind(
        "samples",
        "samples:FILE or FILE.csv",
        "the prepared samples, for holdfast replay",
        _samples_place,
        _open_samples,
    ),
    OutputKind(
        "web", "web[:[HOST:]PORT]", "the live page in a browser", _web_place, _open_web
    ),
    OutputKind(
        "lsl",
        "lsl://NAME",
        "values and decisions as two streams, with extra lsl",
        _after("lsl://"),
        _open_lsl,
    ),
    OutputKind("none", "none", "nothing: the grip alone", _word("none"), _open_nothing),
)
"""In the order in which they open and get an answer: messages appear above an open view."""
KINDS = {one.kind: one for one in OUTPUTS}
ALLOWED = ", ".join(one.typed for one in OUTPUTS)
ABOUT = ", ".join(f"{one.typed} ({one.about})" for one in OUTPUTS)
"""All kinds with what they get, for --help."""


def output_url(typed: str) -> OutputUrl:
    """The kind and place of a value of --to. Raises UsageError.

    >>> output_url("udp://127.0.0.1:9000"), output_url("web")
    (OutputUrl(kind='udp', place='127.0.0.1:9000'), OutputUrl(kind='web', place='8000'))
    >>> output_url("answers:run/a.csv"), output_url("run/a.csv")[0]
    (OutputUrl(kind='answers', place='run/a.csv'), 'samples')
    """
    for one in OUTPUTS:
        place = one.place_of(typed)
        if place is not None:
            return OutputUrl(one.kind, place)
    allowed = ALLOWED
    # a table of what? both are CSV
    if typed.startswith("csv:"):
        both = (KINDS["answers"], KINDS["samples"])
        allowed = "; ".join(f"{one.typed}: {one.about}" for one in both)
    raise UsageError(f"--to {typed[:80]!r} is no output", next_step=allowed)
