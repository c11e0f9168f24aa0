"""A run without a bias says when its zero is taken, and when it was taken from a closed hand."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path

import numpy as np
from command_line import fails
from hazard_marks import RESTART
from live_bench import TINY
from made_prediction import prediction

from holdfast.core.contract import NORMAL_AXIS, Sample
from holdfast.core.hand_card import sensor_names
from holdfast.core.source import SourceReading
from holdfast.edge_runtime.monitor import Model
from holdfast.live.hand_files import PULLS_FLOORS, PULLS_S, AnswerWatch, ZeroWatch

CARD = Model(TINY).card
LONG = round(PULLS_S * CARD.rate_hz) + 1
"""Samples in a row after which the hand is warned of."""


def watched(
    normal_n: float,
    samples: int,
    valid: bool = True,
    measured: str = "",
    loaded: bool | None = None,
) -> tuple[ZeroWatch, list[str]]:
    """Five samples at zero, then one sensor at a force along its normal."""
    lines: list[str] = []
    watch = ZeroWatch(CARD, lines.append, measured)
    answer = prediction(started_loaded=loaded)
    for k in range(5 + samples):
        values = np.zeros(CARD.n_channels)
        usable = np.ones(CARD.n_channels // 3, dtype=np.bool_)
        if k >= 5:
            values[3 + NORMAL_AXIS] = normal_n
            usable[1] = valid
        reading = SourceReading(k, values, usable)
        watch.write(answer, Sample(k, values, usable, k), reading)
    return watch, lines


def test_the_user_is_asked_to_keep_the_hand_open_and_then_freed() -> None:
    _, lines = watched(5.0, LONG)
    assert "keep the hand open" in lines[0]
    assert lines[1:] == ["the zero is taken: the hand may close now"]


def test_a_fingertip_that_is_pulled_at_was_pressed_at_its_zero_or_is_turned() -> None:
    below = -1.01 * PULLS_FLOORS * CARD.normal_floor
    _, lines = watched(below, 10 * LONG)
    assert len(lines) == 3
    assert lines[2].startswith("warning: sensor 2 reads -0.61 N along its normal")
    assert "its normal axis points the other way" in lines[2]


def test_thousands_of_newtons_are_taken_for_millinewtons() -> None:
    _, lines = watched(4000.0, 10 * LONG)
    assert lines[2].startswith("warning: 4000 N along a normal")
    assert "are these mN?" in lines[2]


def test_a_hand_that_was_never_empty_is_said_once_with_the_zero_that_may_be_stale() -> (
    None
):
    _, lines = watched(5.0, 10 * LONG, measured="b.json (2026-05-01)", loaded=True)
    (line,) = lines
    assert line.startswith("warning: the hand was not empty since the start")
    assert "the zero of b.json (2026-05-01) is stale" in line
    assert watched(5.0, 10 * LONG, measured="b.json", loaded=False)[1] == []


def test_a_measured_zero_below_which_a_fingertip_is_pulled_is_warned_of() -> None:
    below = -1.01 * PULLS_FLOORS * CARD.normal_floor
    (line,) = watched(below, 10 * LONG, measured="b.json (2026-05-01)")[1]
    assert "the zero of b.json (2026-05-01) is not its zero any more" in line


@RESTART.mark
def test_a_stale_bias_is_said_in_the_terminal_and_an_absurd_or_foreign_one_refused(
    run, tmp_path: Path
) -> None:
    stored = tmp_path / "b.json"
    hand = ["--source", "virtual://ft232h"]
    code, out, err = run("bias", *hand, "--seconds", "0.4", "--out", stored)
    assert code == 0, out + err
    good = json.loads(stored.read_text())
    assert good["date"] == date.today().isoformat()
    assert good["calibration"] == ""
    answers = [*hand, "--bias", stored, "--seconds", "1", "--to", "none"]
    assert "warning" not in run("run", TINY, *answers)[2]

    values = [*good["values"][:-1], good["values"][-1] - 3.0]
    stored.write_text(json.dumps(good | {"values": values}))
    code, _, err = run("run", TINY, *answers)
    assert code == 0
    assert err.count("warning") == 1
    assert f"N. If it holds nothing, the zero of {stored} ({good['date']})" in (err)
    for change, says in (
        ({"values": [1e9] * 18}, "beyond 500 N"),
        ({"calibration": "0123456789abcdef"}, "calibration 0123456789abcdef, and this"),
    ):
        stored.write_text(json.dumps(good | change))
        fails(run, 3, "DataError", "run", TINY, *answers, says=says)


def test_a_sensor_that_never_answers_is_named_once_and_in_the_summary() -> None:
    lines: list[str] = []
    watch = AnswerWatch(CARD, lines.append)
    heard = np.array([True, True, False, True, True, True])
    for k in range(round(3 * CARD.rate_hz)):
        values = np.zeros(CARD.n_channels)
        watch.write(None, Sample(k, values, heard, k), SourceReading(k, values, heard))
    watch.close()
    name = sensor_names(CARD.hand, 6)[2]
    assert [line.split(";")[0] for line in lines] == [
        f"{name} has not answered yet",
        f"{name} never answered",
    ]


def test_a_short_pull_noise_and_a_lost_sensor_are_no_reason_to_warn() -> None:
    below = -1.01 * PULLS_FLOORS * CARD.normal_floor
    assert len(watched(below, LONG - 1)[1]) == 2
    assert len(watched(0.9 * below, 10 * LONG)[1]) == 2
    assert len(watched(below, 10 * LONG, valid=False)[1]) == 2
