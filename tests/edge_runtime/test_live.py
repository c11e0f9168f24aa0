"""The live loop: on time or counted, unknown at once, the same again in a replay, and a clean
end."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hazard_marks import LOST_SENSOR, OTHER_SENDER, RESTART, SILENT_SENDER
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from live_bench import ROOT, RUN, Steady, closing_output, go
from made_prediction import prediction

from holdfast.core.contract import Command, Prediction, Sample
from holdfast.core.errors import ChannelError, OutputError, UnitError, UsageError
from holdfast.core.source import SourceReading
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.monitor import Model
from holdfast.edge_runtime.preparation import Preparation, Tare
from holdfast.live.loop import Summary
from holdfast.live.outputs import SampleFile, file_sink, udp_sink
from holdfast.live.run import answer
from holdfast.live.running import ServiceWatchdog
from holdfast.live.sources import open_live
from holdfast.live.view import open_view

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


# -- where answers go


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


def test_a_view_without_rich_is_a_plain_line_that_names_the_extra(model, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setitem(sys.modules, "rich.console", None)
    monkeypatch.setattr("holdfast.live.view.PLAIN_S", 0.01)
    shown, _ = seen_in_a_terminal(model, "finger 3 is lost", b"(risky slip) 0.")
    assert b"finger 3 is lost" in shown
    assert b"pip install 'holdfast[view]'" in shown
    assert b"UNKNOWN, p(risky slip) 0." in shown
    assert b"\x1b" not in shown


def test_the_udev_rules_name_the_bridge():
    from holdfast.drivers.usb import PRODUCT, VENDOR

    rules = (ROOT / "holdfast" / "drivers" / "board" / "70-holdfast.rules").read_text()
    ids = f'ATTR{{idVendor}}=="{VENDOR:04x}", ATTR{{idProduct}}=="{PRODUCT:04x}"'
    assert ids in rules


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
@OTHER_SENDER.mark
def test_the_shipped_service_s_command_is_one_that_the_program_understands():
    import shlex

    from holdfast.cli.command import Parser
    from holdfast.cli.run import add_run_arguments

    unit = (
        (ROOT / "holdfast" / "drivers" / "board" / "holdfast.service")
        .read_text()
        .replace("\\\n", "")
    )
    line = next(line for line in unit.splitlines() if line.startswith("ExecStart="))
    parser = Parser(prog="holdfast run")
    add_run_arguments(parser)
    words = shlex.split(line.removeprefix("ExecStart="))
    args = parser.parse_args(words[2:])
    assert words[1] == "run"
    assert (args.bias.name, args.to) == ("bias.json", ["none"])
    # no port, which every program of the board could write to
    assert args.wearer == "unix:///run/holdfast/wearer"
    assert args.grip == "unix:///run/holdfast/grip"
    for line in ("RuntimeDirectory=holdfast", "RuntimeDirectoryMode=0700"):
        assert f"{line}\n" in unit


def test_a_bias_of_a_hand_that_lost_a_finger_is_not_written(run, tmp_path):
    lost = "virtual://ft232h?fault=nack:2@0%2B99"
    code, _, err = run("bias", "--source", lost, "--out", tmp_path / "b.json")
    assert code == 3
    assert not (tmp_path / "b.json").exists()
    assert "error:" in err
