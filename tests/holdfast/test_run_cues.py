"""`feedback` of holdfast.toml: the wearer's cues on their own wire."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from grip_bench import ROOT, TtyReceiver, UnixReceiver, until
from hazard_marks import SILENT_CUES
from live_bench import RUN, closing_output
from made_prediction import prediction

from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.live.cues import QUIET_NS, SHIPPED, CueOutput, open_cues, read_cues

PERIOD_NS = 6_666_667
UNKNOWN = read_cues().rules["unknown"]


@contextmanager
def opened(
    url: str,
    clock: VirtualClock | None = None,
    report: Callable[[str], object] = print,
    path: Path = SHIPPED,
) -> Iterator[CueOutput]:
    now_ns = (clock or VirtualClock()).now_ns
    with closing_output(open_cues(url, path, now_ns, report)) as cues:
        yield cues


RISKY: dict[str, Any] = {"state": "risky_slip", "act": True}


def show(cues: CueOutput, samples: int, **changes: Any) -> None:
    for k in range(samples):
        cues.write(prediction(k, t_decided_ns=k * PERIOD_NS, **changes))
        until(lambda: cues.link.idle or not cues.link.works)


def test_cues_are_lines_of_their_pattern_on_either_wire():
    for receiver in (UnixReceiver(), TtyReceiver()):
        with opened(receiver.url) as cues:
            show(cues, 1, **RISKY)
        line = receiver.next()
        assert (line["cue"], line["pulses"], line["on_ms"], line["strength"]) == (
            "act",
            3,
            60,
            1.0,
        )
        receiver.close()


@SILENT_CUES.mark
def test_lines_go_on_while_no_cue_is_due():
    receiver = UnixReceiver()
    with opened(receiver.url) as cues:
        show(cues, 3 * QUIET_NS // PERIOD_NS, state="safe_slip")
    lines = receiver.waiting()
    assert [one["cue"] for one in lines] == ["quiet"] * 3 + ["unknown"]
    assert all(1_000_000 * one["expires_ms"] > 2 * QUIET_NS for one in lines)
    receiver.close()


@SILENT_CUES.mark
def test_the_last_line_of_a_run_is_the_cue_unknown(tmp_path):
    receiver = UnixReceiver()
    settings = tmp_path / "holdfast.toml"
    settings.write_text(f'feedback = "{receiver.url}"\n', encoding="utf-8")
    command = [*RUN, "--to", "none", "--config", str(settings)]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL) as run:
        first = receiver.next()
        run.send_signal(signal.SIGTERM)
        run.wait(300)
    assert first["cue"] in ("quiet", "unknown")
    last = receiver.waiting()[-1]
    assert last["cue"] == "unknown"
    assert (last["pulses"], last["on_ms"]) == (UNKNOWN.pulses, UNKNOWN.on_ms)
    receiver.close()


def test_a_dead_link_is_reported_once_and_no_cue_waits_for_it():
    receiver, clock, messages = UnixReceiver(), VirtualClock(), []
    receiver.close()
    with opened(receiver.url, clock, messages.append) as cues:
        show(cues, 300, **RISKY)
    assert [one for one in messages if "no line arrives" in one] == [messages[0]]
    assert "the wearer feels no cue" in messages[0]
    assert clock.now_ns() == VirtualClock().now_ns()  # nothing slept
