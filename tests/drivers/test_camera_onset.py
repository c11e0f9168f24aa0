"""From frames to the label: the onset of a pull, none in a hold, and tags printed in another
size."""

from __future__ import annotations

from pathlib import Path

import pytest
from drawn_frames import camera, command, write_frames
from recorder_bench import events_of

from holdfast.cli.main import main
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.simulation.scenes.truth import Truth

CARD = """
[record]
rate_hz = 150
[physics]
step_s = 0.002
[[trials]]
objects = ["soft-ball"]
action = "pull"
style = "author"
hold_s = 1.5
close_at_s = 0.3
tail_s = 0.2
[[trials]]
objects = ["basket-ball"]
action = "hold"
style = "author"
hold_s = 1.0
close_at_s = 0.3
tail_s = 0.2
load_n = 1.0
[effects.brush]
count = 5
"""


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Truth]]:
    """A pull and a loaded hold, simulated, drawn and watched: folder and truth by action."""
    folder = tmp_path_factory.mktemp("filmed")
    (folder / "card.toml").write_text(CARD, encoding="utf-8")
    scene = Scene(read_scene_file(str(folder / "card.toml")), 1)
    of_action = {}
    for one in scene.run_together(scene.trials()):
        motion = one.motion
        stamps_s, frames = camera(width_px=240, height_px=160, fps=60).film(
            motion.t_s, motion.position_m, one.hand_m
        )
        action = one.trial.action
        drawn = write_frames(
            folder / f"{action}.frames.npz", stamps_s, frames, fps=60.0
        )
        out = folder / action / "trial_1"
        out.parent.mkdir()
        done = command("watch", "--camera", drawn, "--out", out)
        assert done.returncode == 0, done.stderr
        of_action[action] = out, one.truth
    return of_action


def test_onset_writes_the_label_that_the_camera_saw(filmed):
    folder, truth = filmed["pull"]
    done = command("watch", "--onset", folder)
    assert done.returncode == 0, done.stderr
    (phase,) = events_of(folder)
    assert (phase["label"], phase["provenance"]) == ("risky_slip", "camera")
    assert phase["t0_s"] == phase["onset_s"] < phase["gross_s"] < phase["t1_s"]
    assert phase["onset_s"] == pytest.approx(truth.incipient_slip_s, abs=0.025)


def test_a_loaded_hold_has_no_onset_before_the_hand_opens(filmed):
    held, truth = filmed["hold"]
    done = command("watch", "--onset", held, "--until", truth.marks[-2][0])
    assert done.returncode == 0, done.stderr
    assert "no onset: the object moved by less than 2.00 mm" in done.stdout
    assert events_of(held) == []


@pytest.mark.parametrize("side", ["0.00996", "0.996", "996", "0", "nan", "one"])
def test_a_printed_side_that_is_no_millimetre_is_a_usage_error(tmp_path, capsys, side):
    for words in (
        ("watch", "--camera", "oak"),
        ("record", "--source", "x", "--person", "p01"),
        ("watch", "--onset", "x"),
    ):
        out = ("--out", str(tmp_path / "new"))
        assert main([*words, *out, "--tag-mm", side]) == 2
        err = capsys.readouterr().err
        assert "--tag-mm" in err
        assert err.count("\n") == 1
    assert not (tmp_path / "new").exists()
