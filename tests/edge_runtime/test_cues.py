"""Vibration cues: which is sent when, and what a card of them may say."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import pytest
from hazard_marks import SILENT_CUES
from hypothesis import given, settings
from hypothesis import strategies as st
from made_prediction import prediction

from holdfast.core.contract import Prediction
from holdfast.core.errors import CardError
from holdfast.live.cues import KINDS, CueRule, Cues, CueTable, Kind, cue_line, read_cues

MS = 1_000_000
SHIPPED_TABLE = read_cues()
KNOWN = ("nothing", "grasp", "safe_slip", "risky_slip")


def at(
    ms: int, state: str = "grasp", *, act: bool = False, arm: bool = False
) -> Prediction:
    return prediction(state=state, act=act, arm=arm, t_decided_ns=ms * MS)


def due(cues: Cues, one: Prediction) -> Kind | None:
    return cues.due(one.state, one.act, one.arm, one.t_decided_ns)


def played(table: CueTable, stream: list[Prediction]) -> list[tuple[int, Kind]]:
    """(ms, kind) of all cues that are sent."""
    cues, out = Cues(table), []
    for one in stream:
        kind = due(cues, one)
        if kind is not None:
            cues.sent(kind, one.t_decided_ns)
            out.append((one.t_decided_ns // MS, kind))
    return out


def table(most_per_s: int = 3, **rules: CueRule) -> CueTable:
    kinds: dict[Any, CueRule] = {"unknown": CueRule(1, 600, 0, 0.5), **rules}
    return CueTable(kinds, most_per_s)


def short(after_ms: int = 0, *, urgent: bool = False) -> CueRule:
    return CueRule(1, 10, 0, 0.5, after_ms, urgent=urgent)


@st.composite
def tables(draw: st.DrawFn) -> CueTable:
    times = st.sampled_from([0, 0, 30, 400])
    rules = st.builds(
        CueRule,
        st.integers(1, 4),
        st.integers(10, 300),
        st.integers(10, 200),
        st.just(0.5),
        times,
        times,
        st.booleans(),
    )
    kinds = draw(st.dictionaries(st.sampled_from(KINDS[1:]), rules))
    unknown = CueRule(5, 90, 90, 0.5, draw(times), draw(times))
    return CueTable(kinds | {"unknown": unknown}, draw(st.integers(1, 5)))


@st.composite
def streams(draw: st.DrawFn) -> list[Prediction]:
    """States that flicker, and last, at up to 150 samples a second."""
    runs = st.tuples(
        st.sampled_from(("unknown", *KNOWN)), st.booleans(), st.integers(1, 40)
    )
    now, out = 0, []
    for state, act, length in draw(st.lists(runs, max_size=40)):
        for _ in range(length):
            now += draw(st.sampled_from([7, 7, 7, 50]))
            out.append(at(now, state, act=act))
    return out


@settings(deadline=None, max_examples=60)
@given(tables(), streams())
def test_no_cue_cuts_off_another_but_an_urgent_one_that_is_not(cards, stream):
    sent = played(cards, stream)
    # what an urgent one has cut off is over, so each is seen beside the last before it
    for (before_ms, before), (ms, kind) in pairwise(sent):
        end_ms = before_ms + cards.rules[before].length_ns / MS
        if not cards.rules[kind].urgent:
            assert end_ms <= ms
            assert ms - before_ms >= 1000 // cards.most_per_s
        elif cards.rules[before].urgent:
            assert end_ms <= ms


@settings(deadline=None, max_examples=60)
@given(tables(), streams())
def test_the_cue_that_is_sent_is_the_first_that_applies(cards, stream):
    now = {one.t_decided_ns // MS: one for one in stream}
    for ms, kind in played(cards, stream):
        one = now[ms]
        applies = {one.state, *(["act"] if one.act else [])}
        assert kind == next(
            name for name in KINDS if name in applies and name in cards.rules
        )


def test_an_urgent_cue_passes_a_limit_that_is_used_up():
    cards = table(1, grasp=short(), act=short(urgent=True))
    stream = [at(0), at(20, act=True), at(40), at(60, act=True), at(80), at(1070)]
    assert played(cards, stream) == [
        (0, "grasp"),
        (20, "act"),
        (60, "act"),
        (1070, "grasp"),
    ]


def test_a_blink_of_a_state_is_no_cue():
    cards = table(grasp=short(after_ms=50))
    blink = [at(0, "nothing"), at(7), at(14), at(21, "nothing")]
    assert played(cards, blink) == []
    assert played(cards, [at(ms) for ms in (0, 7, 49, 50, 57)]) == [(50, "grasp")]


def test_a_cue_that_did_not_leave_stays_due():
    cues = Cues(SHIPPED_TABLE)
    assert due(cues, at(0, "risky_slip", act=True)) == "act"
    assert due(cues, at(7, "risky_slip", act=True)) == "act"
    cues.sent("act", 7 * MS)
    assert due(cues, at(14, "risky_slip", act=True)) is None


@SILENT_CUES.mark
def test_an_unknown_state_has_its_own_cue_also_during_a_request_and_repeats_it():
    stream = [at(7 * k, "unknown", act=True) for k in range(1000)]
    out = played(SHIPPED_TABLE, stream)
    assert [kind for _, kind in out] == ["unknown", "unknown"]
    own = SHIPPED_TABLE.rules["unknown"].felt
    assert all(
        one.felt != own
        for name, one in SHIPPED_TABLE.rules.items()
        if name != "unknown"
    )


def test_a_line_is_whole_json_with_every_figure_of_its_pattern():
    line = json.loads(cue_line(812, 5413333333, "act", CueRule(3, 60, 40, 1.0)))
    assert line == {
        "sequence": 812,
        "t_ns": 5413333333,
        "cue": "act",
        "pulses": 3,
        "on_ms": 60,
        "off_ms": 40,
        "strength": 1.0,
        "expires_ms": 3000,
    }


# -- cards

UNKNOWN = "[cues.unknown]\npulses = 1\non_ms = 600\noff_ms = 0\nstrength = 0.5\n"
ACT = "[cues.act]\npulses = 2\non_ms = 60\noff_ms = 40\nstrength = 1.0\n"
WHOLE = f"most_per_s = 3\n{UNKNOWN}{ACT}"


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("pulses = 2", "pulses = 0", "cues.act.pulses = 0"),
        ("pulses = 2", "pulses = 2.0", "cues.act.pulses"),
        ("pulses = 2", "pulses = true", "cues.act.pulses"),
        ("on_ms = 60\n", "", "cues.act.on_ms is missing"),
        ("strength = 1.0", "strength = 1.5", "cues.act.strength"),
        ("strength = 1.0", "strength = nan", "nan"),
        ("strength = 1.0", 'strength = "much"', "cues.act.strength"),
        ("strength = 1.0", "strength = 1\nurgent = 1", "cues.act.urgent = 1"),
        ("strength = 1.0", "strength = 1\ncolour = 1", "colour"),
        ("cues.act", "cues.sliding", "sliding"),
        ("most_per_s = 3", "most_per_s = 50", "most_per_s"),
        ("most_per_s = 3", "", "most_per_s"),
        (UNKNOWN, "", r"no \[cues.unknown\]"),
        ("pulses = 2\non_ms = 60", "pulses = 1\non_ms = 600", "same pulses"),
        ("[cues.act]", "[cues.act", "not valid TOML"),
    ],
)
def test_a_card_that_cannot_be_is_refused_with_its_place(tmp_path, old, new, what):
    card = tmp_path / "cues.toml"
    assert old in WHOLE
    card.write_text(WHOLE.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(CardError, match=what) as refused:
        read_cues(card)
    assert "cues.toml" in str(refused.value)
