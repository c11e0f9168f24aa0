"""The live loop: on time or counted, unknown at once, the same again in a replay, and a clean
end."""

from __future__ import annotations

import io
import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_line import fails
from drawn_picture import drawn
from hazard_marks import LOST_SENSOR, OTHER_SENDER, RESTART, SILENT_SENDER
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from live_bench import ROOT, RUN, Steady, closing_output, go
from made_prediction import prediction

from holdfast.core.contract import Prediction, Sample
from holdfast.core.errors import (
    ChannelError,
    DeviceError,
    LibraryMissing,
    OutputError,
    RateError,
    UnitError,
    UsageError,
)
from holdfast.core.hand_card import read_hand_card, sensor_names
from holdfast.core.lines import stream_sink
from holdfast.core.source import SourceReading
from holdfast.drivers.calibration import read_bias
from holdfast.drivers.replay import PacedReplay, Replay, open_replay
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.edge_runtime.preparation import Preparation, Tare
from holdfast.edge_runtime.wearer import Command, Intent
from holdfast.live.loop import STAGES, Summary
from holdfast.live.outputs import LineOutput, SampleFile, file_sink, udp_sink
from holdfast.live.run import answer
from holdfast.live.running import ServiceWatchdog
from holdfast.live.scene import scene_truth
from holdfast.live.sources import open_live, source_url
from holdfast.live.view import Shown, open_view

if TYPE_CHECKING:
    from conftest import Built

AREA = "Time and schedule"


# -- the schedule


def test_samples_are_due_at_whole_periods_from_the_start(model):
    clock = VirtualClock(5_000_000_000)
    source = Steady(clock, 301)
    summary, _, _ = go(model, source, clock)
    assert np.diff(source.times).min() >= 1e9 / 150 - 1
    assert source.times[300] == 5_000_000_000 + 2_000_000_000
    assert (summary.samples, summary.overruns) == (301, 0)


@pytest.mark.hard_case(
    AREA,
    "a late sample",
    elsewhere="a sleep of a period after every sample: each delay moves all that come after",
    here="the k-th sample is due at start + k periods",
)
def test_a_late_sample_delays_no_other(model):
    clock = VirtualClock()
    source = Steady(clock, 20, {5: 0.005})
    summary, _, _ = go(model, source, clock)
    assert summary.overruns == 0
    assert source.times[6] == round(6e9 / 150)


@pytest.mark.hard_case(
    AREA,
    "a machine that sleeps for a second",
    elsewhere="the missed samples are caught up with, all of them late",
    here="they are lost, counted as overruns; unknown until the history is whole again",
)
def test_a_machine_that_sleeps_for_a_second_counts_lost_samples_and_is_unknown_until_settled(
    model,
):
    clock = VirtualClock()
    source = Steady(clock, 400, {200: 1.003})
    summary, predictions, samples = go(model, source, clock)
    assert summary.overruns == 149
    assert samples[201].sequence - samples[200].sequence == 150
    assert 0 <= source.times[201] - round(samples[201].sequence * 1e9 / 150) < 1e9 / 150
    states = [prediction.state for prediction in predictions]
    assert states[199] == "nothing"
    assert states[201:210] == ["unknown"] * 9
    assert states[-1] == "nothing"


def test_stopping_ends_after_the_sample_under_way(model):
    clock = VirtualClock()
    source = Steady(clock, 1000)
    summary, predictions, _ = go(model, source, clock, stopped=lambda: source.k == 10)
    assert summary.samples == len(predictions) == 10


def test_every_stage_has_its_latency_and_a_run_of_nothing_has_none(model):
    clock = VirtualClock()
    summary, _, _ = go(model, Steady(clock, 5, {k: 0.001 for k in range(5)}), clock)
    assert list(summary.latency_us()) == [*STAGES, "read to emit"]
    assert summary.latency_us()["read"]["p50"] == pytest.approx(1000.0)
    assert summary.latency_us()["read to emit"]["p99"] == pytest.approx(1000.0)
    assert Summary().latency_us() == {}


def test_the_user_s_override_ends_a_request_and_an_opening_hand_begins_none(
    model, monkeypatch
):
    import holdfast.edge_runtime.monitor as watched

    user_commands = []
    real = watched.decide
    monkeypatch.setattr(
        watched,
        "decide",
        lambda *a, **k: (
            user_commands.append((k["opening"], k["override"])) or real(*a, **k)
        ),
    )
    clock = VirtualClock()
    commands = iter([Command(), Command(opening=True), Command(override=True)])
    go(model, Steady(clock, 3), clock, command=lambda: next(commands))
    assert user_commands == [(False, False), (True, False), (False, True)]


# -- taking the bias off

rows = hnp.arrays(
    np.float64, st.tuples(st.integers(5, 12), st.just(6)), elements=st.floats(-50, 50)
)


@given(
    rows,
    st.sampled_from([0, 1, 5]),
    st.sampled_from(["mean", "median"]),
    st.booleans(),
    st.sampled_from(["normal", "sensor"]),
)
def test_a_stream_is_tared_as_a_recording_is_prepared(
    raw, bias_rows, statistic, flip, turns
):
    preparation = Preparation(bias_rows, statistic, flip, flip_beyond=0.3, turns=turns)
    tare, valid = Tare(preparation, 6), np.ones(2, dtype=np.bool_)
    out = [tare.prepare(row, valid) for row in raw]
    whole = preparation.apply(raw)
    first = max(1, bias_rows) - 1 if bias_rows or flip else 0
    for k, (values, good) in enumerate(out):
        assert good.all() == (k >= first)
        if k >= first:
            np.testing.assert_array_equal(values, whole[k])


def test_a_finger_that_comes_late_is_tared_late_and_believed_only_then():
    tare = Tare(Preparation(2, "mean"), 6)
    there, both = np.array([True, False]), np.array([True, True])
    for _ in range(3):
        _, good = tare.prepare(np.full(6, 4.0), there)
    assert good.tolist() == [True, False]
    tare.prepare(np.full(6, 4.0), both)
    values, good = tare.prepare(np.full(6, 4.0), both)
    assert good.all()
    assert values.tolist() == [0.0] * 6


def test_a_finger_that_is_called_valid_and_reads_nothing_is_not_tared_with_nothing():
    tare, valid = Tare(Preparation(2, "median"), 3), np.array([True])
    for value in (np.nan, np.inf, 4.0):
        _, good = tare.prepare(np.full(3, value), valid)
        assert not good.any()
    values, good = tare.prepare(np.full(3, 4.0), valid)
    assert good.all()
    assert values.tolist() == [0.0] * 3


# -- a virtual hand, end to end


def kept(
    answers: list[Prediction], samples: list[Sample]
) -> Callable[[Prediction, Sample, SourceReading], None]:
    def emit(prediction: Prediction, sample: Sample, measured: SourceReading) -> None:
        answers.append(prediction)
        samples.append(sample)

    return emit


def live(
    model: Model, url: str, seconds: float
) -> tuple[Summary, list[Prediction], list[Sample], list[str]]:
    clock = VirtualClock()
    messages: list[str] = []
    answers: list[Prediction] = []
    samples: list[Sample] = []
    source = open_live(url, clock=clock, report=messages.append)
    end_ns = clock.now_ns() + round(1e9 * seconds)
    summary = answer(
        source, model, clock, kept(answers, samples), lambda: clock.now_ns() >= end_ns
    )
    source.close()
    return summary, answers, samples, messages


SHORT_PULL = """
[record]
rate_hz = 150
[physics]
step_s = 0.003
[[trials]]
objects = ["soft-ball"]
action = "pull"
style = "author"
close_at_s = 0.8
hold_s = 2.0
tail_s = 0.5
[effects.brush]
count = 5
[effects.dipole]
"""


@pytest.fixture(scope="module")
def pull(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A card of one pull, of four seconds."""
    card = tmp_path_factory.mktemp("pull") / "pull.toml"
    card.write_text(SHORT_PULL, encoding="utf-8")
    return card


def test_a_virtual_hand_is_pulled_at_and_asks_to_act_once_after_the_load_came_on(
    model, pull
):
    url = f"virtual://ft232h?scene={pull}&seed=2"
    summary, answers, _, _ = live(model, url, 5.0)
    truth = scene_truth(source_url(url))
    assert truth is not None
    acts = [a.t_acquired_ns * 1e-9 for a in answers if a.act]
    assert summary.acts == 1
    assert summary.overruns == 0
    assert truth.load_onset_s is not None
    assert 0.0 < acts[0] - truth.load_onset_s < 0.15


@LOST_SENSOR.mark
@pytest.mark.parametrize(
    ("fault", "left"),
    [
        ("nack:3@1+0.3", "degraded"),
        ("frozen:2@1+0.3", "degraded"),
        ("por:4@1", "degraded"),
        ("unplug@1+0.3", "unknown"),
        ("late@1+0.1", "unknown"),
    ],
)
def test_the_hand_is_degraded_without_one_sensor_unknown_without_all_and_comes_back_settled(
    model, fault, left
):
    _, answers, _, messages = live(
        model, f"virtual://ft232h?fault={fault.replace('+', '%2B')}", 2.6
    )
    lost = [
        (a.t_acquired_ns * 1e-9, "degraded" if a.degraded else a.state)
        for a in answers
        if (a.degraded or a.state == "unknown") and a.t_acquired_ns > 0.9e9
    ]
    assert 1.0 - 1 / 150 < lost[0][0] < 1.0 + 0.020 + 3 / 150
    # A scan that breaks off has read its first fingers: a sample or two are degraded.
    others = [what for _, what in lost if what != left]
    assert len(others) <= (2 if left == "unknown" else 0)
    assert len(lost) > 10 * len(others)
    assert answers[-1].state == "nothing"
    assert answers[-1].settled
    assert not answers[-1].degraded
    assert messages


def test_what_a_live_run_kept_replays_to_the_same_decisions_bit_for_bit(
    model, pull, tmp_path
):
    faults = "fault=nack:3@1.5%2B0.1&fault=unplug@2%2B0.1"
    url = f"virtual://ft232h?scene={pull}&seed=2&{faults}"
    _, answers, samples, _ = live(model, url, 5.0)
    with closing_output(SampleFile(tmp_path / "kept.csv", 18)) as file:
        for sample in samples:
            file.write(answers[0], sample)
    monitor = GripMonitor(model, None)
    replayed = {
        a.t_acquired_ns: a
        for a in (monitor.feed(sample) for sample in open_replay(tmp_path / "kept.csv"))
    }
    # rows that never came are filled in there
    again = [replayed[sample.t_ns - samples[0].t_ns] for sample in samples]
    result = [
        (a.state, a.p_situation, a.arm, a.act, a.detectors, a.settled) for a in answers
    ]
    assert [
        (a.state, a.p_situation, a.arm, a.act, a.detectors, a.settled) for a in again
    ] == result
    assert any(a.act for a in again)
    assert any(a.state == "unknown" for a in again[200:])


def test_a_recording_at_its_own_pace_answers_as_a_replay_does(eight_classes: Built):
    clock, model = VirtualClock(), Model(eight_classes.model)
    trial = next(eight_classes.fixture.glob("*/pull/trial_1.csv"))
    source = PacedReplay(open_replay(trial), clock.now_ns)
    answers: list[Prediction] = []
    answer(source, model, clock, kept(answers, []), lambda: False)
    monitor = GripMonitor(model, None)
    offline = [
        monitor.feed(sample)
        for sample in open_replay(trial).prepared(model.card.preparation)
    ]
    settle = model.card.preparation.bias_rows + model.card.settle_samples
    assert [a.state for a in answers[settle:]] == [a.state for a in offline[settle:]]


@pytest.mark.hard_case(
    AREA,
    "a step slower than the source",
    elsewhere="samples queue, and every answer is later than the one before",
    here="the newest reading is taken, those that would be past are not read, counted as overruns",
)
def test_a_reader_that_comes_late_finds_the_newest_row():
    clock = VirtualClock()
    values = np.arange(30.0).reshape(10, 3)
    source = PacedReplay(
        Replay(np.arange(10), values, np.ones((10, 1), bool), 100.0, "N"), clock.now_ns
    )
    first = source.read()
    clock.spend(35_000_000)
    late = source.read()
    assert first is not None and late is not None  # noqa: PT018
    assert (first.values[0], late.values[0]) == (0.0, 12.0)
    clock.spend(100_000_000)
    assert source.read() is None


def test_a_model_for_another_unit_or_hand_is_refused_before_the_first_sample(model):
    clock = VirtualClock()
    source = Steady(clock, 1)
    source.unit = "uT"
    with pytest.raises(UnitError, match="calibrate"):
        answer(source, model, clock, kept([], []), lambda: False)
    source.unit, source.n_channels = "N", 15
    with pytest.raises(ChannelError, match="15 channels"):
        answer(source, model, clock, kept([], []), lambda: False)


@pytest.mark.parametrize(
    "url",
    [
        "virtual://usb5",
        "virtual://ft232h?colour=red",
        "virtual://ft232h?averages=3",
        "virtual://ft232h?layout=nine",
        "virtual://ft232h?fault=melt@1",
        "usb://ft232h?scene=thesis",
        "virtual://ft232h?scene=thesis&trial=5000",
        "virtual://ft232h?seed=x",
        "foo://bar",
    ],
)
def test_a_url_that_cannot_be_is_a_usage_error(url):
    with pytest.raises(UsageError):
        open_live(url, clock=VirtualClock(), report=lambda line: None)


def test_a_real_bridge_that_is_not_there_is_a_device_error():
    with pytest.raises(DeviceError):
        open_live("usb://ft232h", clock=VirtualClock(), report=lambda line: None)


# -- where answers go


def test_a_line_goes_everywhere_at_once(tmp_path, model):
    clock = VirtualClock()
    _, predictions, _ = go(model, Steady(clock, 1), clock)
    text = io.StringIO()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(300)
        port = receiver.getsockname()[1]
        sinks = [file_sink(tmp_path / "out.jsonl"), udp_sink(f"127.0.0.1:{port}")]
        with closing_output(LineOutput([stream_sink(text), *sinks], print)) as lines:
            lines.write(predictions[0])
        datagram = receiver.recv(65536).decode()
    assert text.getvalue() == datagram + "\n" == (tmp_path / "out.jsonl").read_text()
    assert json.loads(datagram)["state"] == "unknown"


def test_a_file_that_is_there_is_not_written_over(tmp_path):
    (tmp_path / "out.jsonl").write_text("mine")
    with pytest.raises(OutputError, match="new file"):
        file_sink(tmp_path / "out.jsonl")
    with pytest.raises(OutputError, match="new file"):
        SampleFile(tmp_path / "out.jsonl", 18)
    assert (tmp_path / "out.jsonl").read_text() == "mine"


@pytest.mark.parametrize(
    "address", ["9000", "host:", ":9", "127.0.0.1:99999", "127.0.0.1:x"]
)
def test_an_address_that_cannot_be_is_a_usage_error(address):
    with pytest.raises(UsageError, match="HOST:PORT"):
        udp_sink(address)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_cleanly_with_its_summary(how):
    pipe = subprocess.PIPE
    command = [*RUN, "--seconds", "60"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=pipe, stderr=pipe, text=True
    ) as run:
        assert run.stdout is not None
        lines = [run.stdout.readline() for _ in range(20)]
        run.send_signal(how)
        out, err = run.communicate(timeout=300)
    assert run.returncode == (130 if how == signal.SIGINT else 0)
    assert all(json.loads(line) for line in (*lines, *out.splitlines()))
    assert "samples" in err
    assert "read to emit" in err


def test_the_view_shows_the_state_the_fingers_and_what_is_wrong_with_them(model):
    _, answers, samples, _ = live(model, "virtual://ft232h?fault=nack:3@0.5%2B5", 1.0)
    measured = SourceReading(
        0, np.zeros(18), samples[-1].valid, ("", "", "nack", "", "", "")
    )
    shown = Shown(answers[-1], samples[-1], measured, "N")
    text = drawn(shown)
    assert "NOTHING  degraded" in text
    assert re.search(r"^ +3 .*nack", text, re.MULTILINE)
    assert "risky slip" in text
    assert "wearer" not in text
    assert re.search(r"wearer +open", drawn(shown._replace(intent=Intent(0, "open"))))


def test_the_view_of_a_gripper_of_two_pads_names_these_and_no_other_hand():
    both = np.ones(2, dtype=np.bool_)
    sample = Sample(0, np.array([0.3, 0.4, 2.0] * 2), both, 0)
    measured = SourceReading(0, sample.values, both)
    names = sensor_names(read_hand_card("two-pad-gripper"), 2)
    text = drawn(Shown(prediction(), sample, measured, "N", names))
    assert re.search(r"^ left jaw +2\.00 +0\.50 *$", text, re.MULTILINE)
    assert re.search(r"^right jaw +2\.00", text, re.MULTILINE)
    assert not re.search(r"thumb|finger|\bsix\b", text.lower())


def seen_in_a_terminal(model, message: str, until: bytes) -> tuple[bytes, bytes]:
    """(what a view wrote until then, what it wrote at its end)."""
    _, answers, samples, _ = live(model, "virtual://ft232h", 0.1)
    seen, terminal = os.openpty()
    with open(terminal, "w", encoding="utf-8") as file:
        with closing_output(open_view(model.card, file)) as view:
            view.report(message)
            reading = SourceReading(0, np.zeros(18), samples[-1].valid)
            view.write(answers[-1], samples[-1], reading)
            shown = end = b""
            while until not in shown:
                shown += os.read(seen, 65536)
        os.set_blocking(seen, False)
        with suppress(BlockingIOError):
            end = os.read(seen, 65536)
    os.close(seen)
    assert not view.drawing
    return shown, end


def test_a_view_draws_below_the_messages_and_goes_away_at_the_end(model, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    shown, end = seen_in_a_terminal(model, "finger 3 is [bold] lost", b"UNKNOWN")
    assert shown.index(b"finger 3 is [bold] lost") < shown.index(b"UNKNOWN")
    # the cursor goes up and every line of the picture is erased
    assert end.count(b"\x1b[1A\x1b[2K") > 10


def test_a_view_without_rich_is_refused_by_the_name_of_the_extra(model, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setitem(sys.modules, "rich", None)
    seen, slave = pty.openpty()
    with (
        open(slave, "w", encoding="utf-8") as terminal,
        pytest.raises(LibraryMissing, match=r"holdfast\[view\]"),
    ):
        open_view(model.card, terminal)
    os.close(seen)


def test_a_view_on_what_is_no_terminal_draws_nothing(model, tmp_path):
    with (
        open(tmp_path / "err", "w", encoding="utf-8") as file,
        closing_output(open_view(model.card, file)) as view,
    ):
        assert not view.drawing
    assert (tmp_path / "err").read_text() == ""


def test_scan_names_every_sensor_and_the_layout_to_use(run):
    url = "virtual://ft232h?layout=mux6&fault=diag:3@0%2B100"
    code, out, _ = run("scan", url)
    assert code == 0
    assert out.count("TMAG5273 A1 (40/80 mT)") == 6
    assert "DIAG_STATUS" in out
    assert "layout=0:35,1:35,2:35,3:35,4:35,5:35" in out
    assert "serves" in out


def test_scan_without_a_bridge_says_what_to_do_next(run):
    fails(run, 6, "DeviceNotFound", "scan", says="holdfast doctor")


@pytest.mark.parametrize(
    ("part", "holds"), [("udev", "6014"), ("service", "NoNewPrivileges=yes")]
)
def test_the_board_s_files_come_out_whole(run, part, holds):
    code, out, _ = run("board", part)
    assert code == 0
    assert holds in out


def test_the_udev_rules_name_every_bridge():
    from holdfast.drivers.bridges import BRIDGES, ids_of

    rules = (ROOT / "drivers" / "board" / "70-holdfast.rules").read_text()
    for name in BRIDGES:
        for vendor, product in ids_of(name):
            assert (
                f'ATTR{{idVendor}}=="{vendor:04x}", ATTR{{idProduct}}=="{product:04x}"'
                in rules
            )


def test_a_bridge_whose_first_scans_are_slow_is_not_refused(model):
    clock = VirtualClock()
    source = Steady(clock, 50, stalls=dict.fromkeys(range(20), 0.01))
    summary = answer(source, model, clock, kept([], []), lambda: False)
    assert summary.samples > 0


def test_a_recording_at_another_rate_is_refused(eight_classes: Built, model):
    source = PacedReplay(
        open_replay(next(eight_classes.fixture.glob("*/pull/trial_1.csv"))), lambda: 0
    )
    with pytest.raises(RateError, match="50 Hz, the model needs 150"):
        answer(source, model, VirtualClock(), kept([], []), lambda: False)


@SILENT_SENDER.mark
def test_every_answer_says_whether_commands_still_come(model):
    clock = VirtualClock()
    result = iter([Command(), Command(link="live"), Command(link="expired")])
    _, predictions, _ = go(model, Steady(clock, 3), clock, command=lambda: next(result))
    assert [one.commands for one in predictions] == ["none", "live", "expired"]


# -- the service


def test_the_service_manager_receives_ready_at_the_first_answer_then_signs_of_life_then_the_end(
    tmp_path,
):
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(path)
        manager.setblocking(False)
        with closing_output(ServiceWatchdog({"NOTIFY_SOCKET": path})) as watchdog:
            with pytest.raises(BlockingIOError):
                manager.recv(100)
            for now_ns in (0, 50_000_000, 100_000_000, 350_000_000):
                watchdog.write(prediction(t_decided_ns=now_ns))
        datagrams = [manager.recv(100) for _ in range(5)]
    assert datagrams == [
        b"READY=1",
        b"WATCHDOG=1",
        b"WATCHDOG=1",
        b"WATCHDOG=1",
        b"STOPPING=1",
    ]


def test_a_service_manager_that_does_not_listen_or_is_not_there_delays_nothing(
    tmp_path,
):
    path = str(tmp_path / "notify")
    for environment in (
        {},
        {"NOTIFY_SOCKET": path},
        {"NOTIFY_SOCKET": "@holdfast-test-no-listener"},
    ):
        with closing_output(ServiceWatchdog(environment)) as watchdog:
            watchdog.write(prediction())
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(path)
        with closing_output(ServiceWatchdog({"NOTIFY_SOCKET": path})) as watchdog:
            for k in range(10_000):
                watchdog.write(prediction(t_decided_ns=k * 10**9))


@RESTART.mark
def test_the_shipped_service_names_bias_calibration_and_commands_is_never_given_up_and_is_watched():
    unit = (ROOT / "drivers" / "board" / "holdfast.service").read_text()
    for word in (
        "--bias ",
        "--calibration ",
        "--wearer ",
        "Type=notify",
        "WatchdogSec=1\n",
        "Restart=always",
        "StartLimitIntervalSec=0",
    ):
        assert word in unit
    assert unit.index("StartLimitIntervalSec") < unit.index("[Service]")


@RESTART.mark
@OTHER_SENDER.mark
def test_the_shipped_service_s_command_is_one_that_the_program_understands():
    import shlex

    from holdfast.cli.command import Parser
    from holdfast.cli.run import add_arguments

    unit = (
        (ROOT / "drivers" / "board" / "holdfast.service")
        .read_text()
        .replace("\\\n", "")
    )
    line = next(line for line in unit.splitlines() if line.startswith("ExecStart="))
    parser = Parser(prog="holdfast run")
    add_arguments(parser)
    words = shlex.split(line.removeprefix("ExecStart="))
    args = parser.parse_args(words[2:])
    assert words[1] == "run"
    assert (args.bias.name, args.to) == ("bias.json", ["none"])
    # no port, which every program of the board could write to
    assert args.wearer == "unix:///run/holdfast/wearer"
    assert args.grip == "unix:///run/holdfast/grip"
    for line in ("RuntimeDirectory=holdfast", "RuntimeDirectoryMode=0700"):
        assert f"{line}\n" in unit


def test_a_bias_that_was_measured_before_lets_a_run_begin_with_a_loaded_hand(
    model, tmp_path, run
):
    code, out, _ = run(
        *["bias", "--source", "virtual://ft232h", "--out"],
        tmp_path / "bias.json",
        "--seconds",
        "0.5",
    )
    assert code == 0
    assert f"bias written to {tmp_path / 'bias.json'}; next: holdfast run" in out
    resting = read_bias(tmp_path / "bias.json").values
    tare = Tare(model.card.preparation, 18, resting)
    values, good = tare.prepare(resting + 3.0, np.ones(6, dtype=np.bool_))
    assert good.all()
    assert values == pytest.approx(np.full(18, 3.0), abs=0.2)
    lost = "virtual://ft232h?fault=nack:2@0%2B99"
    code, _, err = run("bias", "--source", lost, "--out", tmp_path / "b.json")
    assert code == 3
    assert not (tmp_path / "b.json").exists()
    assert "error:" in err
