"""Protocol cards: the thesis' table 5.4, and cards of one's own."""

from __future__ import annotations

import re
from collections import Counter

import pytest
from study_bench import protocol_of

from holdfast.core.errors import CardError
from holdfast.sessions.recorder.plan import Task
from holdfast.sessions.study.protocol import read_study
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file

THESIS = read_study("thesis")


def test_a_virtual_participant_of_every_style_has_all_its_trials() -> None:
    wanted = Counter(THESIS.tasks)
    for style in ("p1", "p2"):
        trials = Scene(read_scene_file(style), 0).trials()
        assert Counter(Task(one.object.name, one.action) for one in trials) == wanted


STEP = "[[steps]]\nkind = 'say'\nminutes = 1\n"
EACH = "[objects.a]\nactions = ['pull']\n[[steps]]\nobjects = ['a']\n[[steps.each]]\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[[steps", "not valid TOML"),
        ("", "steps is missing"),
        (STEP + "[[steps]]\nkind = 'say'\nminutes = 0", "steps[1].minutes = 0"),
        (STEP + "say = 'Take the {object}'", "steps[0]: 'Take the {object}'"),
        ("[[steps]]\nkind = 'questions'\nminutes = 1", "steps[0].kind = 'questions'"),
        ("[[steps]]\nkind = 'record'\nminutes = 1", "steps[0]: action = None"),
        (
            "[[steps]]\nkind = 'record'\nminutes = 1\naction = 'pull'",
            "steps[0]: objects = []",
        ),
        (EACH + "kind = 'say'\nminutes = 1\nsay = '{name}'", "steps[0]: '{name}'"),
        (
            "[[steps]]\nobjects = ['a']\n[[steps.each]]\nkind = 'say'\nminutes = 1",
            "objects = 'a'",
        ),
        ("[[steps]]\nobjects = ['a']", "steps[0]: objects = ['a']"),
        ("[objects.a]\nactions = ['fly']\n" + STEP, "objects.a: action = 'fly'"),
        ("[objects.'a b']\nactions = ['pull']\n" + STEP, "object = 'a b'"),
    ],
)
def test_a_card_that_cannot_be_is_refused_by_its_step_and_key(
    tmp_path, text, says
) -> None:
    with pytest.raises(CardError, match=re.escape(says)) as error:
        read_study(protocol_of(tmp_path, text))
    assert "protocol.toml" in str(error.value)
    assert "next: " in str(error.value)
