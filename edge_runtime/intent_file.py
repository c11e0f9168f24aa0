"""The wearer's own command beside a trial: trial_n.intent.csv, tactile.intent.csv.

    Time (s),host (ns),wants,envelope 1 (0 to 1),envelope 2 (0 to 1)

Time counts from the trial's first sample; host is CLOCK_MONOTONIC, as in tactile.csv. Where the
stream goes silent, a line says `unknown`. A torn last line, as a kill leaves it, is not read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from holdfast.edge_runtime.errors import ColumnError, NotANumber
from holdfast.edge_runtime.intent import WORDS, Intent, Wants, share
from holdfast.edge_runtime.reading import text_of

HEAD = ("Time (s)", "host (ns)", "wants")
ALLOWED: tuple[Wants, ...] = ("", "unknown", *WORDS)


def intent_header(n_envelopes: int) -> str:
    """The first line, without its line end."""
    return ",".join([*HEAD, *(f"envelope {k} (0 to 1)" for k in range(1, n_envelopes + 1))])


def intent_row(item: Intent, first_ns: int, host_after_ns: int, n_envelopes: int) -> str:
    """A line. first_ns: time of the first sample. host_after_ns: the host's clock minus the run's.

    Without envelopes their cells are empty.
    """
    envelope = [repr(value) for value in item.envelope] or [""] * n_envelopes
    time_s = f"{1e-9 * (item.t_ns - first_ns):.6f}"
    return ",".join([time_s, str(item.t_ns + host_after_ns), item.wants, *envelope])


@dataclass(frozen=True)
class IntentRecord:
    """A file that was read: items with t_ns on the host's clock, and their times from the trial's
    first sample, s."""

    time_s: tuple[float, ...]
    items: tuple[Intent, ...]


def read_intent(path: Path) -> IntentRecord:
    """Read a file. Raises ColumnError, NotANumber, TooLarge, OSError."""
    try:
        header, *lines = text_of(path).split("\n")[:-1] or [""]
    except UnicodeDecodeError:
        header, lines = "", []
    n_envelopes = len(header.split(",")) - len(HEAD)
    if n_envelopes < 0 or header != intent_header(n_envelopes):
        raise ColumnError(
            "not the columns of a wearer's own command",
            where=path,
            cause="another file, or an edited one",
            next_step=f"its header begins with {','.join(HEAD)}",
        )
    times, items = [], []
    for number, line in enumerate(lines, start=2):
        try:
            time_s, item = _item(line.split(","), n_envelopes)
        except ValueError as error:
            raise NotANumber(
                f"line {number}: {error}", where=path, next_step="correct or remove the line"
            ) from None
        times.append(time_s)
        items.append(item)
    return IntentRecord(tuple(times), tuple(items))


def _item(cells: list[str], n_envelopes: int) -> tuple[float, Intent]:
    if len(cells) != len(HEAD) + n_envelopes:
        raise ValueError(f"{len(cells)} cells, not {len(HEAD) + n_envelopes}")
    time_s, host_ns, wants, *envelope = cells
    for word in ALLOWED:
        if wants == word:
            values = tuple(share(float(cell)) for cell in envelope) if any(envelope) else ()
            return float(time_s), Intent(int(host_ns), word, values)
    raise ValueError(f"wants is {wants[:40]!r}")
