"""The peers of our friction: what holds, what creeps, what drifts; and what the MuJoCo peer says
without MuJoCo."""

from __future__ import annotations

import math
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from benchmarks.friction_peers import (
    LAWS,
    SHARES,
    VIBRATION,
    Block,
    LuGre,
    Regularised,
    SetValued,
    Task,
    cost_ns,
    creep,
    path,
    table,
)
from benchmarks.mujoco_scene import VARIANTS, Scene, mjcf

ROOT = Path(__file__).resolve().parents[2]


holding = {
    "elsewhere": "friction that is a smooth function of velocity creeps, for ever",
    "here": "set-valued friction: nothing moves at all below the limit",
}


@pytest.mark.hard_case(
    "Simulation", "a million steps of holding", **holding, unguarded=True
)
def test_regularised_friction_creeps_in_proportion_to_time() -> None:
    start, later, latest = path(
        Regularised(), Task.of(SHARES), np.array([1.0, 3.0, 7.0])
    )
    assert np.allclose((latest - start) / (later - start), 3.0, rtol=1e-9)


@pytest.mark.parametrize("v0_m_s", [1e-2, 1e-3, 1e-4])
def test_regularised_friction_creeps_at_the_speed_of_its_formula(v0_m_s: float) -> None:
    moved = creep(Regularised(v0_m_s), Task.of(SHARES), held_s=3.0)
    assert np.allclose(
        moved, [2.0 * v0_m_s * math.atanh(share) for share in SHARES], rtol=1e-6
    )


@pytest.mark.parametrize("vibration", [0.0, VIBRATION])
def test_set_valued_friction_does_not_creep_at_all(vibration: float) -> None:
    settled, later = path(
        SetValued(), Task.of(SHARES, vibration), np.array([4.0, 12.0])
    )
    assert np.abs(later - settled).max() < 1e-15
    assert (settled > 1e-3).all()  # it does stretch


def test_set_valued_friction_holds_below_its_limit_and_lets_go_above() -> None:
    moved = creep(SetValued(), Task.of([0.999, 1.001]), held_s=2.0)
    assert abs(moved[0]) < 1e-6
    assert moved[1] > 0.1


def test_set_valued_friction_slides_at_kinetic_friction() -> None:
    block = Block()
    at = np.array([3.0, 4.0, 5.0])
    first, second, third = path(SetValued(), Task.of(1.2), at)[:, 0]
    expected = (1.2 * block.limit_n - block.kinetic * block.normal_n) / block.mass_kg
    assert (third - 2 * second + first) / 1.0**2 == pytest.approx(expected, rel=1e-3)


def test_lugre_drifts_under_vibration_and_not_without() -> None:
    task = Task.of(0.5, [0.0, VIBRATION / 2, VIBRATION])
    start, later, latest = path(LuGre(), task, np.array([1.0, 3.0, 5.0]))
    still, small, large = later - start
    assert abs(still) < 1e-12
    assert 1e-5 < small < large
    assert np.allclose((latest - later)[1:], (small, large), rtol=1e-3)  # for ever


@pytest.mark.hard_case(
    "Simulation", "a million steps of holding", **holding, unguarded=True
)
def test_lugre_gets_away_below_its_static_limit_where_set_valued_friction_holds() -> (
    None
):
    task = Task.of(0.9, VIBRATION)
    assert creep(LuGre(), task, 6.0) > 0.1
    assert abs(creep(SetValued(), task, 6.0)) < 1e-8


def test_the_table_has_every_law_share_and_vibration_with_its_price() -> None:
    rows = table(held_s=1.2)
    assert len(rows) == len(LAWS) * len(SHARES) * 2
    assert {row.law for row in rows} == set(LAWS)
    assert all(row.cost_ns > 0 for row in rows)
    assert cost_ns(SetValued(), lanes=10, steps=5, repeats=1) > 0


def test_the_scene_in_mujoco_has_the_given_grip_and_object() -> None:
    scene = Scene()
    for variant in VARIANTS.values():
        tree = ET.fromstring(mjcf(scene, 1e-3, variant))
        drawn = [
            float(joint.get("springref", 0))
            for joint in tree.iter("joint")
            if joint.get("springref")
        ]
        pressed = scene.normal_n_per_m * np.array(drawn)
        assert (pressed[:2].sum(), pressed[2:].sum()) == pytest.approx(
            (scene.grip_n, scene.grip_n)
        )
        option = tree.find("option")
        assert option is not None
        assert option.get("cone") == "elliptic"
        assert set(variant.options.items()) <= set(option.attrib.items())


def test_without_mujoco_the_peer_says_in_one_line_how_to_get_it(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['mujoco'] = None\n"
        "from benchmarks.mujoco_peer import add_arguments, run\n"
        "from holdfast.cli.command import run_script\n"
        f"words = ['--out', {str(tmp_path / 'm.json')!r}]\n"
        "sys.exit(run_script('peer', '', add_arguments, run, words))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "make peers" in done.stderr
    assert not list(tmp_path.iterdir())
