"""`--json` means the same in every command: one JSON object, in a file or instead of the words."""

from __future__ import annotations

import argparse
import json
from importlib import import_module
from pathlib import Path

import pytest
from command_line import Run, fails
from long_steps import long_steps

from holdfast.cli.main import VERBS

LINES_OR_TEXT = {"run", "replay", "board", "study"}
"""Their stdout is JSON lines, or a file for another program; a study leaves report.json."""


def options_of(verb: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser()
    import_module(VERBS[verb][0]).add_arguments(parser)
    return parser


@pytest.mark.parametrize("verb", sorted(set(VERBS) - LINES_OR_TEXT))
def test_every_command_that_finds_something_takes_json(verb: str) -> None:
    assert "--json [FILE]" in options_of(verb).format_help()


COMMANDS = {
    "simulate": ("simulate", "pull-soft-ball", "--trials", "1", "--out", "set"),
    "scan": ("scan", "virtual://ft232h"),
    "doctor": ("doctor",),
    "bias": (
        "bias",
        "--source",
        "virtual://ft232h",
        "--seconds",
        "0.3",
        "--out",
        "bias.json",
    ),
    "check": ("check", "set"),
}


@pytest.mark.parametrize("verb", COMMANDS)
def test_without_a_file_the_object_stands_in_for_the_words(
    run: Run, verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with long_steps():
        if verb == "check":
            assert run(*COMMANDS["simulate"])[0] == 0
        code, out, err = run(*COMMANDS[verb], "--json")
    assert code == 0, err
    assert isinstance(json.loads(out), dict)


def test_beside_a_file_the_words_stay(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    alone = run("scan", "virtual://ft232h")[1].splitlines()
    code, out, err = run("scan", "virtual://ft232h", "--json", "found.json")
    assert (code, out.splitlines()[:-1]) == (0, alone[:-1]), (
        err
    )  # but for the time of a scan
    (bus,) = json.loads(Path("found.json").read_text("utf-8"))["buses"]
    assert bus["url"] == "virtual://ft232h"
    assert len([one for one in bus["devices"] if one["kind"] == "sensor"]) == 6
    assert bus["scan_s"] > 0.0


def test_a_file_that_cannot_be_written_is_refused_before_the_work(
    run: Run, tmp_path: Path
) -> None:
    out = tmp_path / "set"
    words = ("pull-soft-ball", "--out", out, "--json", "/proc/none/found.json")
    fails(run, 5, "OutputError", "simulate", *words)
    assert not out.exists()
