"""Scenes: what a simulated trial leaves behind, and that nothing runs that the card does not
name."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from long_steps import texture_in_any_step  # noqa: F401  a fixture

from holdfast.cli.main import main
from holdfast.core.contract import SITUATIONS
from holdfast.core.errors import OutputError
from holdfast.core.trial_file import read_trial
from holdfast.data.datasets import load
from holdfast.data.timeline import read_truth
from holdfast.simulation.effects.effect import EFFECT_MODULES, module_effects
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.scene import Scene, SimulatedTrial
from holdfast.simulation.scenes.scene_file import read_scene_file

CORE = """
[record]
rate_hz = 100
[physics]
step_s = 0.003
[[trials]]
objects = ["soft-ball", "full-bottle"]
action = "pass"
close_at_s = 0.6
hold_s = 1.0
tail_s = 0.4
[[trials]]
objects = ["soft-ball"]
action = "pull"
close_at_s = 0.6
hold_s = 1.0
tail_s = 0.4
[[trials]]
objects = ["full-bottle"]
action = "fall"
close_at_s = 0.6
hold_s = 1.0
tail_s = 0.4
[[trials]]
objects = ["basket-ball"]
action = "put-down"
close_at_s = 0.6
hold_s = 1.0
tail_s = 0.4
[[trials]]
objects = ["hard-ball"]
action = "hold"
close_at_s = 0.6
hold_s = 1.0
tail_s = 0.4
load_n = 1.0
times = 1
[[trials]]
action = "nothing"
lasts_s = 3
"""
COARSE = CORE.replace("0.003", "0.01")
"""The same trials in steps of a sample: for what does not depend on the moment of a slip."""
MAGNET = "\n[effects.dipole]\n"


def make(tmp_path: Path, text: str = CORE, seed: int = 0) -> Scene:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return Scene(read_scene_file(str(path)), seed)


def trials_of(scene: Scene) -> list[SimulatedTrial]:
    return scene.run_together(scene.trials())


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> list[SimulatedTrial]:
    return trials_of(make(tmp_path_factory.mktemp("core")))


def test_every_action_ends_as_its_truth_says(core):
    shapes = {
        one.trial.action: [SITUATIONS[s] for _, s in one.truth.marks] for one in core
    }
    assert shapes.pop("pass")[:3] == ["nothing", "grasp", "safe_slip"]
    assert shapes == {
        "pull": ["nothing", "grasp", "risky_slip", "nothing"],
        "fall": ["nothing", "grasp", "risky_slip", "nothing"],
        "put-down": ["nothing", "grasp", "safe_slip", "grasp", "safe_slip", "nothing"],
        "hold": ["nothing", "grasp", "safe_slip", "nothing"],
        "nothing": ["nothing"],
    }


def test_events_come_in_their_order(core):
    for one in core:
        if one.trial.action in ("pull", "fall"):
            truth = one.truth
            times = [
                truth.contact_s,
                truth.load_onset_s,
                truth.incipient_slip_s,
                truth.gross_slip_s,
                truth.contact_lost_s,
            ]
            assert None not in times
            assert times == sorted(times)


def test_an_empty_list_of_effects_is_the_core_bit_for_bit_and_calls_nothing(
    tmp_path, core, monkeypatch
):
    called: list[str] = []

    def counting(name: str):
        def effect(*_: object) -> object:
            called.append(name)
            raise AssertionError(name)

        return effect

    for name in EFFECT_MODULES:
        effects = module_effects(name)
        uncallable = replace(effects[name], make=counting(name))
        monkeypatch.setitem(effects, name, uncallable)
    again = trials_of(make(tmp_path, CORE + "\n[effects]\n"))
    assert called == []
    for one, other in zip(core, again, strict=True):
        assert one.signal.values.tobytes() == other.signal.values.tobytes()
        assert one.effects == other.effects == {}


DRAWN = MAGNET + "[effects.gain_tilt]\n[effects.timing_jitter]\n"


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> list[SimulatedTrial]:
    return trials_of(make(tmp_path_factory.mktemp("plain"), COARSE + DRAWN))


@pytest.mark.parametrize(
    "added", ["hall_noise", "quantisation", "cross_talk", "thermal_drift"]
)
def test_adding_an_effect_leaves_the_draws_of_the_others_alone(tmp_path, plain, added):
    more = trials_of(make(tmp_path, COARSE + DRAWN + f"[effects.{added}]\n"))
    for one, other in zip(plain, more, strict=True):
        assert one.signal.t_s.tobytes() == other.signal.t_s.tobytes()
        assert {name: other.effects[name] for name in one.effects} == one.effects
        assert one.motion.forces_n.tobytes() == other.motion.forces_n.tobytes()


@pytest.mark.usefixtures("texture_in_any_step")
def test_a_trial_is_the_same_in_any_company(tmp_path):
    names = [
        "brush",
        "texture",
        "lag",
        "rotation",
        "arm",
        "tremor",
        "hall_noise",
    ]
    every = "".join(f"[effects.{name}]\n" for name in names)
    scene = make(tmp_path, COARSE + MAGNET + every)
    trials = scene.trials()
    together = scene.run_together(trials)
    alone = scene.run_together([trials[0]])[0]
    pair = scene.run_together([trials[3], trials[1]])[0]
    for index, other in ((0, alone), (3, pair)):
        assert other.signal.values.tobytes() == together[index].signal.values.tobytes()
        assert other.truth == together[index].truth


def test_skipping_quiet_phases_changes_no_slip_time(tmp_path, core, monkeypatch):
    from holdfast.simulation.scenes import script_times

    monkeypatch.setattr(script_times, "busy", lambda trial: [(0.0, 1e9)])
    everywhere = trials_of(make(tmp_path))
    for one, other in zip(core, everywhere, strict=True):
        for event in ("load_onset_s", "gross_slip_s", "contact_lost_s"):
            here = getattr(one.truth, event)
            there = getattr(other.truth, event)
            assert (here is None) == (there is None)
            if here is not None:
                assert here == pytest.approx(there, abs=1e-3)


def test_a_folder_of_trials_is_read_and_trained_on_as_it_is(tmp_path):
    text = CORE.replace('"hold"', '"put-down"').replace("load_n = 1.0\ntimes = 1\n", "")
    write_set(make(tmp_path, text.replace("0.003", "0.005")), tmp_path / "set")
    data = load(tmp_path / "set", windows="natural")
    assert data.kind == "simulated"
    assert {recording.action for recording in data.recordings} == {
        "pass",
        "pull",
        "fall",
        "put-down",
        None,
    }
    trial = tmp_path / "set/soft-ball/pull/trial_1.csv"
    sidecar = json.loads(trial.with_suffix(".truth.json").read_text("utf-8"))
    events = {"load_onset_s", "incipient_slip_s", "gross_slip_s", "contact_lost_s"}
    assert {"card", "seed", "slip_mm", *events} <= set(sidecar)
    t_s = read_trial(trial).t_s
    truth = trial.with_suffix(".truth.json")
    phases = read_truth(truth).phases_on(t_s, truth)
    assert SITUATIONS[phases[2].situation] == "risky_slip"
    motion = (trial.parent / "trial_1.motion.csv").read_text("utf-8")
    assert motion.startswith("Time,object_x_mm")


def test_one_hand_makes_all_the_grasps_of_a_joined_recording(tmp_path):
    """Each trial alone has sensors of its own; joined, the first one's, so that the empty hand
    always rests alike."""
    text = (
        COARSE.replace("rate_hz = 100", "rate_hz = 100\njoin = 3")
        + "\n[effects.dipole]\n[effects.gain_tilt]\n"
    )
    scene = make(
        tmp_path, text.replace('action = "pull"', 'action = "pull"\ncount = 3')
    )
    trials = scene.run_together(scene.trials())
    joined, starts_s, _ = scene.join(trials)
    rest = [joined.values[np.searchsorted(joined.t_s, start)] for start in starts_s]
    np.testing.assert_allclose(rest[1:], rest[:-1], atol=1e-9)
    assert np.abs(trials[1].signal.values[0] - trials[0].signal.values[0]).max() > 0.01
    np.testing.assert_array_equal(
        scene.join(trials[:1])[0].values, trials[0].signal.values
    )


def test_nothing_is_written_over(tmp_path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "mine.txt").write_text("precious", encoding="utf-8")
    with pytest.raises(OutputError, match="exists already"):
        write_set(make(tmp_path), tmp_path / "set")
    assert [path.name for path in (tmp_path / "set").iterdir()] == ["mine.txt"]


@pytest.mark.parametrize(
    "wrong", [["--trials", "0"], ["--rate", "5"], ["--seed", "-1"], ["--trials", "x"]]
)
def test_simulate_refuses_what_cannot_be_in_one_line(tmp_path, capsys, wrong):
    assert main(["simulate", "apple", "--out", str(tmp_path / "new"), *wrong]) in (2, 3)
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_truth_comes_from_the_core_and_not_from_a_noisy_channel(tmp_path, core):
    noisy = trials_of(
        make(
            tmp_path,
            CORE
            + MAGNET
            + "[effects.hall_noise]\n[effects.gain_tilt]\ngain_sd = 0.4\n",
        )
    )
    assert [one.truth for one in noisy] == [one.truth for one in core]
