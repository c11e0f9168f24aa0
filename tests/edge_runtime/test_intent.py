"""The wearer's command as a stream: what is understood, when it is unknown, its file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numbered_lines import numbered_sender

from holdfast.core.errors import ColumnError, DeviceLost, NotANumber
from holdfast.core.line_port import line_port
from holdfast.core.lsl_streams import StreamFacts
from holdfast.drivers.lsl import LslIntent
from holdfast.edge_runtime.intent import (
    Intent,
    IntentMonitor,
    IntentRecord,
    ItemReader,
    PortIntent,
    intent_header,
    intent_of,
    intent_row,
    read_intent,
)

PERIOD_NS = 6_666_667


class Hand:
    """A clock by hand, a stream of scripted items, and messages."""

    n_envelopes = 2

    def __init__(self, opens_at: float | None = None) -> None:
        self.ns, self.next, self.forgotten = 10**9, list[Intent](), 0
        self.messages: list[str] = []
        self.monitor = IntentMonitor(
            self, lambda: self.ns, self.messages.append, opens_at
        )

    def came(self) -> list[Intent]:
        came, self.next = self.next, []
        return came

    def forget(self) -> None:
        self.next, self.forgotten = [], self.forgotten + 1

    def sample(self, *items: dict[str, Any]) -> Intent:
        """A period passes, these items come; what is known then."""
        self.ns += PERIOD_NS
        self.next = [
            Intent(self.ns, one.get("wants", ""), tuple(one.get("envelope", ())))
            for one in items
        ]
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
    assert hand.sample({"wants": word}).wants == word
    assert hand.silence(44).wants == word
    assert hand.silence(1).wants == "unknown"
    assert (hand.monitor.link, hand.monitor.opening) == ("expired", False)
    assert [one.wants for one in hand.monitor.fresh] == ["unknown"]
    assert hand.silence(20).wants == "unknown"
    assert len(hand.messages) == 1
    assert hand.sample({"wants": word}).wants == word
    assert hand.messages[1:] == ["intent: the stream is back"]


def test_envelopes_alone_mean_nothing_without_a_level(hand):
    newest = hand.sample({"envelope": (1.0, 0.0)})
    assert (newest.wants, newest.envelope, hand.monitor.opening) == (
        "",
        (1.0, 0.0),
        False,
    )


def test_an_envelope_opens_from_its_level_and_ends_below_half_of_it():
    hand = Hand(opens_at=0.4)
    hand.sample()
    shares = [0.39, 0.4, 0.21, 0.2, 0.19, 0.39, 1.0]
    wants = [hand.sample({"envelope": (share, 0.9)}).wants for share in shares]
    assert wants == ["rest", "open", "open", "open", "rest", "rest", "open"]


def test_after_a_silence_an_opening_must_reach_its_level_again():
    hand = Hand(opens_at=0.4)
    hand.sample()
    assert hand.sample({"envelope": (0.5, 0.0)}).wants == "open"
    hand.silence(50)
    assert hand.sample({"envelope": (0.3, 0.0)}).wants == "rest"


@pytest.mark.parametrize("item", [{"wants": "open"}, {"envelope": (1.0, 0.0)}])
def test_an_opening_that_never_ends_counts_for_three_seconds_until_it_has_ended(item):
    hand = Hand(opens_at=0.4)
    hand.sample()
    opened = []
    for _ in range(600):
        assert hand.sample(item).wants == "open"
        opened.append(hand.monitor.opening)
    assert (sum(opened), opened[448], opened[449]) == (449, True, False)
    assert hand.messages == ["intent: open for 3 s; it does not count until it ends"]
    hand.sample({"wants": "rest"}, item)
    assert hand.monitor.opening


class Early(Hand):
    """An item comes between the emptying of the port and the first look."""

    def forget(self) -> None:
        self.forgotten += 1


def test_an_opening_that_is_there_at_the_first_look_counts():
    hand = Early()
    hand.sample({"wants": "open"})
    assert hand.monitor.opening


def test_a_word_counts_before_envelopes():
    hand = Hand(opens_at=0.4)
    hand.sample()
    assert hand.sample({"wants": "close", "envelope": (1.0, 1.0)}).wants == "close"


@pytest.mark.parametrize(("word", "then"), [("open", "open"), ("rest", "rest")])
def test_an_envelope_after_a_word_ends_what_the_word_began_and_begins_nothing(
    word, then
):
    """0.3 is between the level at which an opening ends and that at which it begins."""
    hand = Hand(opens_at=0.4)
    hand.sample()
    hand.sample({"wants": word})
    assert hand.sample({"envelope": (0.3, 0.0)}).wants == then


def test_what_waited_while_nothing_looked_is_dropped(hand):
    assert hand.forgotten == 1
    hand.ns += 10**9
    assert hand.sample({"wants": "open"}).wants == "unknown"
    assert hand.forgotten == 2


@settings(deadline=None, max_examples=50)
@given(
    st.lists(
        st.one_of(
            st.none(),
            st.sampled_from(["open", "close", "rest"]),
            st.floats(0.0, 1.0, width=16),
        ),
        max_size=300,
    ),
    st.floats(0.01, 1.0),
)
def test_the_wish_is_never_older_than_it_may_be_and_never_made_up(stream, level):
    hand = Hand(opens_at=level)
    hand.sample()
    last = None
    for one in stream:
        if one is None:
            hand.sample()
        elif isinstance(one, str):
            hand.sample({"wants": one})
        else:
            hand.sample({"envelope": (one, 0.0)})
        last = hand.ns if one is not None else last
        fresh = last is not None and hand.ns - last <= 300_000_000
        assert (hand.monitor.newest.wants == "unknown") == (not fresh)
        assert (hand.monitor.link == "live") == fresh
        if isinstance(one, str):
            assert hand.monitor.newest.wants == one
        elif one is not None:
            assert not hand.monitor.opening or one >= 0.5 * level
            assert hand.monitor.opening or one < level


# -- datagrams


@pytest.fixture
def udp() -> Iterator[tuple[Callable[[Any], None], PortIntent, list[str]]]:
    """(sends one datagram, the stream, its messages)."""
    messages: list[str] = []
    with (
        line_port("udp://127.0.0.1:0", "intent", messages.append, lambda: 7) as port,
        numbered_sender(port.address()) as sender,
    ):
        yield sender.send, PortIntent(port, 2, lambda: 7), messages


def test_datagrams_are_items_with_the_time_of_their_arrival(udp):
    send, stream, messages = udp
    send({"envelope": [0.25, 1]})
    send({"wants": "open"})
    send({"wants": "rest", "envelope": [0, 0.5]})
    assert stream.came() == [
        Intent(7, "", (0.25, 1.0)),
        Intent(7, "open"),
        Intent(7, "rest", (0.0, 0.5)),
    ]
    assert not messages


@pytest.mark.parametrize(
    "rubbish",
    [
        b"",
        b"\xff\x1b[2J",
        b"[0.5, 0.5]",
        b"[" * 1000,
        b'{"envelope": [NaN, 0]}',
        b"{}",
        {},
        {"wants": "closed"},
        {"wants": ""},
        {"wants": None},
        {"wants": ["open"]},
        {"envelope": [0.5]},
        {"envelope": [0.5, 1.01]},
        {"envelope": [-0.1, 0]},
        {"envelope": [True, 0]},
        {"envelope": ["0.5", 0]},
        {"envelope": 0.5},
        {"envelope": "ab"},
        {"envelope": {}},
        {"envelope": [10**400, 0]},
        {"opening": True},
    ],
)
def test_what_is_not_understood_is_no_item_and_reported_once(udp, rubbish):
    send, stream, messages = udp
    for _ in range(3):
        send(rubbish)
    assert stream.came() == []
    assert len(messages) == 1
    assert "is skipped: not understood" in messages[0]
    assert messages[0].isprintable()


def test_a_flooded_port_delays_no_sample_and_can_be_emptied(udp):
    send, stream, _ = udp
    for _ in range(100):
        send({"wants": "open"})
    assert len(stream.came()) == 32
    stream.forget()
    assert stream.came() == []


# -- the lab streaming layer


class ScriptedInlet:
    """Gives what it was given; its clock is 1000 s ahead of the run's."""

    def __init__(self, *, is_text: bool, pairs: list[tuple[float, list[Any]]]) -> None:
        self.facts = StreamFacts(
            "emg", is_text, 100.0, ("",) * (1 if is_text else 2), ("",) * 2
        )
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


def test_stamps_of_the_lab_streaming_layer_are_put_on_the_runs_clock():
    messages: list[str] = []
    pairs = [(1000.5, [0.25, 0.5]), (1000.75, [2.0, 0.0]), (1009.0, [0.5, 0.5])]
    inlet = ScriptedInlet(is_text=False, pairs=pairs)
    stream = LslIntent(inlet, lambda: 10**9, messages.append)
    assert stream.came() == [
        Intent(500_000_000, "", (0.25, 0.5)),
        Intent(10**9, "", (0.5, 0.5)),
    ]
    assert len(messages) == 1
    for _ in range(3):
        assert stream.came() == []
        assert messages[1:] == ["intent: lsl://emg ended"]


def test_a_text_stream_has_words():
    inlet = ScriptedInlet(is_text=True, pairs=[(1000.5, ["open"]), (1000.6, ["shut"])])
    stream = LslIntent(inlet, lambda: 10**9, lambda line: None)
    assert stream.came() == [Intent(500_000_000, "open")]
    assert stream.n_envelopes == 0


# -- files

ITEMS = [
    Intent(1_500_000_000, "", (0.1, 1.0)),
    Intent(1_600_000_000, "open"),
    Intent(1_900_000_001, "unknown"),
]


def test_a_file_reads_back_as_it_was_written_without_a_torn_line(tmp_path):
    path = tmp_path / "trial_1.intent.csv"
    rows = [intent_row(one, 10**9, 5, 2) for one in ITEMS]
    path.write_text("\n".join([intent_header(2), *rows, "1.0,7,op"]), encoding="utf-8")
    assert path.read_text("utf-8").startswith(
        "Time (s),host (ns),wants,envelope 1 (0 to 1),envelope 2 (0 to 1)\n0.500000,1500000005,,0.1"
    )
    record = read_intent(path)
    assert record.time_s == (0.5, 0.6, 0.9)
    assert record.items == tuple(
        Intent(one.t_ns + 5, one.wants, one.envelope) for one in ITEMS
    )


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", ColumnError),
        ("Time,X1\n", ColumnError),
        (f"{intent_header(1)}\n0.1,five,open,0.5\n", NotANumber),
        (f"{intent_header(2)}\n0.1,5,open,0.5,\n", NotANumber),
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


@pytest.mark.parametrize(
    ("wants", "envelope", "says"),
    [
        ("open", [], ""),
        ("", [0, 1.0], ""),
        ("rest", [0.5, 0.0], ""),
        ("shut", [], "wants is one of open, close, rest"),
        ("", [], "it is empty"),
        ("open", [0.5], "1 envelopes, not 2"),
        ("open", [0.5] * 3, "3 envelopes, not 2"),
        ("", [0.5, True], "an envelope is no number"),
        ("", [0.5, 1.001], "an envelope is not within 0 and 1"),
        ("", [-0.001, 0.5], "an envelope is not within 0 and 1"),
        ("", [0.5, float("nan")], "an envelope is not within 0 and 1"),
    ],
)
def test_an_item_has_a_word_or_all_envelopes_or_both(wants, envelope, says):
    if says:
        with pytest.raises(ValueError, match=says):
            intent_of(wants, envelope, 5, 2)
    else:
        item = intent_of(wants, envelope, 5, 2)
        assert item == Intent(5, wants, tuple(map(float, envelope)))


@pytest.mark.parametrize(
    ("n_envelopes", "line", "says"),
    [
        (0, "0.5,7,open", (0.5, Intent(7, "open"))),
        (0, "-0.5,7,unknown", (-0.5, Intent(7, "unknown"))),
        (1, "0,7,,1", (0.0, Intent(7, "", (1.0,)))),
        (2, "0,7,rest,,", (0.0, Intent(7, "rest"))),
        (1, "0,7,,1,1", "line 2: 5 cells, not 4"),
        (1, f"0,7,{'x' * 50},1", f"line 2: wants is '{'x' * 40}'"),
        (1, "0,7.5,,1", "line 2: invalid literal"),
    ],
)
def test_a_line_of_a_file_is_an_item_or_named(tmp_path, n_envelopes, line, says):
    path = tmp_path / "trial_1.intent.csv"
    path.write_text(f"{intent_header(n_envelopes)}\n{line}\n", encoding="utf-8")
    if isinstance(says, str):
        with pytest.raises(NotANumber, match=says):
            read_intent(path)
    else:
        assert read_intent(path) == IntentRecord((says[0],), (says[1],))


def test_what_is_not_understood_is_shown_up_to_80_characters_once_in_a_row():
    said: list[str] = []
    reader = ItemReader(said.append)

    def wrong() -> Intent:
        raise ValueError("so")

    item = Intent(5, "open")
    for read in (wrong, wrong, lambda: item, wrong):
        assert reader.item(read, 90 * "x") == (None if read is wrong else item)
    assert said == [f"intent: {80 * 'x'} is not understood (so)"] * 2
