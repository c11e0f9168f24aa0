"""Cards: read like an experiment, checked to the last key, and nothing on them that does not
run."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from holdfast.core.errors import CardError
from holdfast.simulation import STYLES, shipped_scenes
from holdfast.simulation.effects.effect import all_effects
from holdfast.simulation.scenes.protocol import least_grip_n
from holdfast.simulation.scenes.scene import Scene, apportion
from holdfast.simulation.scenes.scene_file import read_scene_file

PLAIN = """
[[trials]]
objects = ["soft-ball"]
action = "pull"
"""


def card(tmp_path: Path, text: str) -> str:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("name", shipped_scenes())
def test_every_shipped_card_is_valid_at_every_rate(name):
    for rate_hz in (50.0, 100.0, 150.0, 300.0):
        assert read_scene_file(name, rate_hz=rate_hz).rate_hz == rate_hz


def test_a_new_card_needs_no_code(tmp_path):
    text = (
        "[objects.pear]\nmass_g = 180\nradius_mm = 32\naxial_radius_mm = 50\nfriction = 0.5\n"
        + PLAIN
    )
    trials = Scene(
        read_scene_file(card(tmp_path, text.replace("soft-ball", "pear"))), 0
    ).trials()
    assert [trial.object.mass_g for trial in trials] == [180.0]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (PLAIN.replace("pull", "throw"), ["trials[0].action", "throw", "put-down"]),
        (PLAIN + 'style = "p9"\n', ["trials[0].style", "p9", "author"]),
        (PLAIN + "hold_s = -1\n", ["trials[0].hold_s", "-1", "0.8 to 600 s"]),
        (PLAIN + "hold_s = { uniform = [3, 2] }\n", ["hold_s", "low before high"]),
        (PLAIN + "open_after_s = 1\n", ["open_after_s", "not known", "distance_m"]),
        (PLAIN + "[effects.magic]\n", ["magic", "not known", "hall_noise"]),
        (PLAIN + "[effects.brush]\nnumber = 3\n", ["effects.brush", "number", "count"]),
        (
            PLAIN + "[effects.hall_noise]\n",
            ["effects.hall_noise", "only together with [effects.dipole]"],
        ),
        (PLAIN + '[record]\nunit = "uT"\n', ["record.unit", "uT", "dipole"]),
        (
            PLAIN + '[record]\nunit = "uT"\n[effects.dipole]\n[effects.white_noise]\n',
            ["effects.white_noise", 'record.unit = "N"'],
        ),
        (
            PLAIN + "[record]\nrate_hz = 1000\n[effects.averaging]\n",
            ["record.rate_hz", "1000", "412 Hz"],
        ),
        (
            PLAIN + "[physics]\nstep_s = 0.01\n[effects.texture]\n",
            ["physics.step_s", "0.01", "0.001 s"],
        ),
        (
            "[objects.lead]\nmass_g = 5000\nfriction = 0.3\n"
            + PLAIN.replace("soft-ball", "lead"),
            ["trials[0].objects", "lead", "70 N"],
        ),
        ("title = 'x'", ["trials", "is missing"]),
        ("[trails]\n" + PLAIN, ["trails", "not known", "trials"]),
    ],
)
@pytest.mark.hard_case(
    "What comes from outside",
    "a scene card that says what cannot be",
    elsewhere="an unknown key is ignored, and the default runs",
    here="refused: key, value, and what is allowed",
)
def test_a_card_that_cannot_be_is_refused_in_one_line(tmp_path, text, named):
    with pytest.raises(CardError) as error:
        read_scene_file(card(tmp_path, text))
    assert "\n" not in str(error.value)
    assert "mine.toml" in str(error.value)
    for word in named:
        assert word in str(error.value)


def test_styles_say_only_what_actions_know():
    from holdfast.simulation.actions import COMMON, parameters_of

    for style in tomllib.loads(STYLES.read_text("utf-8")).values():
        for action, result in style.items():
            table = COMMON if action == "all" else parameters_of(action)
            assert {
                name: table[name].problem(value) for name, value in result.items()
            } == dict.fromkeys(result)


def test_every_effect_has_a_default_that_is_allowed():
    for effect in all_effects().values():
        assert [
            name
            for name, p in effect.parameters.items()
            if p.default is not None and p.problem(p.default)
        ] == []
        assert set(effect.needs) <= set(all_effects())


def test_shares_of_a_total_are_whole_and_add_up():
    assert apportion(10, [60, 60, 1]) == [5, 5, 0]
    assert sum(apportion(17, [3, 5, 7])) == 17


def test_no_grip_is_gentler_than_a_hand_can_keep_but_where_the_object_must_fall():
    trials = Scene(read_scene_file("thesis"), 0).trials()
    grips = [
        trial.grip_n for trial in trials if trial.action not in ("fall", "nothing")
    ]
    assert min(grips) == 0.5
    for trial in trials:
        if trial.action == "fall":
            assert trial.grip_n < least_grip_n(
                trial.object, trial.drawn["friction_factor"]
            )
