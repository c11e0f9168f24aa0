"""The recorder: what is written survives whatever happens, nothing is invented, and training reads
it as it is."""

from __future__ import annotations

import os
import re
import time

import numpy as np
import pytest
from recorder_bench import (
    PROTOCOL,
    REST,
    TRIAL,
    Hand,
    columns_of,
    meta_of,
    one_pull,
    recorded,
    said,
    session,
)

from holdfast.core.errors import ChannelError, EmptyRecording, TimeError
from holdfast.core.hand_card import HANDS
from holdfast.core.trial_file import read_trial
from holdfast.data.datasets import load
from holdfast.drivers.replay import open_replay
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.live.sources import open_source

# -- what is written


def test_what_the_source_gave_is_on_the_disk_to_the_last_digit_and_in_order(
    people, card
):
    folder = people / TRIAL
    source, again = open_source(f"sim://{card}?trial=0"), open_replay(folder)
    assert again.values.tobytes() == source.values.tobytes()
    assert again.rate_hz == pytest.approx(50.0, rel=1e-6)
    columns = columns_of(folder)
    head = [
        "Time",
        *(f"{axis}{k}" for k in range(1, 7) for axis in "XYZ"),
        "host_ns",
        "sequence",
    ]
    assert list(columns) == [*head, *(f"valid{k}" for k in range(1, 7))]
    assert columns["sequence"] == [str(k) for k in range(len(source.values))]
    host_s = 1e-9 * np.array(columns["host_ns"], dtype=np.int64)
    np.testing.assert_allclose(
        host_s - host_s[0], np.array(columns["Time"], dtype=np.float64), atol=1e-9
    )


def test_meta_tells_who_what_how_and_how_good(tmp_path):
    one_pull(tmp_path / "out")
    meta = meta_of(tmp_path / "out/p01/soft-ball/pull/trial_1")
    task = (meta["state"], meta["person"], meta["object"], meta["action"])
    assert task == ("kept", "p01", "soft-ball", "pull")
    assert [one["finger"] for one in meta["hand"]["sensors"]] == [1, 2, 3, 4, 5, 6]
    assert meta["hand"]["averages"] == 32
    assert len(meta["bias"]["values"]) == len(meta["bias"]["spread"]) == 18
    assert meta["bias"]["good"] is True
    assert set(meta["versions"]) >= {"holdfast", "numpy", "python"}
    assert meta["configuration"]["source"] == REST
    assert meta["quality"]["samples"] == 150
    assert (meta["quality"]["lost"], meta["quality"]["invalid_readings"]) == (0, 0)
    assert meta["quality"]["rate_hz"] == pytest.approx(150.0, rel=1e-3)
    assert meta["quality"]["bias_drift"] < 0.2


def test_the_hand_card_lies_beside_the_recordings_and_that_of_another_hand_is_refused(
    tmp_path,
):
    out = tmp_path / "out"
    one_pull(out, "--hand", "six-fingertips")
    hand = load(out, windows="none").hand
    assert hand is not None
    assert hand.name == "six-fingertips"
    with pytest.raises(ChannelError, match="two-pad-gripper is the card of another"):
        one_pull(tmp_path / "other", "--hand", "two-pad-gripper")
    changed = tmp_path / "changed.toml"
    changed.write_text(hand.text + "# moved\n", "utf-8")
    with pytest.raises(ChannelError, match="recordings with another card"):
        one_pull(out, "--hand", changed)
    assert (out / "hand.toml").read_text("utf-8") == hand.text


def test_nothing_is_written_for_an_axis_that_the_hand_does_not_measure(tmp_path):
    usual = (HANDS / "six-fingertips.toml").read_text("utf-8")
    yz = tmp_path / "yz.toml"
    yz.write_text(usual.replace("[[sensors]]", '[[sensors]]\nmeasures = "yz"'), "utf-8")
    one_pull(tmp_path / "out", "--hand", yz)
    columns = columns_of(tmp_path / "out/p01/soft-ball/pull/trial_1")
    assert set(columns["X1"]) == {"nan"}
    assert "nan" not in columns["Y1"]
    assert meta_of(tmp_path / "out/p01/soft-ball/pull/trial_1")["state"] == "kept"
    (trial,) = load(tmp_path / "out", windows="none").recordings
    assert not trial.samples[:, 0::3].any()
    assert trial.valid.all()


def test_nothing_that_is_written_names_a_place_of_the_machine(people, card, tmp_path):
    (tmp_path / "of-anna.toml").write_text(PROTOCOL)
    words = ("--protocol", tmp_path / "of-anna.toml", "--trials", "1", "--seconds", "1")
    recorded(tmp_path / "out", *words)
    texts = [
        path.read_text("utf-8")
        for root in (people, tmp_path)
        for path in root.rglob("meta.json")
    ]
    assert len(texts) > 8
    for text in texts:
        assert str(card.parent) not in text
        assert str(tmp_path) not in text
        assert os.uname().nodename not in re.findall(r'"(?:\\.|[^"])*"', text)


def test_host_stamps_are_of_the_clock_a_camera_has(tmp_path):
    before_ns = time.monotonic_ns()
    one_pull(tmp_path / "out")
    host_ns = int(columns_of(tmp_path / "out/p01/soft-ball/pull/trial_1")["host_ns"][0])
    assert before_ns < host_ns < time.monotonic_ns() + 1_000_000_000


def test_samples_that_never_came_are_gaps_in_the_count_and_invalid_rows_to_who_reads(
    tmp_path,
):
    kept, messages = session(tmp_path, Hand(100, stalls={20: 0.2}))
    folder = tmp_path / TRIAL
    sequence = np.array(columns_of(folder)["sequence"], dtype=np.int64)
    assert (kept, meta_of(folder)["quality"]["lost"]) == (1, 19)
    assert np.diff(sequence)[20] == 20
    trial = read_trial(folder / "tactile.csv")
    assert np.flatnonzero(~trial.valid.all(axis=1)).tolist() == list(range(21, 40))
    assert np.isnan(trial.raw[21:40]).all()
    assert said(messages, "19 lost")


def test_a_reading_that_comes_twice_is_lost_and_no_row_is_made_up(tmp_path):
    session(tmp_path, Hand(99, shifts={30: -0.01, 31: 0.01}))
    folder = tmp_path / TRIAL
    assert "30" not in columns_of(folder)["sequence"]
    assert meta_of(folder)["quality"]["lost"] == 1


def test_a_finger_that_is_lost_is_written_as_lost_and_the_rest_goes_on(tmp_path):
    messages = one_pull(tmp_path / "out", source=f"{REST}?fault=nack:3@1.6%2B0.3")
    folder = tmp_path / "out/p01/soft-ball/pull/trial_1"
    columns = columns_of(folder)
    lost = np.array(columns["valid3"]) == "0"
    assert 20 < lost.sum() < 80
    assert np.array(columns["X3"])[lost].tolist().count("nan") > 20
    assert "0" not in columns["valid2"]
    assert sum(meta_of(folder)["quality"]["why"].values()) == lost.sum()
    assert said(messages, "invalid")


# -- clocks that jump


@pytest.mark.hard_case(
    "Time and schedule",
    "a clock that is set while a trial is recorded",
    elsewhere="stamps run backwards or jump in the file, and it is unknown which rows are "
    "neighbours",
    here="the trial ends with a typed error, what came before is kept as interrupted",
)
@pytest.mark.parametrize("by_s", [-5.0, 5.0])
def test_a_clock_that_jumps_ends_the_trial_and_keeps_what_came_before(tmp_path, by_s):
    clock = VirtualClock(10_000_000_000)
    with pytest.raises(TimeError, match=r"jumped by [+-]"):
        session(tmp_path, Hand(100, clock=clock, shifts={50: by_s}))
    folder = tmp_path / TRIAL
    assert meta_of(folder)["state"] == "interrupted"
    assert len(read_trial(folder / "tactile.csv").t_s) == 50
    assert not (folder / "tactile.truth.json").exists()


def test_a_trial_that_lost_most_of_its_samples_is_not_kept(tmp_path):
    source = Hand(30, stalls=dict.fromkeys(range(30), 0.095))
    with pytest.raises(EmptyRecording, match="cannot be kept"):
        session(tmp_path, source)
    assert meta_of(tmp_path / TRIAL)["state"] == "interrupted"
