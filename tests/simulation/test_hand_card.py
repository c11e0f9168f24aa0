"""Hand cards: what they refuse, how a hand of one touches, and where a card goes from there."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from small_model import artifact, card_of, graph_of, spec

from holdfast.core.errors import CardError, ChannelError, DataNotFound
from holdfast.core.hand_card import (
    HandCard,
    fill_unmeasured,
    hand_from_json,
    read_hand_card,
)
from holdfast.data.datasets import load
from holdfast.data.datasets.joining import join
from holdfast.edge_runtime.model_file import read_card
from holdfast.evaluation.model_outputs import require_model_fits
from holdfast.export.exporting import model_card, seal
from holdfast.simulation.physics.objects import hand_of_counts, load_factors
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.scene import Scene, SimulatedTrial
from holdfast.simulation.scenes.scene_file import read_scene_file

ROWS = """
[record]
rate_hz = 60
[physics]
step_s = 0.006
[[trials]]
objects = ["soft-ball", "empty-bottle"]
action = "pass"
weak_share = 0
close_at_s = 0.1
hold_s = 1.2
tail_s = 0.2
"""
TWO = """
name = "mine"
[[sensors]]
name = "a"
side = "thumb"
along_mm = 0
[[sensors]]
name = "b"
side = "opposing"
along_mm = 0
"""
BARE = '[[sensors]]\nname = "c"\nside = "opposing"\nalong_mm = 9\nsensed = false\n'
HELD_S = 0.9


def bare_contact(k: int) -> str:
    """One of many, each with a name and a place of its own."""
    return BARE.replace('"c"', f'"c{k}"').replace("along_mm = 9", f"along_mm = {k + 9}")


def card(tmp_path: Path, text: str) -> HandCard:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return read_hand_card(path)


def scene(tmp_path: Path, text: str) -> Scene:
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return Scene(read_scene_file(str(path)), 100)


def simulated(tmp_path: Path, text: str) -> list[SimulatedTrial]:
    made = scene(tmp_path, text)
    return made.run_together(made.trials())


def hand_line(name: str) -> str:
    return f'[hand]\ncard = "{name}"\n'


def test_the_card_of_six_fingertips_is_the_default_hand(tmp_path: Path) -> None:
    six, default = read_hand_card("six-fingertips"), hand_of_counts()
    for name in ("part", "along_m", "across_m", "sensed"):
        assert getattr(six, name).tolist() == getattr(default, name).tolist()
    assert six.sensor_sides == default.sensor_sides

    named = simulated(tmp_path, ROWS + hand_line("six-fingertips"))
    for one, other in zip(named, simulated(tmp_path, ROWS), strict=True):
        assert one.signal.values.tobytes() == other.signal.values.tobytes()
        assert one.trial.drawn == other.trial.drawn


@pytest.mark.parametrize(
    ("name", "sides"),
    [
        ("two-pad-gripper", (1, 1)),
        ("three-fingertips", (1, 2)),
        ("six-fingertips", (2, 4)),
        ("twelve-sensors", (4, 8)),
        ("pinch-pad", (6, 0)),
        ("pinch-pad-spread", (6, 0)),
        ("eflesh-gripper", (3, 3)),
    ],
)
def test_a_hand_of_a_shipped_card_holds(
    tmp_path: Path, name: str, sides: tuple[int, int]
) -> None:
    hand = read_hand_card(name)
    counts = [hand.sensor_sides.count(side) for side in ("thumb", "opposing")]
    assert tuple(counts) == sides

    for one in simulated(tmp_path, ROWS + hand_line(name)):
        assert one.signal.values.shape[1:] == (hand.n_sensors, 3)
        held_n = one.motion.forces_n[round(HELD_S * 60), :, 2]
        thumb_n, fingers_n = held_n[: hand.thumb].sum(), held_n[hand.thumb :].sum()
        assert thumb_n > 1.0
        assert thumb_n == pytest.approx(fingers_n, rel=0.2)


def test_a_contact_without_a_sensor_presses_and_has_no_channels(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(TWO + BARE, encoding="utf-8")
    # A path in a scene is seen from the scene's folder.
    for one in simulated(tmp_path, ROWS + hand_line("mine.toml")):
        assert one.signal.values.shape[1] == 2
        assert one.motion.forces_n.shape[1] == 3
        assert one.motion.forces_n[:, 2, 2].max() > 0.5
        assert (one.signal.values == one.motion.forces_n[:, :2]).all()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (('side = "thumb"', 'side = "palm"'), ["sensors[0].side", "thumb or opposing"]),
        (("along_mm = 0", "along_mm = 1e4"), ["sensors[0].along_mm", "-100 to 100"]),
        (("along_mm = 0", "along_mm = nan"), ["not valid TOML", "finite"]),
        (("along_mm = 0\n", ""), ["sensors[0].along_mm", "is missing"]),
        (('side = "opposing"', 'side = "thumb"'), ["one side", "sensed = false"]),
        (('side = "thumb"', 'side = "opposing"'), ["one side", "either side"]),
        (("along_mm = 0", "along_mm = 0\nsensed = false"), ["1 sensors", "2 to 12"]),
        (("along_mm = 0", "along_mm = 0\nheight = 1"), ["height", "across_mm"]),
        (("along_mm = 0", 'along_mm = 0\nmeasures = "z"'), ["measures", "xz or yz"]),
        (("along_mm = 0", 'along_mm = 0\nmeasures = "xy"'), ["measures", "xz or yz"]),
        (("along_mm = 0", 'along_mm = 0\nmeasures = ""'), ["measures", "xz or yz"]),
    ],
)
def test_a_card_that_is_no_hand_is_refused(
    tmp_path: Path, change: tuple[str, str], named: list[str]
) -> None:
    text = TWO.replace(*change, 1)
    with pytest.raises(CardError) as error:
        card(tmp_path, text)
    for word in named:
        assert word in str(error.value)


YZ_XZ = TWO.replace("along_mm = 0", 'along_mm = 0\nmeasures = "yz"', 1).replace(
    'opposing"\nalong_mm = 0', 'opposing"\nalong_mm = 0\nmeasures = "xz"'
)
NOISE = "[effects.hysteresis]\n[effects.white_noise]\nrms_n = 0.05\n"


def test_a_card_says_which_axes_are_measured_and_one_that_does_not_stays_as_it_was(
    tmp_path: Path,
) -> None:
    hand = card(tmp_path, YZ_XZ)
    assert hand.measured.tolist() == [False, True, True, True, False, True]
    assert hand.unmeasured_names == ("X1", "Y2")
    stored = hand.to_json()
    assert [one["measures"] for one in stored["contacts"]] == ["yz", "xz"]
    assert hand_from_json(stored).contacts == hand.contacts

    usual = read_hand_card("six-fingertips")
    assert usual.measured.all()
    assert not any("measures" in one for one in usual.to_json()["contacts"])
    text = BARE.replace("along_mm = 9", 'along_mm = 9\nmeasures = "yz"')
    with pytest.raises(CardError, match="'c' has no sensor"):
        card(tmp_path, TWO + text)


def test_zero_stands_in_place_of_an_axis_that_is_not_measured(tmp_path: Path) -> None:
    values = np.array([[np.nan, 2.0, 3.0, 4.0, -5.0, 6.0]])
    filled = fill_unmeasured(values, card(tmp_path, YZ_XZ))
    assert filled.tolist() == [[0.0, 2.0, 3.0, 4.0, 0.0, 6.0]]
    for hand in (card(tmp_path, TWO), None):
        assert fill_unmeasured(values, hand) is values


def test_a_scene_records_zero_on_such_an_axis_after_all_noise_and_all_else_as_before(
    tmp_path: Path,
) -> None:
    made = {}
    for name, text in (("whole", TWO), ("part", YZ_XZ)):
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
        made[name] = simulated(tmp_path, ROWS + hand_line(f"{name}.toml") + NOISE)
    measured = card(tmp_path, YZ_XZ).measured.reshape(2, 3)
    for part, whole in zip(made["part"], made["whole"], strict=True):
        assert whole.signal.values[:, ~measured].all()
        expected = np.where(measured, whole.signal.values, 0.0)
        assert part.signal.values.tobytes() == expected.tobytes()


def test_a_scene_in_field_units_needs_all_three_axes(tmp_path: Path) -> None:
    (tmp_path / "part.toml").write_text(YZ_XZ, encoding="utf-8")
    text = ROWS.replace("60\n", '60\nunit = "uT"\n', 1) + "[effects.dipole]\n"
    with pytest.raises(CardError, match=r"record.unit.*leaves out X1, Y2"):
        scene(tmp_path, text + hand_line("part.toml"))


def test_an_effect_on_a_sensor_that_the_hand_lacks_is_refused(tmp_path: Path) -> None:
    effect = "[effects.dipole]\n[effects.magnet_reversed]\nsensors = [3]\n"
    scene(tmp_path, ROWS + hand_line("three-fingertips") + effect)
    with pytest.raises(CardError, match=r"sensors from 1 to 2"):
        scene(tmp_path, ROWS + hand_line("two-pad-gripper") + effect)


def test_the_taxels_of_a_pad_bear_its_load_by_the_pressure_of_a_round_contact() -> None:
    hand = read_hand_card("pinch-pad")
    centred = {"patch_mm": 10.0, "press_off_mm": 0.0}
    factors = load_factors(hand, centred, np.random.default_rng(0))

    pad = hand.pads[0]
    places = np.stack([hand.along_m[pad], hand.across_m[pad]])
    off_m = np.hypot(*(places - places.mean(axis=1, keepdims=True)))
    law = np.sqrt(np.clip(1.0 - (off_m / 0.01) ** 2, 0.0, None))
    assert factors[pad] == pytest.approx(law)
    assert law.max() > 1.3 * law[law > 0].min()

    # A contact smaller than the distance of two taxels still rests on one.
    tiny = load_factors(hand, {**centred, "patch_mm": 0.5}, np.random.default_rng(0))
    assert (tiny[pad] > 0).sum() == 1


@pytest.mark.parametrize("touching", [2, 4, 6])
def test_fingers_that_do_not_touch_feel_nothing_and_the_others_bear_all(
    tmp_path: Path, touching: int
) -> None:
    given = f"touching = {touching}\nshare_spread = 0.6\n"
    trials = simulated(tmp_path, ROWS + given)
    for one, whole in zip(trials, simulated(tmp_path, ROWS), strict=True):
        share = one.trial.share
        assert (share > 0.0).sum() == touching
        assert share[:2].sum() == pytest.approx(1.0)
        assert share[2:].sum() == pytest.approx(1.0)

        felt = one.motion.forces_n[:, share == 0.0]
        assert felt.shape[1] == 6 - touching
        assert not felt.any()
        # Nothing else of the trial is drawn otherwise.
        drawn = {**one.trial.drawn, "share_spread": 0.2}
        assert drawn.pop("touching") == touching
        assert drawn == whole.trial.drawn
        assert one.trial.grip_n == whole.trial.grip_n


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Sets of three hands of six sensors: of a card, of another card, of none."""
    folder = tmp_path_factory.mktemp("sets")
    lines = {
        "six": hand_line("six-fingertips"),
        "pinch": hand_line("pinch-pad"),
        "none": "",
    }
    for name, line in lines.items():
        write_set(scene(folder, ROWS + line), folder / name, 2)
    return {name: folder / name for name in lines}


def test_a_set_names_its_card_and_has_it_with_it(sets: dict[str, Path]) -> None:
    meta = json.loads((sets["pinch"] / "meta.json").read_text("utf-8"))
    hand = read_hand_card("pinch-pad")
    assert meta["hand"] == {"card": "pinch-pad", "sha256": hand.sha256}
    assert (sets["pinch"] / "hand.toml").read_text("utf-8") == hand.text

    assert not (sets["none"] / "hand.toml").exists()
    assert "hand" not in json.loads((sets["none"] / "meta.json").read_text("utf-8"))


def test_sets_of_hands_with_other_sides_are_not_joined(sets: dict[str, Path]) -> None:
    made = {name: load(path, windows="natural") for name, path in sets.items()}
    with pytest.raises(ChannelError, match=r"sides: .*opposing|sides: .*thumb"):
        join([made["six"], made["pinch"]])
    # A set without a card may be of any hand with as many sensors.
    named = [replace(made[name], name=name) for name in ("none", "six", "pinch")]
    assert join(named[:2]).hand == made["six"].hand
    with pytest.raises(ChannelError, match=r"sides: .*opposing|sides: .*thumb"):
        join(named)


def test_a_set_with_the_card_of_another_hand_is_refused(
    sets: dict[str, Path], tmp_path: Path
) -> None:
    write_set(scene(tmp_path, ROWS + hand_line("pinch-pad")), tmp_path / "set", 2)
    copy = tmp_path / "set" / "hand.toml"
    copy.write_bytes((sets["six"] / "hand.toml").read_bytes())
    with pytest.raises(ChannelError, match="another hand"):
        load(tmp_path / "set", windows="natural")
    copy.unlink()
    with pytest.raises(DataNotFound, match=re.escape("no hand.toml")):
        load(tmp_path / "set", windows="natural")


def test_a_model_carries_the_card_and_is_not_scored_on_another_hand(
    sets: dict[str, Path],
) -> None:
    pinch, six = (load(sets[name], windows="natural") for name in ("pinch", "six"))
    made = artifact(
        msgspec.structs.replace(spec(("now",), n_sensors=6), hand=pinch.hand)
    )
    data = seal(graph_of(made), model_card(made), made.spec)
    stored = read_card({"holdfast.card": json.dumps(card_of(data)), **SEALED})
    assert stored.hand is not None
    assert stored.hand.sensor_sides == ("thumb",) * 6
    assert stored.hand.sha256 == read_hand_card("pinch-pad").sha256

    class Opened:
        card = msgspec.structs.replace(
            stored, spec=msgspec.structs.replace(stored.spec, rate_hz=60.0)
        )

    require_model_fits(Opened(), pinch)  # type: ignore[arg-type]
    with pytest.raises(ChannelError, match="six-fingertips"):
        require_model_fits(Opened(), six)  # type: ignore[arg-type]


SEALED = {"holdfast.sha256": "0" * 64}


def test_a_hand_has_at_most_12_sensors_and_32_contacts(tmp_path: Path) -> None:
    bare = "".join(bare_contact(k) for k in range(31))
    with pytest.raises(CardError, match="33 of them"):
        card(tmp_path, TWO + bare)
    with pytest.raises(CardError, match="sensors"):
        card(tmp_path, TWO + bare.replace("sensed = false\n", ""))
    more = bare.replace("sensed = false\n", "", 10)
    made = card(tmp_path, TWO + more.removesuffix(bare_contact(30)))
    assert (made.n_sensors, made.n_contacts) == (12, 32)
