"""From frames to the label: the onset of a pull, none in a hold, and tags printed in another
size."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from drawn_frames import (
    command,
    two_sizes,
)

from holdfast.cli.main import main
from holdfast.drivers.camera.recording import read_about, read_tracks
from holdfast.simulation.camera_frames import AWAY_SIDES
from holdfast.training.timeline import read_truth

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
[effects.camera_frames]
[camera]
width_px = 240
height_px = 160
noise_levels = 0
"""


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pull and a loaded hold, simulated with their frames."""
    folder = tmp_path_factory.mktemp("filmed")
    (folder / "card.toml").write_text(CARD, encoding="utf-8")
    assert (
        main(
            [
                "simulate",
                str(folder / "card.toml"),
                "--out",
                str(folder / "set"),
                "--seed",
                "1",
            ]
        )
        == 0
    )
    return folder / "set"


def test_onset_writes_a_label_of_the_camera_s_beside_the_trial_and_leaves_its_truth_alone(
    filmed,
):
    trial = filmed / "soft-ball/pull/trial_1.csv"
    truth = trial.with_suffix(".truth.json").read_bytes()
    done = command("onset", trial)
    assert done.returncode == 0, done.stderr
    assert trial.with_suffix(".truth.json").read_bytes() == truth
    (phase,) = json.loads(trial.with_suffix(".onset.json").read_text("utf-8"))["phases"]
    assert (phase["label"], phase["provenance"], phase["by"]) == (
        "risky_slip",
        "camera",
        "holdfast onset",
    )
    assert phase["t0_s"] == phase["onset_s"] < phase["gross_s"] < phase["t1_s"]
    assert phase["onset_s"] == pytest.approx(
        json.loads(truth)["incipient_slip_s"], abs=0.025
    )
    t_s = np.loadtxt(trial, delimiter=",", skiprows=1, usecols=0)
    (read,) = read_truth(trial.with_suffix(".onset.json"), t_s)
    assert t_s[read.first - 1] < phase["t0_s"] <= t_s[read.first]


def test_a_loaded_hold_has_no_onset_and_sets_the_gross_distance_above_its_shear(filmed):
    held = filmed / "basket-ball/hold/trial_1.csv"
    pull = filmed / "soft-ball/pull/trial_1.csv"
    opens_s = json.loads(held.with_suffix(".truth.json").read_text("utf-8"))["phases"][
        -2
    ]["t0_s"]
    done = command("onset", held, "--until", opens_s)
    assert done.returncode == 0, done.stderr
    assert "no onset: the object moved by less than 2.00 mm" in done.stdout
    content = json.loads(held.with_suffix(".onset.json").read_text("utf-8"))
    assert (content["phases"], content["pad_shear"]) == ([], "not measured")
    assert command("onset", pull, "--no-slip", held).returncode == 0
    assert (
        json.loads(pull.with_suffix(".onset.json").read_text("utf-8"))["pad_shear"]
        == "measured"
    )


@pytest.mark.parametrize("there", ["", "trial_1.csv"])
def test_onset_names_the_path_that_was_given_where_there_are_no_frames(
    tmp_path, there, capsys
):
    given = tmp_path / (there or "trial_9")
    if there:
        given.write_text("Time,X1,Y1,Z1\n")
    assert main(["onset", str(given)]) == 3
    err = capsys.readouterr().err
    assert err.startswith(f"error: DataNotFound: {given}: no ")
    assert ("trial_1.frames.npz is missing" in err) == bool(there)
    assert f"{tmp_path}/trial_9.frames" not in err


def test_a_tag_printed_in_another_size_is_refused_by_its_size(tmp_path):
    path = two_sizes(tmp_path / "trial_1.frames.npz")
    done = command("onset", path, "--action", "pull")
    assert done.returncode == 3
    assert "TagError" in done.stderr
    assert "if the hand's tag is 10 mm, the object's is 12.5" in done.stderr
    assert not (tmp_path / "trial_1.onset.json").exists()


def test_tags_of_two_sizes_are_reported_as_soon_as_they_were_watched_and_what_was_watched_is_kept(
    tmp_path,
):
    done = command(
        "watch",
        "--camera",
        two_sizes(tmp_path / "some.frames.npz"),
        "--out",
        tmp_path / "out",
    )
    assert done.returncode == 3
    assert [
        line
        for line in done.stderr.splitlines()
        if "TagError" in line and "12.5" in line
    ]
    assert read_about(tmp_path / "out")["void"] is None
    assert len(read_tracks(tmp_path / "out").t_s) == 30
    assert (tmp_path / "out/camera.mkv").stat().st_size > 0


def test_a_measured_distance_finds_tags_that_a_printer_scaled_alike_and_stays_with_the_recording(
    drawn, tmp_path
):
    apart_mm = 2.0 * AWAY_SIDES * 10.0
    for name, factor, code in (("right", 1.0, 0), ("wrong", 0.92, 3)):
        out = tmp_path / name
        done = command(
            "watch",
            "--camera",
            drawn[0],
            "--out",
            out,
            "--apart-mm",
            f"{factor * apart_mm:g}",
        )
        assert done.returncode == code, done.stderr
        assert read_about(out)["apart_mm"] == pytest.approx(factor * apart_mm)
        again = command("onset", out, "--action", "pull")
        assert ("TagError" in done.stderr, "TagError" in again.stderr) == (
            code == 3,
            code == 3,
        )
    assert "printed at 92 % of that size" in done.stderr


@pytest.mark.parametrize("side", ["0.00996", "0.996", "996", "0", "nan", "one"])
def test_a_printed_side_that_is_no_millimetre_is_a_usage_error(tmp_path, capsys, side):
    for words in (
        ("watch", "--camera", "oak"),
        ("record", "--source", "x", "--person", "p01"),
        ("onset",),
    ):
        out = (
            ("--out", str(tmp_path / "new"))
            if words != ("onset",)
            else (str(tmp_path),)
        )
        assert main([*words, *out, "--tag-mm", side]) == 2
        err = capsys.readouterr().err
        assert "--tag-mm" in err
        assert err.count("\n") == 1
    assert not (tmp_path / "new").exists()
