"""The wearer's command as a stream: what is understood, when it is unknown, its file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numbered_lines import numbered_sender

from holdfast.core.errors import ColumnError, DeviceLost, NotANumber
from holdfast.core.hand_lines import line_port
from holdfast.drivers.lsl import LslIntent, StreamFacts
from holdfast.edge_runtime.intent import (
    INTENT_HEADER,
    Intent,
    IntentMonitor,
    ItemReader,
    PortIntent,
    intent_row,
    read_intent,
)

PERIOD_NS = 6_666_667


class Hand:
    """A clock by hand, a stream of scripted items, and messages."""

    def __init__(self) -> None:
        self.ns, self.next, self.forgotten = 10**9, list[Intent](), 0
        self.messages: list[str] = []
        self.monitor = IntentMonitor(self, lambda: self.ns, self.messages.append)

    def came(self) -> list[Intent]:
        came, self.next = self.next, []
        return came

    def forget(self) -> None:
        self.next, self.forgotten = [], self.forgotten + 1

    def sample(self, *words: Any) -> Intent:
        """A period passes, these items come; what is known then."""
        self.ns += PERIOD_NS
        self.next = [Intent(self.ns, word) for word in words]
        self.monitor.look()
        return self.monitor.newest

    def silence(self, samples: int) -> Intent:
        for _ in range(samples):
            self.sample()
        return self.monitor.newest


@pytest.fixture
def hand() -> Hand:
    one = Hand()
    one.sample()
    return one


def test_before_the_first_item_the_wish_is_unknown_and_nothing_opens(hand):
    assert (hand.monitor.newest.wants, hand.monitor.link) == ("unknown", "none")
    assert not hand.monitor.opening


@pytest.mark.parametrize("word", ["open", "close", "rest"])
def test_a_silent_stream_is_unknown_after_three_tenths_of_a_second(hand, word):
    assert hand.sample(word).wants == word
    assert hand.silence(44).wants == word
    assert hand.silence(1).wants == "unknown"
    assert (hand.monitor.link, hand.monitor.opening) == ("expired", False)
    assert [one.wants for one in hand.monitor.fresh] == ["unknown"]
    assert hand.silence(20).wants == "unknown"
    assert len(hand.messages) == 1
    assert hand.sample(word).wants == word
    assert hand.messages[1:] == ["intent: the stream is back"]


def test_an_opening_that_never_ends_counts_for_three_seconds_until_it_has_ended(hand):
    opened = []
    for _ in range(600):
        assert hand.sample("open").wants == "open"
        opened.append(hand.monitor.opening)
    assert (sum(opened), opened[448], opened[449]) == (449, True, False)
    assert hand.messages == ["intent: open for 3 s; it does not count until it ends"]
    hand.sample("rest", "open")
    assert hand.monitor.opening


class Early(Hand):
    """An item comes between the emptying of the port and the first look."""

    def forget(self) -> None:
        self.forgotten += 1


def test_an_opening_that_is_there_at_the_first_look_counts():
    hand = Early()
    hand.sample("open")
    assert hand.monitor.opening


def test_what_waited_while_nothing_looked_is_dropped(hand):
    assert hand.forgotten == 1
    hand.ns += 10**9
    assert hand.sample("open").wants == "unknown"
    assert hand.forgotten == 2


@settings(deadline=None, max_examples=50)
@given(st.lists(st.none() | st.sampled_from(["open", "close", "rest"]), max_size=300))
def test_the_wish_is_never_older_than_it_may_be_and_never_made_up(stream):
    hand = Hand()
    hand.sample()
    last, word = None, None
    for one in stream:
        hand.sample(*([one] if one else []))
        if one:
            last, word = hand.ns, one
        fresh = last is not None and hand.ns - last <= 300_000_000
        assert hand.monitor.newest.wants == (word if fresh else "unknown")
        assert (hand.monitor.link == "live") == fresh


# -- datagrams


@pytest.fixture
def words(tmp_path) -> Iterator[tuple[Callable[[Any], None], PortIntent, list[str]]]:
    """(sends one datagram, the stream, its messages)."""
    messages: list[str] = []
    path = tmp_path / "intent"
    with (
        line_port(f"unix://{path}", "intent", messages.append, lambda: 7) as port,
        numbered_sender(path) as sender,
    ):
        yield sender.send, PortIntent(port, lambda: 7), messages


def test_datagrams_are_items_with_the_time_of_their_arrival(words):
    send, stream, messages = words
    for word in ("open", "rest"):
        send({"wants": word})
    assert stream.came() == [Intent(7, "open"), Intent(7, "rest")]
    assert not messages


@pytest.mark.parametrize(
    "rubbish",
    [
        b"",
        b"\xff\x1b[2J",
        b"[0.5, 0.5]",
        {},
        {"wants": "closed"},
        {"wants": ""},
        {"wants": None},
        {"wants": ["open"]},
        {"envelope": [0.5]},
        {"opening": True},
    ],
)
def test_what_is_not_understood_is_no_item_and_reported_once(words, rubbish):
    send, stream, messages = words
    for _ in range(3):
        send(rubbish)
    assert stream.came() == []
    assert len(messages) == 1
    assert "is skipped: not understood" in messages[0]
    assert messages[0].isprintable()


# -- the lab streaming layer


class ScriptedInlet:
    """Gives what it was given; its clock is 1000 s ahead of the run's."""

    def __init__(self, pairs: list[tuple[float, list[Any]]]) -> None:
        self.facts = StreamFacts("emg", True, 100.0, ("",), ("",) * 2)
        self.pairs = pairs

    def pull(self, timeout_s: float) -> list[Any]:
        assert timeout_s == 0.0
        if not self.pairs:
            raise DeviceLost("the stream ended")
        pairs, self.pairs = self.pairs, []
        return pairs

    def clock_s(self) -> float:
        return 1001.0

    def close(self) -> None:
        pass


def test_words_of_the_lab_streaming_layer_are_put_on_the_runs_clock():
    messages: list[str] = []
    pairs = [(1000.5, ["open"]), (1000.75, ["shut"]), (1009.0, ["rest"])]
    stream = LslIntent(ScriptedInlet(pairs), lambda: 10**9, messages.append)
    assert stream.came() == [Intent(500_000_000, "open"), Intent(10**9, "rest")]
    assert len(messages) == 1
    for _ in range(3):
        assert stream.came() == []
        assert messages[1:] == ["lsl://emg: the stream ended; it is unknown from here"]


# -- files

ITEMS = [Intent(1_600_000_000, "open"), Intent(1_900_000_001, "unknown")]


def test_a_file_reads_back_as_it_was_written_without_a_torn_line(tmp_path):
    path = tmp_path / "trial_1.intent.csv"
    rows = [intent_row(one, 10**9, 5) for one in ITEMS]
    path.write_text("\n".join([INTENT_HEADER, *rows, "1.0,7,op"]), encoding="utf-8")
    assert path.read_text("utf-8").startswith(
        "Time (s),host (ns),wants\n0.600000,1600000005,open\n"
    )
    record = read_intent(path)
    assert record.time_s == (0.6, 0.9)
    assert record.items == tuple(Intent(one.t_ns + 5, one.wants) for one in ITEMS)


def test_the_words_of_an_older_file_with_envelopes_are_read(tmp_path):
    path = tmp_path / "trial_1.intent.csv"
    header = f"{INTENT_HEADER},envelope 1 (0 to 1)"
    path.write_text(f"{header}\n0.5,7,open,\n0.6,8,,0.25\n", encoding="utf-8")
    assert read_intent(path).items == (Intent(7, "open"), Intent(8, ""))


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", ColumnError),
        ("Time,X1\n", ColumnError),
        (f"{INTENT_HEADER}\n0.1,five,open\n", NotANumber),
        (f"{INTENT_HEADER}\n0.1,5,open,0.5\n", NotANumber),
        (f"{INTENT_HEADER}\n0.1,5,shut\n", NotANumber),
    ],
)
def test_a_damaged_file_is_an_error_with_its_place(tmp_path, text, error):
    path = tmp_path / "trial_1.intent.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(error, match=r"trial_1\.intent\.csv"):
        read_intent(path)


# -- limits, to the nanosecond


def test_a_silence_and_a_pause_are_longer_than_three_tenths_of_a_second():
    hand = Early()
    for at_ns, link, fresh, forgotten in (
        (5, "live", [5], 1),
        (300_000_004, "live", [], 1),
        (300_000_005, "live", [], 1),
        (300_000_006, "expired", [300_000_006], 1),
        (600_000_006, "expired", [], 1),
        (900_000_007, "expired", [], 2),
    ):
        hand.ns = at_ns
        hand.next = [Intent(5, "rest")] if at_ns == 5 else []
        hand.monitor.look()
        assert (hand.monitor.link, hand.forgotten) == (link, forgotten)
        assert [one.t_ns for one in hand.monitor.fresh] == fresh
        assert (hand.monitor.newest.wants == "rest") == (link == "live")
    assert len(hand.messages) == 1


def test_an_opening_counts_for_three_seconds_from_the_last_sample_without_it():
    hand = Early()
    for at_ns in (7, *range(200_000_000, 3_000_000_000, 200_000_000), 3_000_000_007):
        hand.ns, hand.next = at_ns, [Intent(at_ns, "open")]
        hand.monitor.look()
        assert (hand.monitor.opening, hand.messages) == (True, [])
    hand.ns += 1
    hand.monitor.look()
    assert (hand.monitor.opening, len(hand.messages)) == (False, 1)


def test_what_is_not_understood_is_shown_up_to_80_characters_once_in_a_row():
    said: list[str] = []
    reader = ItemReader(said.append)

    def wrong() -> Intent:
        raise ValueError("so")

    item = Intent(5, "open")
    for read in (wrong, wrong, lambda: item, wrong):
        assert reader.item(read, 90 * "x") == (None if read is wrong else item)
    assert said == [f"intent: {80 * 'x'} is not understood (so)"] * 2
