"""Frames of scenes: exact pictures of known tags at known places, drawn only where a card has a
camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from camera_frames import (
    BLACK,
    CAMERA,
    CODES,
    GREY,
    HAND_TAG,
    OBJECT_TAG,
    WHITE,
    Camera,
    cells,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file

PICTURES = {
    0: ["..#.#.", "#...#.", "#..###", ".#.###", "#.#..#", "###.##"],
    1: ["..#..#", "#.#...", "....##", "#..###", ".#..#.", "##.##."],
}
"""Data cells, # black. Frames with them were answered with ids 0 and 1 by a detector not of
ours."""


def camera(**changed: float) -> Camera:
    numbers = {name: p.default for name, p in CAMERA.items()} | {
        "width_px": 160.0,
        "height_px": 90.0,
        "tag_mm": 6.0,
    }
    return Camera(**(numbers | changed))


def scene(tmp_path: Path, text: str) -> Scene:
    path = tmp_path / "filmed.toml"
    path.write_text(text, encoding="utf-8")
    return Scene(read_scene_file(str(path)), 3)


def test_a_tag_is_six_by_six_cells_in_a_black_border_and_a_white_margin():
    for tag in range(len(CODES)):
        whole = cells(tag)
        assert whole.shape == (10, 10)
        assert whole.sum() - whole[1:9, 1:9].sum() == 36
        assert whole[1:9, 1:9].sum() == whole[2:8, 2:8].sum()
        assert [
            "".join("#."[int(cell)] for cell in row) for row in whole[2:8, 2:8]
        ] == PICTURES[tag]


def test_a_drawn_tag_shows_its_cells_where_it_lies():
    one = camera(px_per_mm=8.0, blur_px=0.05, width_px=320.0, height_px=120.0)
    image = one.draw(np.zeros(2), np.zeros(2))
    for tag in (OBJECT_TAG, HAND_TAG):
        column_px, row_px = one.centre_px(tag, np.zeros(2))
        at = np.floor(6.0 * (np.arange(10) - 4.5)).astype(int)
        seen = image[int(row_px) + at[:, None], int(column_px) + at]
        np.testing.assert_allclose(
            seen, BLACK + (WHITE - BLACK) * cells(tag), atol=1e-9
        )


@settings(max_examples=40)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.3, 1.5))
def test_a_tag_moves_exactly_as_far_as_it_is_moved(x_mm, z_mm, blur_px):
    one = camera(blur_px=blur_px, height_px=160.0)

    def moments(moved_mm):
        light = one.draw(np.array(moved_mm), np.full(2, 1e6)) - GREY
        rows, columns = np.indices(light.shape) + 0.5
        return (
            light.sum(),
            (light * columns).sum() / light.sum(),
            (light * rows).sum() / light.sum(),
        )

    total, column_px, row_px = moments((0.0, 0.0))
    light, column_there_px, row_there_px = moments((x_mm, z_mm))
    assert light == pytest.approx(total, rel=1e-9)
    assert column_there_px - column_px == pytest.approx(one.px_per_mm * x_mm, abs=1e-5)
    assert row_there_px - row_px == pytest.approx(-one.px_per_mm * z_mm, abs=1e-5)
