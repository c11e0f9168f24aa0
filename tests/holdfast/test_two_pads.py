"""A gripper of two pads, moved by the learner of six fingertips: exported, not trained again."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import Run
from live_bench import TINY, run_on

from holdfast.cli.main import main
from holdfast.core.errors import UsageError
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.model import Model
from holdfast.live.grip import controller_for, open_grip
from holdfast.live.hand_files import shear_gain_of
from holdfast.live.sources import open_live

LAYOUT = "layout=0:35,0:22"
# Twice what friction holds, for a fifth of a second; a drive of 50 ms can be in time.
TUG = """
[record]
rate_hz = 150
[physics]
step_s = 0.003
[hand]
card = "two-pad-gripper"
[[trials]]
objects = ["hard-ball"]
action = "tug"
mass_g = 200
weak_share = 0
grip_n = 4
friction = 0.6
finger_n_per_m = 1000
close_at_s = 0.8
hold_s = 1.5
peak_n = 10
lasts_s = 0.2
after_s = 0.8
[effects.brush]
count = 5
[effects.dipole]
"""


@pytest.fixture(scope="module")
def two_pads(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny model's learner, in a file for the gripper."""
    out = tmp_path_factory.mktemp("gripper") / "two-pads.onnx"
    words = ["export", str(TINY), "--hand", "two-pad-gripper", "--out", str(out)]
    assert main(words) == 0
    return out


@pytest.fixture(scope="module")
def tug(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene. One path for all: a process keeps the trial that it simulated last."""
    path = tmp_path_factory.mktemp("scene") / "tug.toml"
    path.write_text(TUG, encoding="utf-8")
    return path


def scene_url(scene: Path, seed: int, layout: str = LAYOUT) -> str:
    return f"virtual://ft232h?{layout}&scene={scene}&seed={seed}"


@pytest.mark.parametrize(("controller", "kept"), [("holdfast", True), ("none", False)])
def test_a_tug_at_a_gripper_of_two_pads_is_held_by_the_commands(
    two_pads: Path, tug: Path, controller: str, kept: bool
) -> None:
    url = scene_url(tug, 102)
    model = Model(two_pads)
    clock = VirtualClock()
    gain = shear_gain_of(url, None) or 1.0
    control = controller_for(controller, model.card, print, shear_gain=gain)
    grip = open_grip("virtual?lag_ms=50", control, 150.0, url, clock, print)
    run_on(grip, model, url, 3.2, clock)
    assert grip.scene is not None
    outcome = grip.scene.outcome()
    assert outcome.kept == kept
    # Quiet before the tug: the grip is the wearer's own until it begins.
    assert (outcome.strongest_n > 1.5 * outcome.wearers_n) == kept


def test_a_run_names_the_gripper_commands_it_and_ends_with_its_scene(
    run: Run, two_pads: Path, tmp_path: Path
) -> None:
    short = TUG.replace("0.8", "0.3").replace("hold_s = 1.5", "hold_s = 0.8")
    (tmp_path / "tug.toml").write_text(short, "utf-8")
    url = scene_url(tmp_path / "tug.toml", 102)
    words = ("--source", url, "--grip", "virtual", "--to", "none")
    code, _, err = run("run", two_pads, *words)
    assert code == 0, err
    assert "hand: two-pad-gripper, 2 sensors" in err
    assert "the scene has ended; samples: " in err
    assert "scene: " in err


WRONG = {
    "layout=mux": "the layout has 6 sensors, the scene's hand 2 sensors",
    "layout=0:35,71/0:35": "no such layout",
    f"{LAYOUT}&fault=nack:3@1": "the layout has 2 sensors",
}


@pytest.mark.parametrize("layout", WRONG)
def test_a_virtual_gripper_has_the_sensors_of_its_scene(tug: Path, layout: str) -> None:
    url = scene_url(tug, 102, layout)
    with pytest.raises(UsageError, match=WRONG[layout]):
        open_live(url, clock=VirtualClock(), report=print)
