"""Scenes as two force transducers feel them keep what happens, and read as the transducers do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from holdfast.core.errors import CardError
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import SceneFile, read_scene_file
from studies.people.two_pads import (
    CARD,
    NOISE_N,
    NOT_OF_TRANSDUCERS,
    ORDER,
    SHIPPED,
    write_two_pad_scene,
)


def two_pads(scene: str, folder: Path, rate_hz: float = 150.0) -> SceneFile:
    return read_scene_file(str(write_two_pad_scene(scene, rate_hz, folder)))


@pytest.mark.parametrize("name", SHIPPED)
def test_a_two_pad_scene_keeps_every_action_object_and_effect_of_the_physics(
    name: str, tmp_path: Path
) -> None:
    shipped = read_scene_file(name)
    felt = two_pads(name, tmp_path)

    assert felt.hand.name == CARD
    assert len(felt.rows) == len(shipped.rows)
    for row, of_shipped in zip(felt.rows, shipped.rows, strict=True):
        values = dict(of_shipped.values)
        values.pop("touching", None)
        assert (row.objects, row.action, row.style, row.count) == (
            of_shipped.objects,
            of_shipped.action,
            of_shipped.style,
            of_shipped.count,
        )
        assert dict(row.values) == values
    effects = [one for one in shipped.effects if one not in NOT_OF_TRANSDUCERS]
    assert list(felt.effects) == [*effects, "white_noise"]
    for one in effects:
        assert felt.effects[one] == shipped.effects[one]


@pytest.mark.parametrize("rate_hz", [150.0, 50.0])
def test_an_empty_two_pad_hand_reads_the_noise_of_the_transducers_and_no_third_axis(
    rate_hz: float, tmp_path: Path
) -> None:
    file = two_pads("wide", tmp_path, rate_hz)
    scene = Scene(file, 100)
    nothing = next(row for row in file.rows if row.action == "nothing")
    trials = [scene.trial(nothing, None, number) for number in range(12)]
    at_rest = [one.signal.values for one in scene.run(trials)]

    rms = np.array([values.std(axis=0).ravel() for values in at_rest])
    assert file.rate_hz == rate_hz
    assert (rms[:, [0, 3]] == 0.0).all()
    for channel in (1, 2, 4, 5):
        low, high = np.sqrt(rate_hz / 150.0) * np.array(NOISE_N[ORDER[channel]])
        assert rms[:, channel].min() > 0.9 * low
        assert rms[:, channel].max() < 1.1 * high
    # each channel by itself: the quietest of one is not the quietest of the other
    assert abs(np.corrcoef(rms[:, 2], rms[:, 5])[0, 1]) < 0.8


def test_noise_by_channel_needs_both_ends_for_every_channel(tmp_path: Path) -> None:
    text = write_two_pad_scene("thesis", 150.0, tmp_path).read_text("utf-8")
    ends = text.split("high_n")[0]
    for wrong in (ends, ends + "high_n = [0.1, 0.1]\n"):
        card = tmp_path / "wrong.toml"
        card.write_text(wrong, encoding="utf-8")
        with pytest.raises(CardError, match="a list of 6 numbers, one a channel"):
            read_scene_file(str(card))
