"""Protocol cards: the thesis' table 5.4, and cards of one's own."""

from __future__ import annotations

import re
from collections import Counter

import pytest
from study_bench import TRIALS, protocol_of

from holdfast.core.errors import CardError, DataNotFound
from holdfast.core.trial_layout import MASSES_G
from holdfast.sessions.recorder.protocol import Task
from holdfast.sessions.study.protocol import (
    RECORD,
    read_study,
)
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file

THESIS = read_study("thesis")
OBJECTS = ("basket-ball", "soft-ball", "empty-bottle", "hard-ball", "full-bottle")


def test_the_shipped_card_has_31_steps_and_49_minutes_as_the_table_of_the_thesis() -> (
    None
):
    steps = [part.step for part in THESIS.parts]
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
    }
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
    wanted = Counter(THESIS.tasks)
    for style in ("p1", "p2"):
        trials = Scene(read_scene_file(style), 0).trials()
        assert Counter(Task(one.object.name, one.action) for one in trials) == wanted


def test_before_each_recording_a_video_and_questions_of_the_same_object_and_action() -> (
    None
):
    for number, part in enumerate(THESIS.parts):
        if part.kind == RECORD:
            video, questions = THESIS.parts[number - 2 : number]
            assert (video.kind, questions.kind) == ("video", "questions")
            assert video.title.partition(": ")[2] == part.title.partition(": ")[2] != ""
    room = [(part.room_before, part.room_after) for part in THESIS.parts]
    assert (
        sum(bool(first) for first, _ in room)
        == sum(bool(last) for _, last in room)
        == 5
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
        ("", "steps is missing"),
        ("colour = 1\n" + STEP, "colour is not known"),
        (STEP + "[[steps]]\nkind = 'say'\nminutes = 0", "steps[1].minutes = 0"),
        ("[[steps]]\nkind = 'dance'\nminutes = 1", "steps[0].kind = 'dance'"),
        (STEP + "say = 'Take the {object}'", "steps[0]: 'Take the {object}'"),
        (STEP + "say = 'Take the {'", "steps[0]: 'Take the {'"),
        ("[[steps]]\nkind = 'questions'\nminutes = 1", "steps[0].kind = 'questions'"),
        ("[[steps]]\nkind = 'record'\nminutes = 1", "steps[0]: action = None"),
        (
            "[[steps]]\nkind = 'record'\nminutes = 1\naction = 'pull'",
            "steps[0]: objects = []",
        ),
        (
            EACH + "kind = 'record'\nminutes = 1\nrepetitions = 0",
            "steps[0].each[0].repetitions = 0",
        ),
        (EACH + "kind = 'say'\nminutes = 1\nsay = '{name}'", "steps[0]: '{name}'"),
        (
            "[[steps]]\nobjects = ['a']\n[[steps.each]]\nkind = 'say'\nminutes = 1",
            "objects = 'a'",
        ),
        ("[[steps]]\nobjects = ['a']", "steps[0]: objects = ['a']"),
        ("[objects.a]\nactions = ['fly']\n" + STEP, "objects.a: action = 'fly'"),
        ("[objects.'a b']\nactions = ['pull']\n" + STEP, "object = 'a b'"),
        ("[actions.fly]\nhow = 'up'\n" + STEP, "action = 'fly'"),
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
