"""Impossible numbers and mistaken words: a typed error of one printable line."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from hazard_marks import AMBIGUOUS, MISTAKEN_ARGUMENT, TERMINAL_ESCAPES
from hypothesis import given
from hypothesis import strategies as st

from holdfast.cli.main import main
from holdfast.core.errors import (
    LONGEST_LINE,
    DataNotFound,
    HoldfastError,
    TimeError,
    UsageError,
    one_line,
    visible,
)
from holdfast.core.trial_file import read_trial
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.export.exporting import export_artifact
from holdfast.live.sources import open_bus, open_live, open_source


@AMBIGUOUS.mark
@pytest.mark.parametrize("step_s", ["1e-300", "1e-9", "1e5", "1e300"])
def test_a_recording_has_a_possible_rate(tmp_path: Path, step_s: str) -> None:
    rows = "".join(f"{k * float(step_s)!r},1,2,3\n" for k in range(9))
    (tmp_path / "t.csv").write_text("Time,X1,Y1,Z1\n" + rows, encoding="ascii")
    with pytest.raises(TimeError):
        read_trial(tmp_path / "t.csv")


# -- what reaches a terminal

ESCAPES = "\x1b[2J\x1b]0;title\x07\x9b31m\u202egpj.exe\u2066\u200b\x7f\r\b"


def harmless(text: str) -> bool:
    return all(line.isprintable() for line in text.split("\n"))


@TERMINAL_ESCAPES.mark
@given(text=st.text(st.characters()))
def test_whatever_a_message_says_it_is_one_printable_line(text: str) -> None:
    error = HoldfastError(text, where=text, cause=text, next_step=text)
    assert str(error).isprintable()
    assert len(str(error)) <= LONGEST_LINE + 4
    assert visible(text).isprintable()
    assert one_line("plain words, µT and 日本") == "plain words, µT and 日本"


@TERMINAL_ESCAPES.mark
def test_no_escape_in_a_scenes_title_or_in_a_trials_folder_reaches_the_terminal(
    tmp_path: Path, capfd
) -> None:
    card = '[record]\nrate_hz=50\n[[trials]]\nobjects=["soft-ball"]\naction="pull"\ncount=1\n'
    path = tmp_path / "card\x1b[2J.toml"
    path.write_text(
        f"title={json.dumps(ESCAPES.replace(chr(127), ''))}\n{card}", encoding="utf-8"
    )
    code = main(["simulate", str(path), "--out", str(tmp_path / "out\x1b[2J")])
    trial = tmp_path / "person\x1b[31m" / "trial_1"
    trial.mkdir(parents=True)
    (trial / "meta.json").write_text('{"state": "kept"}', encoding="utf-8")
    (trial / "tactile.csv").write_text("Time,X1,Y1,Z1\n0,1,2,3\n", encoding="utf-8")
    main(["check", "--repair", str(tmp_path / "person\x1b[31m")])
    out, err = capfd.readouterr()
    assert harmless(out), out
    assert harmless(err), err
    assert code == 0, err
    assert "\\x1b[2J" in out
    assert "\\x1b[31m" in out


# -- arguments that mean something else


@MISTAKEN_ARGUMENT.mark
@pytest.mark.parametrize("word", ["ft232h", "/dev/i2c-1", "apple", "usb:/ft232h"])
def test_a_source_without_its_scheme_is_refused_with_the_schemes(
    word: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DataNotFound, match=r"no such file.*virtual://"):
        open_source(word)
    with pytest.raises(DataNotFound, match=r"no such file.*virtual://"):
        open_live(word, clock=VirtualClock(), report=print)
    with pytest.raises(UsageError, match="is not a hand"):
        open_bus(word, VirtualClock())


@MISTAKEN_ARGUMENT.mark
def test_an_export_to_a_json_file_would_be_overwritten_by_its_card_and_is_refused(
    tmp_path: Path,
) -> None:
    with pytest.raises(UsageError) as caught:
        export_artifact(tmp_path, tmp_path / "m.json")
    assert f"write --out {tmp_path / 'm.onnx'}" in str(caught.value)
    assert os.listdir(tmp_path) == []
