"""`holdfast run --grip`: a command at every sample, and `hold` as the last one, however it ends."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import msgspec
import numpy as np
import pytest
from grip_bench import UnixReceiver
from hazard_marks import DEAD_LOG, LOST_SENSOR, NO_GRIP_COMMAND, RUN_DIES
from live_bench import ROOT, RUN, closing_output, run_on
from packages import loaded_by

from holdfast.core.contract import GripCommand
from holdfast.core.errors import CardError, ChannelError, UsageError
from holdfast.drivers.calibration import Calibration, write_calibration
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime import grip_control
from holdfast.edge_runtime.grip import AnswerRules
from holdfast.edge_runtime.model import Model
from holdfast.live.grip import (
    WHO_LETS_GO,
    GripOutput,
    checked_rules,
    controller_for,
    open_grip,
)
from holdfast.live.hand_files import shear_gain_of
from holdfast.live.outputs import emit_to
from holdfast.live.run import answer
from holdfast.live.scene import ROWS_HZ, STEP_S, drive_of, live_scene, planned_trial
from holdfast.live.sources import open_live, source_url
from holdfast.simulation.effects.magnet import shear_gain as magnet_gain

PERIOD_NS = 1e9 / 150
REST = "virtual://ft232h"


@pytest.fixture
def receiver() -> Iterator[UnixReceiver]:
    one = UnixReceiver()
    yield one
    one.close()


@contextmanager
def to_link(url: str, model: Model) -> Iterator[GripOutput]:
    """The controller on a link, closed as a run closes it."""
    control = controller_for("holdfast", model.card, print)
    rate_hz = model.card.rate_hz
    grip = open_grip(url, control, rate_hz, "", VirtualClock(), print)
    with closing_output(grip):
        yield grip


@contextmanager
def running(
    receiver: UnixReceiver, *more: str, **streams: Any
) -> Iterator[subprocess.Popen[str]]:
    """A real run that has sent a command."""
    command = [*RUN, "--grip", receiver.url, *more]
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE} | streams
    with subprocess.Popen(
        command, cwd=ROOT, text=True, env=dict(os.environ), **streams
    ) as run:
        try:
            receiver.next()
            yield run
        finally:
            run.kill()


@RUN_DIES.mark
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_a_run_that_is_stopped_ends_with_hold(receiver, how):
    with running(receiver) as run:
        run.send_signal(how)
        last = receiver.until("stopped")
        _, err = run.communicate(timeout=300)
        assert run.returncode == (130 if how == signal.SIGINT else 0), err
    assert (last["mode"], last["target_n"], last["reason"]) == ("hold", None, "stopped")


def small_disk() -> None:
    """No file of this process grows beyond 20 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


@DEAD_LOG.mark
def test_a_full_disk_and_a_stalled_reader_stop_no_command_and_the_last_one_holds(
    receiver, tmp_path
):
    log = ["--to", str(tmp_path / "log.jsonl"), "--to", "-"]
    unread = subprocess.PIPE
    with running(receiver, *log, stdout=unread, preexec_fn=small_disk) as run:
        sequences = [receiver.next()["sequence"] for _ in range(400)]
        run.send_signal(signal.SIGTERM)
        assert receiver.until("stopped")["mode"] == "hold"
        _, err = run.communicate(timeout=300)
        assert run.returncode == 5, err
        assert "takes no more lines" in err
    assert sequences == sorted(set(sequences))


@NO_GRIP_COMMAND.mark
def test_a_run_of_which_no_command_left_ends_with_5_and_says_so(tmp_path):
    url = f"unix://{tmp_path / 'grip'}"
    command = [*RUN, "--grip", url, "--seconds", "0.5", "--to", "none"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 5
    assert run.stderr.endswith(f"lost: grip {url} (not one line left)\n")
    assert "No such file or directory" in run.stderr


def test_a_command_comes_at_every_sample_and_the_last_one_follows_it(model, receiver):
    with to_link(receiver.url, model) as grip:
        n = run_on(grip, model, REST, 1.0, each=receiver.keep)
    lines = [receiver.next() for _ in range(n + 1)]
    assert [line["sequence"] for line in lines] == list(range(n + 1))
    assert lines[-1]["reason"] == "stopped"


@LOST_SENSOR.mark
def test_an_unplugged_hand_is_answered_with_hold_until_the_end(model, receiver):
    url = f"{REST}?fault=unplug@1%2B1000"
    with to_link(receiver.url, model) as grip:
        n = run_on(grip, model, url, 3.0, each=receiver.keep)
    lines = [receiver.next() for _ in range(n + 1)]
    assert {line["mode"] for line in lines[200:]} == {"hold"}
    assert "unknown" in lines[-2]["reason"]


@RUN_DIES.mark
def test_an_error_in_the_loop_ends_with_a_hold_that_says_failed(model, receiver):
    clock, broken = VirtualClock(), Mock(write=Mock(side_effect=ZeroDivisionError))
    source = open_live(REST, clock=clock, report=print)
    with pytest.raises(ZeroDivisionError), to_link(receiver.url, model) as grip:
        answer(source, model, clock, emit_to([grip, broken]), lambda: False)
    assert receiver.waiting()[-1]["reason"] == "failed"


# -- the scene in the loop

NOTHING = """
[record]
rate_hz = 150
[[trials]]
action = "nothing"
lasts_s = 0.5
"""
FALL = """
[record]
rate_hz = 150
[physics]
step_s = 0.003
[[trials]]
objects = ["hard-ball"]
action = "fall"
style = "author"
close_at_s = 0.8
hold_s = 2.0
tail_s = 0.5
[effects.brush]
count = 5
[effects.dipole]
"""


@pytest.mark.parametrize(("controller", "kept"), [("holdfast", True), ("none", False)])
def test_what_is_seen_first_is_a_fall_that_the_commands_prevent(
    model, controller, kept
):
    url = "virtual://ft232h"
    messages: list[str] = []
    clock = VirtualClock()
    control = controller_for(controller, model.card, print)
    grip = open_grip("virtual?lag_ms=50", control, 150.0, url, clock, messages.append)
    run_on(grip, model, url, 4.0, clock)
    grip.close()
    assert messages[0] == WHO_LETS_GO
    assert grip.scene is not None
    outcome = grip.scene.outcome()
    assert outcome.kept == kept
    assert messages[-1].startswith("scene: the object " + ("is in" if kept else "left"))
    assert outcome.strongest_n > outcome.wearers_n or not kept


def test_the_friction_of_a_live_run_is_that_of_the_object(model, tmp_path, monkeypatch):
    """Within 15 % of the scene's; without the gain of its sensors it would be 0.6 of it."""
    # The default model is seldom sure of a slip for six samples: here less is enough.
    monkeypatch.setattr(grip_control, "SURE_P", 0.15)
    (tmp_path / "fall.toml").write_text(FALL, encoding="utf-8")
    # an object that slides before it is caught, and so shows its friction
    url = f"virtual://ft232h?scene={tmp_path / 'fall.toml'}&seed=114"
    gain = shear_gain_of(url, None)
    assert gain is not None
    clock = VirtualClock()
    control = controller_for("holdfast", model.card, print, shear_gain=gain)
    grip = open_grip("virtual", control, 150.0, url, clock, print)
    run_on(grip, model, url, 3.9, clock)
    _, trial = planned_trial(source_url(url), ROWS_HZ, STEP_S)
    assert grip.newest is not None
    mu_hat = grip.newest.mu_hat or 0.0
    assert mu_hat == pytest.approx(trial.kinetic_friction, rel=0.15)
    assert gain * mu_hat < 0.7 * trial.kinetic_friction


def test_the_shear_gain_is_that_of_the_calibration_or_of_the_scenes_sensors(
    model, tmp_path
):
    matrix = np.tile(np.eye(3), (6, 1, 1))
    nothing = np.zeros((6, 3))
    words = ("loads", "2026-11-23", "N", 9)
    known = Calibration(matrix, nothing, np.zeros(6, bool), *words, nothing, 0.8)
    path = write_calibration(tmp_path / "c.json", known)
    assert shear_gain_of("usb://ft232h", path) == 0.8
    assert shear_gain_of(REST, None) == magnet_gain()
    assert shear_gain_of("usb://ft232h", None) is None
    for effects, gain in (("[effects.dipole]\n", magnet_gain()), ("", 1.0)):
        scene = tmp_path / "scene.toml"
        scene.write_text(NOTHING + effects, encoding="utf-8")
        assert shear_gain_of(f"sim://{scene}?trial=0&seed={len(effects)}", None) == gain


def test_a_scene_without_commands_is_the_recorded_one(tmp_path):
    (tmp_path / "fall.toml").write_text(FALL, encoding="utf-8")
    url = f"virtual://ft232h?scene={tmp_path / 'fall.toml'}&seed=1"
    scene, trial = planned_trial(source_url(url), ROWS_HZ, STEP_S)
    recorded = scene.run_together([trial])[0].signal
    live = live_scene(source_url(url), drive_of("virtual"))
    for row in range(0, len(recorded.t_s), 7):
        want = recorded.values[row, 3].tolist()
        assert live.at(float(recorded.t_s[row]), 3) == want


@NO_GRIP_COMMAND.mark
def test_a_hand_in_a_scene_holds_where_commands_stay_away(tmp_path):
    (tmp_path / "fall.toml").write_text(FALL, encoding="utf-8")
    live = live_scene(
        source_url(f"virtual://ft232h?scene={tmp_path / 'fall.toml'}"),
        drive_of("virtual"),
    )
    live.advance(2.0)
    tighten = GripCommand(1, 0, "tighten", 20.0, 400.0, 0.0, "test")
    live.obey(tighten, 2_000_000_000)
    live.obey(tighten._replace(mode="idle", target_n=None), 2_005_000_000)
    live.obey(tighten, 2_010_000_000)
    live.advance(4.0)
    assert live.outcome().strongest_n == pytest.approx(20.0, rel=0.05)


# -- what cannot be


WRONG_OPTIONS = {
    "--grip tcp://x:1": "is not an address",
    "--to best": "FILE.jsonl",
    "--to udp://9000": "HOST:PORT",
    "--wearer - --source -": "cannot be both",
    "--grip virtual --source sim://apple": "has no scene",
    "--grip virtual?colour=red": "allowed: lag_ms",
    "--grip virtual?ceiling_n=0": "above 0",
    "--grip udp://127.0.0.1:9000": "nothing that moves a hand crosses a network",
}
"""What is typed, and what the error names."""


@pytest.mark.parametrize("typed", WRONG_OPTIONS)
def test_an_option_that_cannot_be_is_one_line_and_exit_code_2(run, typed):
    code, _, err = run(*RUN[3:], *typed.split())
    assert code == 2
    assert WRONG_OPTIONS[typed] in err
    assert err.count("\n") == 1


def test_a_hand_that_is_too_weak_for_its_object_is_refused(tmp_path):
    (tmp_path / "fall.toml").write_text(FALL, encoding="utf-8")
    url = f"virtual://ft232h?scene={tmp_path / 'fall.toml'}&seed=1"
    with pytest.raises(UsageError, match=r"ceiling of 1 N is below the 1\.6 N"):
        live_scene(source_url(url), drive_of("virtual?ceiling_n=1"))


def card_with(model, **spec):
    card = model.card
    return msgspec.structs.replace(
        card, spec=msgspec.structs.replace(card.spec, **spec)
    )


def test_a_model_of_a_raw_field_runs_in_reduced_mode_and_says_so(model):
    messages: list[str] = []
    controller_for("holdfast", card_with(model, unit="uT"), messages.append)
    assert len(messages) == 1
    assert "reduced mode" in messages[0]


def test_a_model_for_another_number_of_fingers_is_refused(model):
    with pytest.raises(
        ChannelError, match="for 16 sensors and does not say which side"
    ):
        controller_for("holdfast", card_with(model, n_sensors=16), print)


def test_a_run_that_moves_a_real_hand_loads_no_simulation():
    loaded = loaded_by("import holdfast.live.grip")
    assert "edge_runtime" in loaded
    assert (
        loaded & {"simulation", "training", "export", "evaluation", "scipy", "sklearn"}
        == set()
    )


def test_rules_take_the_place_of_the_model_s_and_an_answer_begins_before_it_is_full(
    model,
):
    control = controller_for("holdfast", model.card, print, rules={"from_p": 0.2})
    usual = AnswerRules.of(model.card.decision)
    assert control.rules == replace(usual, from_p=0.2)
    with pytest.raises(UsageError, match=r"from_p = 0\.9 is not below full_p = 0\.8"):
        controller_for("holdfast", model.card, print, rules={"from_p": 0.9})
    with pytest.raises(CardError, match="lead is not known; next: allowed: from_p"):
        checked_rules({"lead": 1.0})
