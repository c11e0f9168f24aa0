"""The study of the widest scene."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from holdfast.core.reading import model_path
from studies.__main__ import PROGRAMS
from tools.harness import start


def test_the_wide_study_leaves_figures_and_starts_no_program_that_could_outlive_it(
    tmp_path: Path,
) -> None:
    """A worker ends with it (tests/evaluation/test_jobs.py), a program that it started does not."""
    started: list[str] = []
    watching = True

    def watch(event: str, words: tuple[object, ...]) -> None:
        if watching and event == "subprocess.Popen":
            started.append(str(words[0]))

    sys.addaudithook(watch)
    argv = ["wide", "--trials", "2", "--seed", "101", "--out", str(tmp_path)]
    argv += ["--model", str(model_path("holdfast-50hz"))]
    try:
        assert start("studies", PROGRAMS, argv) == 0
    finally:
        watching = False
    # git names the commit, and ends by itself
    assert set(started) == {"git"}
    figures = json.loads((tmp_path / "wide.json").read_text("utf-8"))
    assert sum(one["trials"] for one in figures["scene"].values()) == 2
    assert figures["seed"] == 101
