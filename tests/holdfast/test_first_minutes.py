"""The first five minutes of an engineer: what a terminal shows, and steps that exist."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from live_bench import free_port
from long_steps import long_steps

from holdfast.cli.main import main
from holdfast.core import hand_card

if TYPE_CHECKING:
    pass

Run = Callable[..., tuple[int, str, str]]
HANDS = Path(hand_card.__file__).with_name("hands")
LINE = b'{"sequence":'
PORT = "PORT"
"""Stands for a free port of this machine."""


def shown_on_a_terminal(*words: str) -> bytes:
    """What a short run of a virtual hand writes to a terminal on stdout."""
    seen, terminal = os.openpty()
    command = [sys.executable, "-m", "holdfast", "run", "--source", "virtual://ft232h"]
    done = subprocess.run(
        [*command, "--seconds", "0.2", *words],
        stdout=terminal,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(terminal)
    shown = b""
    # once all its writers have closed it, reading a terminal is an error
    try:
        while part := os.read(seen, 65536):
            shown += part
    except OSError:
        pass
    os.close(seen)
    assert done.returncode == 0, done.stderr
    assert b" samples, " in done.stderr
    return shown


@pytest.mark.parametrize(
    ("words", "lines"),
    [((), True), (("--to", "view"), False), (("--to", PORT), False)],
    ids=["alone", "beside a view", "beside a page"],
)
def test_a_terminal_shows_json_lines_or_a_picture_and_never_both(
    words: tuple[str, ...], lines: bool
) -> None:
    # chosen now: another program may have taken one that was free when tests were collected
    chosen = [f"web:{free_port()}" if word == PORT else word for word in words]
    assert (LINE in shown_on_a_terminal(*chosen)) is lines


def help_of(verb: str, capsys: pytest.CaptureFixture[str]) -> str:
    """On one line."""
    with pytest.raises(SystemExit):
        main([verb, "--help"])
    return " ".join(capsys.readouterr().out.split())


@pytest.fixture(scope="module")
def five_sensors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulated trials without the last sensor's columns."""
    folder = tmp_path_factory.mktemp("five") / "trials"
    with long_steps():
        assert main(["simulate", "thesis", "--trials", "2", "--out", str(folder)]) == 0
    for path in folder.rglob("trial_*.csv"):
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row[:16] for row in csv.reader(file)]
        with path.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows(rows)
    return folder


@pytest.mark.parametrize("verb", ["evaluate", "replay"])
def test_recordings_of_five_sensors_are_refused_with_steps_that_exist(
    run: Run, five_sensors: Path, verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [verb, "holdfast-150hz", "--data", str(five_sensors)]
    if verb == "replay":
        words = [verb, "holdfast-150hz", str(min(five_sensors.rglob("trial_*.csv")))]
    code, _, err = run(*words)
    assert code == 3
    assert "15 channels" in err
    assert "holdfast export MODEL --hand CARD --out FILE" in err
    assert "holdfast train" in err
    assert str(five_sensors) in err
    options = help_of("export", capsys)
    assert "--hand" in options
    assert "--out" in options


def test_the_step_that_is_offered_answers_recordings_of_five_sensors(
    run: Run, five_sensors: Path, tmp_path: Path
) -> None:
    card = tmp_path / "five.toml"
    whole = (HANDS / "six-fingertips.toml").read_text("utf-8")
    *five, _ = whole.split("[[sensors]]")
    card.write_text("[[sensors]]".join(five), encoding="utf-8")
    made = tmp_path / "five.onnx"
    code, _, err = run("export", "holdfast-150hz", "--hand", card, "--out", made)
    assert code == 0, err
    trial = min(five_sensors.rglob("trial_*.csv"))
    code, out, err = run("replay", made, trial)
    assert code == 0, err
    assert '"state":"grasp"' in out
