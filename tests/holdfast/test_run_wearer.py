"""`--wearer`: what the wearer wants beside the sensors: shown, recorded, and its `open` obeyed."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import fails
from grip_bench import ROOT
from hazard_marks import HOLDS_AGAINST_WEARER
from hypothesis import given, settings
from hypothesis import strategies as st
from live_bench import RUN
from made_prediction import prediction
from numbered_lines import numbered_sender
from recorder_bench import Hand, columns_of, said, session

from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.wearer import Intent, IntentMonitor, read_intent
from holdfast.live.wearer import wearer_monitor

Send = Callable[[Any], None]


@pytest.fixture
def wearer(tmp_path) -> Iterator[tuple[str, Send]]:
    """(the URL of a stream, what sends one item)."""
    with numbered_sender(tmp_path / "wearer") as sender:
        yield f"unix://{tmp_path}/wearer", sender.send


def monitored(url: str, clock: VirtualClock, messages: list[str]) -> Any:
    return wearer_monitor(url, clock, messages.append)


def test_a_trial_has_the_wearers_own_command_beside_it_on_the_clock_of_its_samples(
    tmp_path, wearer
):
    url, send = wearer
    clock, messages = VirtualClock(7_000_000_000), list[str]()
    says = {
        10: lambda: send({"wants": "open"}),
        20: lambda: send({"wants": "stop"}),
    }
    source = Hand(140, clock=clock, says=says)
    with monitored(url, clock, messages) as intent:
        send({"wants": "close"})  # before the trial: its time is not known
        options = {
            "seconds": 1.2,
            "intent": intent,
            "host_ns": lambda: clock.now_ns() + 5000,
        }
        kept, _ = session(tmp_path, source, **options)
    assert kept == 1
    folder = tmp_path / "p01" / "soft-ball" / "pull" / "trial_1"
    rows = rows_of(folder / "tactile.intent.csv")
    assert [wants for _, _, wants in rows] == ["open", "stop", "unknown"]
    assert [t_s for t_s, _, _ in rows] == pytest.approx([0.1, 0.2, 0.51], abs=0.002)
    assert rows[0][1] == int(columns_of(folder)["host_ns"][10])
    assert said(messages, "silent")


def test_a_run_records_the_stream_beside_its_samples_and_an_open_opens(
    tmp_path, wearer
):
    url, send = wearer
    samples = tmp_path / "trial.csv"
    options = ["--wearer", url, "--to", str(samples), "--to", "-"]
    with subprocess.Popen(
        [*RUN, *options], cwd=ROOT, text=True, stdout=subprocess.PIPE
    ) as run:
        assert run.stdout is not None
        answers, opened = [], 0
        for line in run.stdout:
            answers.append(json.loads(line))
            send({"wants": "open"})
            opened += answers[-1]["opening"]
            if opened == 5:
                run.send_signal(signal.SIGTERM)
                break
        run.stdout.read()
    assert run.returncode == 0
    items = read_intent(samples.with_suffix(".intent.csv"))
    assert {one.wants for one in items} == {"open"}
    assert answers[-1]["commands"] == "live"
    with samples.open(newline="") as lines:
        last_s = float(list(csv.reader(lines))[-1][0])
    assert 0 <= items[0].t_ns <= items[-1].t_ns <= 1e9 * (last_s + 0.1)


def rows_of(path: Path) -> list[tuple[float, int, str]]:
    """(time from the first sample, s; host, ns; word) of each line of a file."""
    lines = path.read_text("utf-8").splitlines()[1:]
    cells = [line.split(",") for line in lines]
    return [(float(t_s), int(host_ns), wants) for t_s, host_ns, wants in cells]


@HOLDS_AGAINST_WEARER.mark
@settings(deadline=None, max_examples=15)
@given(
    st.lists(
        st.tuples(st.sampled_from([None, "open", "stop"]), st.sampled_from([0.0, 1.0])),
        max_size=60,
    ),
    st.integers(1, 40),
)
def test_while_the_wearer_opens_no_command_has_a_target(said, lasts):
    clock, items = VirtualClock(10**9), list[Intent]()
    intent = IntentMonitor(items.copy, clock.now_ns, lambda line: None)
    intent.look()
    control = GripControl("holdfast", 150.0)
    forces = np.tile([0.1, 0.0, 1.4], 6)
    for wants, p_risky in [one for one in said for _ in range(lasts)]:
        clock.spend(6_666_667)
        items[:] = [Intent(clock.now_ns(), wants)] if wants else []
        opening = intent.command().opening
        now = prediction(p_risky=p_risky, opening=opening)
        command = control.step(now, forces, np.ones(6, dtype=np.bool_))
        if opening:
            assert command.mode in ("idle", "yield")
            assert command.target_n is None
    clock.spend(6_666_667)
    items[:] = [Intent(clock.now_ns(), "stop")]
    assert not intent.command().opening


def test_an_existing_file_beside_the_samples_is_never_overwritten(
    run, tmp_path: Path, wearer
):
    (tmp_path / "a.intent.csv").write_text("mine", encoding="utf-8")
    words = ("--wearer", wearer[0], "--to", tmp_path / "a.csv")
    fails(run, 5, "OutputError", *RUN[3:], *words)
    assert (tmp_path / "a.intent.csv").read_text("utf-8") == "mine"
