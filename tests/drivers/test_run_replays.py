"""What a run kept replays as it ran, and no reading that is lost teaches sign or zero."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_bench import TINY, closing_output
from test_line_source import ScriptedFeed
from test_lsl import ScriptedInlet

from holdfast.cli.run import run_replay
from holdfast.core.contract import FloatArray, Prediction, channel_names
from holdfast.core.source import Source
from holdfast.drivers.lines import LineSource, SampleReader
from holdfast.drivers.lsl import LslSource
from holdfast.drivers.replay import zero_of
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.model import Model
from holdfast.live.outputs import SampleFile, emit_to
from holdfast.live.run import answer
from holdfast.live.sources import open_live, open_source

RATE_HZ = 150.0
ROWS = 330
PLACES = {"beginning": 0.0, "middle": 1.2, "end": 2.0}
"""When a loss begins, s; the hand has closed by the middle."""
LASTS_S = (0.01, 0.08, 0.3)
RESTING = np.tile([3.0, -2.0, 24.0], 6)
"""What the unloaded hand of a stream reads."""
CARD = """
[record]
rate_hz = 150
[physics]
step_s = 0.003
[[trials]]
objects = ["soft-ball"]
action = "pull"
style = "author"
close_at_s = 0.8
hold_s = 0.8
tail_s = 0.5
[effects.brush]
count = 5
[effects.dipole]
"""
Losses = list[tuple[float, float, int | None]]
"""(begins at, lasts, sensor from 1 or None for all) of each, s."""


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(TINY)


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FloatArray]:
    """A scene's card, and its trial as a stream that no zero was removed from."""
    card = tmp_path_factory.mktemp("hand") / "pull.toml"
    card.write_text(CARD, encoding="utf-8")
    return card, open_source(f"sim://{card}").values + RESTING


def lost(losses: Losses, k: int) -> set[int | None]:
    """The sensors that are lost at sample k, None for the whole sample."""
    at_s = (k + 0.5) / RATE_HZ
    return {
        sensor for begins, lasts, sensor in losses if begins <= at_s < begins + lasts
    }


def usb(clock: Any, card: Path, rows: FloatArray, losses: Losses) -> Source:
    faults = [
        f"&fault=unplug@{begins:g}%2B{lasts:g}"
        if sensor is None
        else f"&fault=nack:{sensor}@{begins:g}%2B{lasts:g}"
        for begins, lasts, sensor in losses
    ]
    url = f"virtual://ft232h?scene={card}&seed=2{''.join(faults)}"
    return open_live(url, clock=clock, report=lambda line: None)


def lines(clock: Any, card: Path, rows: FloatArray, losses: Losses) -> Source:
    def line(k: int) -> bytes:
        fields: dict[str, Any] = dict(zip(channel_names(6), rows[k], strict=True))
        # what a lost sensor reads is anything
        for sensor in lost(losses, k):
            fields |= {f"valid{sensor}": 0, f"Z{sensor}": -150.0}
        return json.dumps(fields).encode()

    feed = ScriptedFeed(
        clock, lambda k: None if None in lost(losses, k) else 0, line, ends=ROWS
    )
    return LineSource(feed, SampleReader(), clock, lambda line: None, RATE_HZ)


def lsl(clock: Any, card: Path, rows: FloatArray, losses: Losses) -> Source:
    def row(k: int) -> FloatArray:
        values = rows[min(k, len(rows) - 1)].copy()
        for sensor in lost(losses, k):
            values[3 * (sensor or 1) - 1] = np.nan
        return values

    inlet = ScriptedInlet(clock, rows=row)
    # whole samples that never come
    inlet.gone = [k for k in range(ROWS) if None in lost(losses, k)]  # type: ignore[assignment]
    return LslSource(inlet, clock, lambda line: None)


Open = Callable[[Any, Path, FloatArray, Losses], Source]
WHERE = st.tuples(
    st.sampled_from(sorted(PLACES.values())),
    st.sampled_from(LASTS_S),
    st.sampled_from([None, 1, 4]),
)


@settings(max_examples=10)
@given(st.sampled_from([usb, lines, lsl]), st.booleans(), st.lists(WHERE, max_size=3))
def test_a_replay_gives_the_states_of_the_run_row_by_row(
    model: Model,
    hand: tuple[Path, FloatArray],
    tmp_path_factory: pytest.TempPathFactory,
    open_hand: Open,
    with_bias: bool,
    losses: Losses,
) -> None:
    path = tmp_path_factory.mktemp("run") / "kept.csv"
    ran = kept_run(model, hand, open_hand, with_bias, losses, path)
    assert replayed(path) == [(one.state, one.settled) for one in ran]
    assert {"unknown", "grasp"} <= {one.state for one in ran} or losses


def kept_run(
    model: Model,
    hand: tuple[Path, FloatArray],
    open_hand: Open,
    with_bias: bool,
    losses: Losses,
    path: Path,
) -> list[Prediction]:
    """The answers of a run of ROWS samples that keeps these in a file."""
    clock = VirtualClock()
    source = open_hand(clock, *hand, losses)
    resting = RESTING if open_hand is not usb else np.zeros(18)
    answers: list[Prediction] = []
    kept = SimpleNamespace(write=lambda one, *_: answers.append(one))
    with closing_output(
        SampleFile(path, 18, "N", "measured" if with_bias else "first samples")
    ) as file:
        answer(
            source,
            model,
            clock,
            emit_to([kept, file]),
            lambda: len(answers) == ROWS,
            resting=resting if with_bias else None,
        )
    return answers


def replayed(path: Path) -> list[tuple[str, bool]]:
    """(state, settled) of each line of `holdfast replay`."""
    out = StringIO()
    with redirect_stdout(out):
        run_replay(argparse.Namespace(model=str(TINY), trial=str(path)))
    found = [json.loads(line) for line in out.getvalue().splitlines()]
    return [(one["state"], one["settled"]) for one in found]


def as_lines(path: Path, clock: VirtualClock) -> Source:
    """The file as a pipe brings it, row by row."""
    rows = path.read_bytes().splitlines()
    feed = ScriptedFeed(clock, line=rows.__getitem__, ends=len(rows))
    return LineSource(feed, SampleReader(), clock, print, RATE_HZ)


def as_recording(path: Path, clock: VirtualClock) -> Source:
    return open_live(f"replay://{path}", clock=clock, report=print)


@pytest.mark.parametrize("open_file", [as_recording, as_lines])
def test_a_run_of_a_run_removes_no_second_zero(
    model: Model,
    hand: tuple[Path, FloatArray],
    tmp_path: Path,
    open_file: Callable[[Path, VirtualClock], Source],
) -> None:
    # a stored zero, and a hand that is closed from the first sample on
    card, rows = hand
    held = np.repeat(rows[200:201], 400, axis=0)
    held += 0.02 * np.random.default_rng(1).normal(size=held.shape)
    path = tmp_path / "kept.csv"
    ran = kept_run(model, (card, held), lines, True, [], path)
    assert {one.why for one in ran[100:]} <= {"", "started_loaded"}
    clock, again = VirtualClock(), []
    source = open_file(path, clock)
    assert zero_of(source) == "measured"
    answer(source, model, clock, lambda one, *_: again.append(one), lambda: False)
    assert [one.state for one in again] == [one.state for one in ran]
