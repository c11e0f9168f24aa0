"""Protocol cards and questionnaires: the thesis' table 5.4, cards of one's own, and scores."""

from __future__ import annotations

import re
from collections import Counter
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from study_bench import TALK, TRIALS, protocol_of

from holdfast.core.errors import CardError, DataNotFound
from holdfast.core.trial_layout import MASSES_G
from holdfast.sessions.recorder.protocol import Task
from holdfast.sessions.study.protocol import (
    FORMS,
    QUESTIONNAIRE,
    RECORD,
    VIDEO,
    names_in,
    read_study,
)
from holdfast.sessions.study.questionnaires import read_questionnaire
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file

THESIS = read_study("thesis")
OBJECTS = ("basket-ball", "soft-ball", "empty-bottle", "hard-ball", "full-bottle")


def test_the_shipped_card_has_31_steps_and_49_minutes_as_the_table_of_the_thesis() -> (
    None
):
    steps = [part.step for part in THESIS.parts if part.step is not None]
    assert (THESIS.first_step, THESIS.last_step) == (0, 31)
    assert sorted(set(steps)) == list(range(32))
    assert steps == sorted(steps)
    assert THESIS.minutes == 49.0
    kinds = Counter(part.kind for part in THESIS.parts)
    assert kinds == {
        "say": 1,
        "mount": 1,
        "video": 15,
        "questions": 16,
        "record": 15,
    } | {"questionnaire": 2}
    assert [part.minutes for part in THESIS.parts[:6]] == [2, 1, 1, 0.5, 0.5, 2]


def test_its_trials_are_five_objects_with_three_actions_three_times_and_heavy_ones_fall() -> (
    None
):
    recorded = [part for part in THESIS.parts if part.kind == RECORD]
    assert [part.repetitions for part in recorded] == [3] * 15
    tasks = [part.task for part in recorded]
    risky = {name: "pull" if MASSES_G[name] < 150.0 else "fall" for name in OBJECTS}
    assert tasks == [
        Task(name, action)
        for name in OBJECTS
        for action in ("pass", risky[name], "put-down")
    ]
    assert [part.step for part in recorded] == list(range(3, 32, 2))
    put_down = [
        part.hand_over
        for part in recorded
        if part.task and part.task.action == "put-down"
    ]
    assert all("box" in one for one in put_down)


def test_a_virtual_participant_of_every_style_has_all_its_trials() -> None:
    wanted = Counter(THESIS.recording_protocol().tasks)
    for style in ("p1", "p2"):
        trials = Scene(read_scene_file(style), 0).trials()
        assert Counter(Task(one.object.name, one.action) for one in trials) == wanted


def test_before_each_recording_a_video_and_questions_of_the_same_object_and_action() -> (
    None
):
    for number, part in enumerate(THESIS.parts):
        if part.kind == RECORD:
            video, questions = THESIS.parts[number - 2 : number]
            assert (video.kind, questions.kind) == (VIDEO, "questions")
            assert video.title.partition(": ")[2] == part.title.partition(": ")[2] != ""
    room = [(part.room_before, part.room_after) for part in THESIS.parts]
    assert (
        sum(bool(first) for first, _ in room)
        == sum(bool(last) for _, last in room)
        == 5
    )


def test_the_list_shows_every_step_with_its_minutes_and_the_sum() -> None:
    lines = THESIS.listing()
    assert lines[-1] == "steps 0 to 31, 49 minutes"
    assert (
        sum(
            float(m[1])
            for m in map(re.compile(r" +\d+ +([\d.]+) min").match, lines)
            if m
        )
        == 49
    )


def test_one_table_makes_the_steps_of_every_object_and_action(tmp_path) -> None:
    card = read_study(protocol_of(tmp_path, TRIALS))
    assert [part.title for part in card.parts] == [
        "Welcome",
        "Training: soft ball, pass",
        "Testing: soft ball, pass",
        "Training: soft ball, pull",
        "Testing: soft ball, pull",
        "Training: hard-ball, fall",
        "Testing: hard-ball, fall",
    ]
    assert [part.step for part in card.parts] == [1, 2, 3, 4, 5, 6, 7]
    assert [bool(part.room_before) for part in card.parts] == [
        False,
        True,
        False,
        False,
        False,
        True,
        False,
    ]


STEP = "[[steps]]\nkind = 'say'\nminutes = 1\n"
EACH = "[objects.a]\nactions = ['pull']\n[[steps]]\nobjects = ['a']\n[[steps.each]]\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[[steps", "not valid TOML"),
        ("", "steps = None"),
        ("colour = 1\n" + STEP, "'colour' is not known"),
        ("[[steps]]\nkind = 'dance'\nminutes = 1", "steps[1].kind = 'dance'"),
        (STEP + "[[steps]]\nkind = 'say'\nminutes = 0", "steps[2].minutes = 0"),
        (STEP + "[[steps]]\nkind = 'say'\nminutes = nan", "steps[2].minutes = nan"),
        (STEP + "[[steps]]\nkind = 'say'", "steps[2].minutes = None"),
        (STEP + "repetitions = 2", "steps[1].repetitions = 2"),
        (STEP + "say = 3", "steps[1].say = 3"),
        (STEP + "say = 'Take the {object}'", "steps[1].say = '{object}'"),
        (STEP + "say = 'Take the {'", "steps[1].say"),
        (STEP + "after = 3", "'after' is not known"),
        ("[[steps]]\nkind = 'questions'\nminutes = 1", "steps[1].kind = 'questions'"),
        ("[[steps]]\nkind = 'record'\nminutes = 1", "steps[1].action = None"),
        (
            "[[steps]]\nkind = 'record'\nminutes = 1\naction = 'pull'",
            "steps[1].object = None",
        ),
        (
            EACH + "kind = 'record'\nminutes = 1\nrepetitions = 0",
            "each[1].repetitions = 0",
        ),
        (EACH + "kind = 'say'\nminutes = 1\nsay = '{name}'", "each[1].say = '{name}'"),
        (
            "[[steps]]\nobjects = ['a']\n[[steps.each]]\nkind = 'say'\nminutes = 1",
            "objects = 'a'",
        ),
        ("[[steps]]\nobjects = ['a']", "steps[1].each = None"),
        ("[objects.a]\nactions = ['fly']\n" + STEP, "objects.a.actions = 'fly'"),
        ("[objects.'a b']\nactions = ['pull']\n" + STEP, "objects.a b = 'a b'"),
        ("[objects.a]\nmass_g = -1\n" + STEP, "objects.a.mass_g = -1"),
        ("[actions.fly]\nhow = 'up'\n" + STEP, "actions.fly = 'fly'"),
        ("questionnaires = ['mood']\n" + STEP, "questionnaires = 'mood'"),
        ("first_step = -1\n" + STEP, "first_step = -1"),
    ],
)
def test_a_card_that_cannot_be_is_refused_by_its_step_and_key(
    tmp_path, text, says
) -> None:
    with pytest.raises(CardError, match=re.escape(says)) as error:
        read_study(protocol_of(tmp_path, text))
    assert "protocol.toml" in str(error.value)
    assert "next: " in str(error.value)


def test_a_name_that_is_no_card_is_answered_with_those_that_are() -> None:
    with pytest.raises(DataNotFound, match="one of thesis"):
        read_study("tesis")


def test_a_questionnaire_can_stand_between_steps_and_has_no_number_of_its_own(
    tmp_path,
) -> None:
    between = "[[steps]]\nkind = 'questionnaire'\nquestionnaire = 'nasa-tlx'\n"
    card = read_study(protocol_of(tmp_path, STEP + between + STEP))
    assert [(part.kind, part.step) for part in card.parts] == [
        ("say", 1),
        (QUESTIONNAIRE, None),
        ("say", 2),
    ]
    assert card.minutes == 2.0
    assert [
        part.questionnaire for part in read_study(protocol_of(tmp_path, TALK)).parts
    ][-1] == "sus"


# -- questionnaires

SUS, TLX = read_questionnaire("sus"), read_questionnaire("nasa-tlx")


def test_the_two_questionnaires_have_their_items_scales_and_sources() -> None:
    assert names_in(FORMS) == ["nasa-tlx", "sus"]
    assert (len(TLX.items), TLX.lowest, TLX.highest, TLX.step) == (6, 0, 100, 5)
    assert (len(SUS.items), SUS.lowest, SUS.highest, SUS.step) == (10, 1, 5, 1)
    assert [item.reversed for item in SUS.items] == [False, True] * 5
    assert not any(item.reversed for item in TLX.items)
    assert "Brooke" in SUS.source
    assert "Hart" in TLX.source


@given(st.lists(st.integers(1, 5), min_size=10, max_size=10))
def test_the_sus_is_two_and_a_half_times_the_sum_of_its_contributions(ratings) -> None:
    odd, even = ratings[0::2], ratings[1::2]
    expected = 2.5 * (sum(one - 1 for one in odd) + sum(5 - one for one in even))
    answers = {
        item.name: rating for item, rating in zip(SUS.items, ratings, strict=True)
    }
    assert SUS.score(answers) == expected


@given(st.lists(st.integers(0, 20), min_size=6, max_size=6))
def test_the_raw_tlx_is_the_mean_of_its_six_scales(ticks) -> None:
    answers = {item.name: 5 * tick for item, tick in zip(TLX.items, ticks, strict=True)}
    assert TLX.score(answers) == float(Fraction(5 * sum(ticks), 6))
    assert all(TLX.allows(rating) for rating in answers.values())


@pytest.mark.parametrize(
    ("ratings", "score"), [((5, 1), 100.0), ((1, 5), 0.0), ((3, 3), 50.0)]
)
def test_known_values_of_the_sus(ratings, score) -> None:
    answers = {item.name: ratings[k % 2] for k, item in enumerate(SUS.items)}
    assert SUS.score(answers) == score


def test_an_item_that_is_left_out_leaves_no_score() -> None:
    answers: dict[str, int | None] = {item.name: 3 for item in SUS.items}
    assert SUS.score(answers | {"easy": None}) is None
    assert SUS.score({}) is None


@pytest.mark.parametrize("rating", [-5, 3, 101, 105])
def test_a_rating_that_is_not_on_the_scale_is_not_allowed(rating) -> None:
    assert not TLX.allows(rating)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("lowest = 1\nhighest = 5\nstep = 1", "items = None"),
        ("lowest = 5\nhighest = 1\nstep = 1", "step = 1"),
        ("lowest = 0\nhighest = 5\nstep = 2", "step = 2"),
        (
            "lowest = 0\nhighest = 5\nstep = 1\n[[items]]\nname = 'a'",
            "items[1].ask = None",
        ),
        ("lowest = 'a'", "lowest = 'a'"),
    ],
)
def test_a_questionnaire_that_cannot_be_is_refused_by_its_key(
    tmp_path, text, says
) -> None:
    with pytest.raises(CardError, match=re.escape(says)):
        read_questionnaire(str(protocol_of(tmp_path, text)))
