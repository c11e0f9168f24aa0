"""Which lines of a link a receiver obeys: forged, replayed, old and broken ones are skipped."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core import line_key
from holdfast.core.errors import AccessDenied, DataNotFound, HoldfastError, UsageError
from holdfast.core.line_key import LARGEST, LinkKey, read_key
from holdfast.core.line_session import (
    NOT_RISING,
    NOT_SEALED,
    NOT_UNDERSTOOD,
    OTHER_SESSION,
    REPLAYED,
    TOO_FAR,
    LineReceiver,
    LineRefused,
    LineSender,
    SessionRule,
    fields_of,
    store_in_thread,
)
from holdfast.core.tally import Tally

MS = 1_000_000
RATE = 150
KEY = LinkKey(b"0123456789abcdef0123456789abcdef", "grip")


class Clock:
    """A clock that stands."""

    ns = 0

    def now_ns(self) -> int:
        """Now."""
        return self.ns


def line(session: int, sequence: int, **more: Any) -> bytes:
    """A line without a code."""
    return json.dumps({"session": session, "sequence": sequence} | more).encode()


def kind(receiver: LineReceiver, data: bytes) -> str:
    """Why a line is skipped, "" for one that is obeyed."""
    try:
        receiver.take(data, lambda fields: fields)
    except LineRefused as error:
        return error.kind
    return ""


def obeyed(rule: SessionRule, session: int, sequence: int, ms: int) -> bool:
    """Offer one line to the rule."""
    if rule.refusal(session, sequence, ms * MS):
        return False
    rule.obeyed(session, sequence, ms * MS)
    return True


def test_a_forged_line_of_another_session_neither_moves_the_hand_nor_ends_the_session():
    rule = SessionRule(RATE)
    assert obeyed(rule, 7, 100, 0)
    for k in range(1, 200):
        assert rule.refusal(666, LARGEST, 6 * k * MS) == OTHER_SESSION
        assert obeyed(rule, 7, 100 + k, 6 * k)


def test_a_session_is_kept_until_300_ms_without_its_own_lines():
    rule = SessionRule(RATE)
    assert obeyed(rule, 7, 100, 0)
    assert rule.refusal(666, 1, 300 * MS) == OTHER_SESSION
    assert obeyed(rule, 666, 1, 301)
    assert rule.refusal(7, 101, 302 * MS) == OTHER_SESSION


def test_only_rising_sequences_are_obeyed_at_most_a_second_of_samples_ahead():
    rule = SessionRule(RATE)
    assert obeyed(rule, 7, 100, 0)
    assert rule.refusal(7, 100, 1) == NOT_RISING
    assert rule.refusal(7, 99, 1) == NOT_RISING
    assert rule.refusal(7, 100 + RATE + 1, 1) == TOO_FAR
    assert obeyed(rule, 7, 100 + RATE, 1)


def test_skipped_lines_of_the_session_do_not_keep_it_alive():
    rule = SessionRule(RATE)
    obeyed(rule, 7, 100, 0)
    for ms in range(0, 301, 10):
        assert rule.refusal(7, 99, ms * MS) == NOT_RISING
    assert obeyed(rule, 7, 5, 301)


@given(
    st.lists(
        st.tuples(st.integers(0, 3), st.integers(0, 500), st.integers(0, 400)),
        max_size=60,
    ),
    st.booleans(),
)
def test_whatever_comes_a_session_rises_and_with_a_key_nothing_is_obeyed_twice(
    lines: list[tuple[int, int, int]], keyed: bool
):
    rule = SessionRule(RATE, after=(0, -1) if keyed else None)
    now_ms, before = 0, None
    taken = []
    for session, sequence, later_ms in lines:
        now_ms += later_ms
        if not obeyed(rule, session, sequence, now_ms):
            continue
        if before is not None and now_ms - before[2] <= 300:
            assert session == before[0]
            assert 0 < sequence - before[1] <= RATE
        before = (session, sequence, now_ms)
        taken.append((session, sequence))
    if keyed:
        assert taken == sorted(set(taken))


BROKEN = {
    "a number": b"1",
    "a list": b"[]",
    "null": b"null",
    "an empty object": b"{}",
    "2000 brackets": b"[" * 2000,
    "2000 objects": b'{"a":' * 2000,
    "Infinity": b'{"session":1,"sequence":1,"target_n":Infinity}',
    "NaN": b'{"session":1,"sequence":1,"target_n":NaN}',
    "1e999": b'{"session":1,"sequence":1,"target_n":1e999}',
    "a huge whole number": b'{"session":1,"sequence":1,"target_n":'
    + b"9" * 5000
    + b"}",
    "a huge sequence": line(1, 2**53),
    "a huge session": line(2**63, 1),
    "a sequence below 0": line(1, -1),
    "true for a session": b'{"session":true,"sequence":1}',
    "a sequence with a point": b'{"session":1,"sequence":1.0}',
    "a name twice": b'{"session":1,"sequence":1,"sequence":2}',
    "no sequence": b'{"session":1}',
    "cut off": b'{"session":1,"seq',
    "not UTF-8": b'{"session":1,"sequence":1,"a":"\xff"}',
    "UTF-16": '{"session":1,"sequence":1}'.encode("utf-16"),
    "nothing": b"",
    "a megabyte": b" " * 1_000_000 + line(1, 1),
}


@pytest.mark.parametrize("data", BROKEN.values(), ids=BROKEN)
def test_what_is_no_object_of_finite_numbers_is_skipped_and_begins_no_session(data):
    receiver = LineReceiver(Clock().now_ns, RATE)
    assert kind(receiver, data) == NOT_UNDERSTOOD
    assert receiver.rule.session is None
    assert kind(receiver, line(5, 0)) == ""


def test_a_line_that_its_reader_does_not_understand_begins_no_session():
    receiver = LineReceiver(Clock().now_ns, RATE)

    def read(fields: dict[str, Any]) -> None:
        raise ValueError("no mode")

    with pytest.raises(LineRefused, match="no mode"):
        receiver.take(line(5, 0), read)
    assert receiver.rule.session is None


def test_lines_without_a_session_are_obeyed_only_where_the_link_allows_them():
    clock = Clock()
    assert kind(LineReceiver(clock.now_ns, RATE), b'{"a":1}') == NOT_UNDERSTOOD
    open_link = LineReceiver(clock.now_ns, RATE, needs_session=False)
    assert kind(open_link, b'{"a":1}') == ""
    assert kind(open_link, b'{"a":1,"session":1}') == NOT_UNDERSTOOD
    keyed = LineReceiver(clock.now_ns, RATE, needs_session=False, key=KEY)
    assert kind(keyed, KEY.sealed(b'{"a":1}')) == NOT_UNDERSTOOD


# -- with a key


def sealed(session: int, sequence: int, key: LinkKey = KEY) -> bytes:
    return key.sealed(line(session, sequence))


def test_with_a_key_only_sealed_lines_are_obeyed():
    receiver = LineReceiver(Clock().now_ns, RATE, key=KEY)
    good = sealed(5, 3)
    assert kind(receiver, line(5, 1)) == NOT_SEALED
    for at in range(len(good)):
        flipped = good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :]
        assert kind(receiver, flipped) == NOT_SEALED
        assert kind(receiver, good[:at]) == NOT_SEALED
    for other in (LinkKey(b"f" * 32, "grip"), LinkKey(KEY.key, "cue")):
        assert kind(receiver, sealed(5, 1, other)) == NOT_SEALED
    assert kind(receiver, good) == ""
    assert kind(receiver, good) == NOT_RISING


def test_a_row_of_cells_can_be_sealed_too():
    row = b"5,1,0.25,-3"
    whole = KEY.sealed(row)
    assert KEY.opened(whole) == row
    for bad in (row, whole[:-1], whole + b"0", b"4" + whole[1:], whole[-64:], b""):
        with pytest.raises(ValueError, match="code"):
            KEY.opened(bad)


def test_a_code_is_the_hmac_that_other_programs_make():
    # printf 'grip\n{"session":1,"sequence":2' | openssl dgst -sha256 -hmac 0123456789abcdef..
    assert KEY.sealed(b'{"session":1,"sequence":2}') == (
        b'{"session":1,"sequence":2,"mac":"'
        b'247f4df649d12e097e1277c8615449684c403afba592f4b0848d6b476b3c0e54"}'
    )


def test_nothing_of_an_old_session_is_obeyed_again(tmp_path):
    clock = Clock()
    receiver = LineReceiver(clock.now_ns, RATE, key=KEY)
    old = [sealed(5, k) for k in range(3)]
    new = [sealed(6, k) for k in range(3)]
    assert [kind(receiver, one) for one in old] == [""] * 3
    clock.ns += 301 * MS
    assert [kind(receiver, one) for one in old] == [REPLAYED] * 3
    assert [kind(receiver, one) for one in new] == [""] * 3
    clock.ns += 301 * MS
    assert [kind(receiver, one) for one in old + new] == [REPLAYED] * 6
    assert kind(receiver, sealed(6, 3)) == ""


def key_file(folder: Path, text: str = "k" * 32, mode: int = 0o600) -> Path:
    """A key of its own."""
    path = folder / "link.key"
    path.write_text(text + "\n", encoding="utf-8")
    path.chmod(mode)
    return path


def test_the_newest_session_outlives_the_receiver(tmp_path):
    key = read_key(key_file(tmp_path), "commands")
    clock, messages = Clock(), []
    began = store_in_thread(key, messages.append)
    receiver = LineReceiver(clock.now_ns, RATE, key=key, began=began)
    assert kind(receiver, sealed(5, 0, key)) == ""
    key.store_seen(5)
    again = LineReceiver(clock.now_ns, RATE, key=key)
    assert kind(again, sealed(4, 9, key)) == REPLAYED
    assert kind(again, sealed(6, 0, key)) == ""
    assert messages == []


def test_the_sessions_of_a_sender_rise_also_where_its_clock_or_its_file_is_lost(
    tmp_path, monkeypatch
):
    key = read_key(key_file(tmp_path), "grip")
    first = LineSender.begin(key).session
    monkeypatch.setattr("holdfast.core.line_key.time.time_ns", lambda: 0)
    assert LineSender.begin(key).session == first + 1
    monkeypatch.undo()
    (tmp_path / "link.key.grip.sent").unlink()
    assert LineSender.begin(key).session > first


def test_a_sender_without_a_key_has_a_session_that_cannot_be_guessed():
    numbers = {LineSender.begin().session for _ in range(100)}
    assert len(numbers) == 100
    assert 2**50 < max(numbers) <= LARGEST
    sent = LineSender(9).line('{"sequence":1,"a":2}')
    assert fields_of(sent) == {"session": 9, "sequence": 1, "a": 2}


@pytest.mark.parametrize(
    ("text", "mode", "error", "says"),
    [
        ("short", 0o600, UsageError, "32 to 64"),
        ("k" * 65, 0o600, UsageError, "32 to 64"),
        ("k" * 20 + " " + "k" * 20, 0o600, UsageError, "printable"),
        ("k" * 32, 0o640, UsageError, "chmod 600"),
        ("k" * 32, 0o604, UsageError, "chmod 600"),
    ],
)
def test_a_key_that_is_weak_or_open_is_refused(tmp_path, text, mode, error, says):
    with pytest.raises(error, match=says):
        read_key(key_file(tmp_path, text, mode), "grip")


def test_a_key_that_cannot_be_read_is_a_typed_error(tmp_path):
    with pytest.raises(DataNotFound, match="openssl"):
        read_key(tmp_path / "none", "grip")
    with pytest.raises(UsageError):
        read_key(tmp_path, "grip")
    with pytest.raises(UsageError):
        read_key(Path("/dev/zero"), "grip")
    if os.getuid():
        with pytest.raises(AccessDenied):
            read_key(key_file(tmp_path, mode=0o000), "grip")


@pytest.mark.parametrize("text", ["", "x", "-1", "9" * 17, str(2**53)])
def test_a_damaged_session_number_is_a_typed_error(tmp_path, text):
    key = read_key(key_file(tmp_path), "grip")
    (tmp_path / "link.key.grip.seen").write_text(text, encoding="utf-8")
    with pytest.raises(HoldfastError, match="session"):
        LineReceiver(Clock().now_ns, RATE, key=key)


def test_a_number_that_cannot_be_stored_is_reported(tmp_path):
    key = read_key(key_file(tmp_path), "grip")
    (tmp_path / "link.key.grip.seen").mkdir()
    messages: list[str] = []
    with pytest.raises(HoldfastError):
        key.store_seen(5)
    threads = []
    monkey = pytest.MonkeyPatch()
    monkey.setattr(
        "threading.Thread.start", lambda self: (threads.append(self), self.run())
    )
    store_in_thread(key, messages.append)(5)
    monkey.undo()
    assert "could be replayed" in messages[0]


# -- counting


def test_a_flood_is_one_line_a_second():
    clock, messages = Clock(), []
    tally = Tally("commands", messages.append, clock.now_ns)
    for k in range(4000):
        clock.ns = k * MS
        tally.count(OTHER_SESSION if k % 4 else NOT_UNDERSTOOD, f"{k} is skipped")
        tally.look()
    tally.flush()
    assert messages[:2] == [
        "commands: 0 is skipped",
        "commands: 249 more not understood, 750 more of another session",
    ]
    assert len(messages) == 5
    assert tally.total[OTHER_SESSION] == 3000


def test_the_first_few_of_a_second_are_shown_at_once():
    clock, messages = Clock(), []
    tally = Tally("command", messages.append, clock.now_ns, most_a_second=3)
    for k in range(5):
        tally.count("changes", f"{k}")
    clock.ns = 999 * MS
    tally.look()
    assert messages == ["command: 0", "command: 1", "command: 2"]
    clock.ns = 1000 * MS
    tally.look()
    tally.count("changes", "5")
    assert messages[3:] == ["command: 2 more changes", "command: 5"]


def test_a_line_has_16_kib_256_brackets_and_whole_numbers_of_63_bits_at_most():
    receiver = LineReceiver(Clock().now_ns, RATE, needs_session=False)

    def fits(text: bytes) -> bool:
        return kind(receiver, text) == ""

    padded = b'{"a":1}'.ljust(16 << 10)
    assert [fits(padded), fits(padded + b" ")] == [True, False]
    lists = [b'{"a":[' + b"[]," * (n - 3) + b"[]]}" for n in (256, 257)]
    assert [fits(one) for one in lists] == [True, False]
    whole = [2**63 - 1, -(2**63 - 1), 2**63, -(2**63), 10**20, 10**19]
    assert [fits(b'{"a":%d}' % one) for one in whole] == [True] * 2 + [False] * 4
    assert [fits(b'{"a":%s}' % one) for one in (b"1e308", b"-1e309")] == [True, False]


def test_a_session_and_a_sequence_go_from_zero_to_the_largest_whole_number_of_a_double():
    for session, sequence in ((0, 0), (LARGEST, LARGEST), (LARGEST + 1, 0), (0, -1)):
        fits = sequence >= 0 and session <= LARGEST
        receiver = LineReceiver(Clock().now_ns, RATE)
        expected = "" if fits else NOT_UNDERSTOOD
        assert kind(receiver, line(session, sequence)) == expected


@pytest.mark.parametrize("length", [31, 32, 64, 65])
def test_a_key_has_32_to_64_characters_and_no_space(tmp_path, length):
    path = key_file(tmp_path, "k" * length)
    if 32 <= length <= 64:
        assert read_key(path, "grip").key == b"k" * length
    else:
        with pytest.raises(UsageError, match="32 to 64 printable"):
            read_key(path, "grip")
    for text in ("k" * 31 + " k", "k" * 31 + "\u00e9", "k" * 31 + "\tk"):
        with pytest.raises(UsageError, match="32 to 64 printable"):
            read_key(key_file(tmp_path, text), "grip")


def test_numbers_of_sessions_are_stored_beside_the_key_and_rise(tmp_path, monkeypatch):
    key = read_key(key_file(tmp_path), "grip")
    monkeypatch.setattr(line_key.time, "time_ns", lambda: 5_000_999)
    assert [key.next_session() for _ in range(3)] == [5000, 5001, 5002]
    assert (tmp_path / "link.key.grip.sent").read_text() == "5002\n"
    (tmp_path / "link.key.grip.sent").write_text(f"{LARGEST - 1}\n")
    assert key.next_session() == LARGEST
    with pytest.raises(UsageError, match="no number of a session"):
        key.next_session()
    assert key.newest_seen() == 0
    key.store_seen(7)
    assert (tmp_path / "link.key.grip.seen").read_text() == "7\n"
    assert key.newest_seen() == 7
    assert LinkKey(KEY.key, "grip").next_session() == 5000


def test_a_tally_begins_a_new_second_after_one_and_its_report_counts_in_it():
    now_ns, lines = [10**9], []
    tally = Tally("a", lines.append, lambda: now_ns[0], 2)
    for at_ns in (0, 1, 2, 999_999_999):
        now_ns[0] = 10**9 + at_ns
        tally.count("kind", str(at_ns))
        tally.look()
    assert lines == ["a: 0", "a: 1"]
    now_ns[0] = 2 * 10**9
    tally.look()
    assert lines[2:] == ["a: 2 more kind"]
    # of the two that a second may have, the report was one
    for shown in "bcd":
        tally.count("other", shown)
    tally.count("kind", "e")
    assert lines[3:] == ["a: b"]
    tally.flush()
    tally.flush()
    assert lines[4:] == ["a: 1 more kind, 2 more other"]
    assert tally.total == {"kind": 5, "other": 3}
