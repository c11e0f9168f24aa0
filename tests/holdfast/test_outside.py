"""Impossible numbers and mistaken words: a typed error of one printable line."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
from hazard_marks import AMBIGUOUS, MISTAKEN_ARGUMENT, TERMINAL_ESCAPES
from hypothesis import given
from hypothesis import strategies as st
from small_model import card_of, sealed_bytes, with_metadata

from holdfast.cli.main import main
from holdfast.core import schema
from holdfast.core.errors import (
    LONGEST_LINE,
    CardError,
    DataNotFound,
    HoldfastError,
    NotAModel,
    TimeError,
    UsageError,
    one_line,
    visible,
)
from holdfast.core.trial_file import read_trial
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.faults import read_fault
from holdfast.edge_runtime.model_file import CARD_KEY, read_sealed
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.export.exporting import export_artifact
from holdfast.live.sources import open_bus, open_live, open_source
from holdfast.simulation.scene_file import read_scene_file

RATES = ["1e-300", "5e-324", "1e300", "-1", "0", "NaN", "1e999", "true", '"150"']


@AMBIGUOUS.mark
@pytest.mark.parametrize("rate", RATES)
def test_a_model_s_card_has_a_possible_rate(tmp_path: Path, rate: str) -> None:
    data = sealed_bytes()
    card = json.dumps(card_of(data)).replace('"rate_hz": 50.0', f'"rate_hz": {rate}')
    (tmp_path / "m.onnx").write_bytes(with_metadata(data, **{CARD_KEY: card}))
    with pytest.raises(NotAModel):
        GripMonitor(Model(tmp_path / "m.onnx"))


@AMBIGUOUS.mark
@pytest.mark.parametrize("rate", [rate for rate in RATES if rate != "NaN"])
def test_a_scene_has_a_possible_rate(tmp_path: Path, rate: str) -> None:
    text = read_scene_file("pull-soft-ball").text
    with_rate = re.sub(r"rate_hz *= *\S+", f"rate_hz = {rate}", text)
    assert with_rate != text
    (tmp_path / "card.toml").write_text(with_rate, encoding="utf-8")
    with pytest.raises(CardError):
        read_scene_file(str(tmp_path / "card.toml"))


@AMBIGUOUS.mark
@pytest.mark.parametrize("step_s", ["1e-300", "1e-9", "1e5", "1e300"])
def test_a_recording_has_a_possible_rate(tmp_path: Path, step_s: str) -> None:
    rows = "".join(f"{k * float(step_s)!r},1,2,3\n" for k in range(9))
    (tmp_path / "t.csv").write_text("Time,X1,Y1,Z1\n" + rows, encoding="ascii")
    with pytest.raises(TimeError):
        read_trial(tmp_path / "t.csv")


@AMBIGUOUS.mark
@pytest.mark.parametrize("words", [["record", "--rate"], ["bias", "--seconds"]])
@pytest.mark.parametrize("number", ["1e-300", "1e300", "nan", "-1", "0"])
def test_a_time_or_a_rate_on_the_command_line_is_possible(
    words: list[str], number: str, capsys
) -> None:
    assert main([*words, number]) == UsageError.exit_code
    assert "is not a number above 0, from" in capsys.readouterr().err


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
def test_a_plus_in_a_fault_may_be_escaped_and_need_not() -> None:
    url = "virtual://ft232h?fault=nack:3@1.5+0.2"
    for one in (url, url.replace("+", "%2B")):
        open_live(one, clock=VirtualClock(), report=print).close()
    assert read_fault("nack:3@1.5 0.2") == read_fault("nack:3@1.5+0.2")
    with pytest.raises(UsageError, match="is not a fault"):
        read_fault("nack 3")


@MISTAKEN_ARGUMENT.mark
def test_a_models_card_given_for_the_model_is_recognised(tmp_path: Path) -> None:
    card = tmp_path / "m.json"
    for there in (False, True):
        if there:
            card.write_text("{}", encoding="ascii")
        with pytest.raises(NotAModel) as caught:
            read_sealed(card)
        assert f"name the model: {tmp_path / 'm.onnx'}" in str(caught.value)


@MISTAKEN_ARGUMENT.mark
def test_an_export_to_a_json_file_would_be_overwritten_by_its_card_and_is_refused(
    tmp_path: Path,
) -> None:
    with pytest.raises(UsageError) as caught:
        export_artifact(tmp_path, tmp_path / "m.json")
    assert f"write --out {tmp_path / 'm.onnx'}" in str(caught.value)
    assert os.listdir(tmp_path) == []


def test_a_shipped_model_is_named_by_a_bare_name_that_no_file_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = schema.DEFAULT_MODEL
    assert schema.model_path(name) == schema.MODELS / f"{name}.onnx"
    for word in ("nowhere", f"mine/{name}", f"{name}.onnx"):
        assert schema.model_path(word) == Path(word)
    Path(name).touch()
    assert schema.model_path(name) == Path(name)
