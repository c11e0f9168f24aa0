"""`--json` means the same in every command: one JSON object, in a file or instead of the words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Run
from long_steps import long_steps

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
