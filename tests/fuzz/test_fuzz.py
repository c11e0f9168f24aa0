"""Whatever comes from outside is taken, or refused with one of our errors; what broke something
once, for ever."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from fuzz_run import CORPUS, LONGEST_BYTES
from fuzz_targets import TARGETS, Target, refused

ROOT = Path(__file__).resolve().parents[2]
KEPT = sorted(
    str(path.relative_to(CORPUS)) for path in CORPUS.rglob("*") if path.is_file()
)
AREA = "What comes from outside"


@pytest.fixture(autouse=True)
def here_again() -> Iterator[None]:
    """A source is opened from a folder of its own."""
    before = os.getcwd()
    yield
    os.chdir(before)


@pytest.mark.hard_case(
    AREA,
    "an input that broke something once",
    elsewhere="a fixed crash comes back, because its input was not kept",
    here="every such input is a file in tests/fuzz/corpus, which every run of the tests replays",
)
def test_every_input_that_ever_broke_something_is_now_taken_or_refused_with_an_error_of_ours(
    record_property,
):
    errors = []
    for name in KEPT:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                refused(TARGETS[name.partition("/")[0]], (CORPUS / name).read_bytes())
            except (
                Exception
            ) as broken:  # whatever it is: the name of the file belongs to it
                errors.append(f"{name}: {broken!r}")
    record_property("inputs", len(KEPT))
    assert errors == []


@pytest.mark.parametrize("name", TARGETS)
def test_what_fuzzing_begins_with_is_taken(name):
    short = [seed for seed in TARGETS[name].seeds if len(seed) <= LONGEST_BYTES]
    assert short == list(TARGETS[name].seeds)
    answers = [refused(TARGETS[name], seed) for seed in short]
    assert answers[0] is None


def test_a_target_that_raises_something_else_is_broken():
    def boom(data: bytes) -> None:
        raise KeyError(data)

    with pytest.raises(KeyError):
        refused(Target(boom, ()), b"")


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Target -> how a bounded run of it with a fixed seed ended; all in one process, whose imports
    take seconds."""
    if importlib.util.find_spec("atheris") is None:
        pytest.skip(
            "atheris has no wheel for this machine (x86_64 Linux, Python 3.11 to 3.13): "
            "only the corpus is run"
        )
    out = tmp_path_factory.mktemp("fuzz")
    done = subprocess.run(
        [
            sys.executable,
            str(ROOT / "tests" / "fuzz" / "fuzz_run.py"),
            "--out",
            str(out),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    ended = dict(
        line.split(": ", 1)
        for line in done.stdout.splitlines()
        if line.partition(": ")[0] in TARGETS
    )
    assert (done.returncode == 0) == all(how == "holds" for how in ended.values()), (
        done.stderr[-2000:]
    )
    return ended


@pytest.mark.hard_case(
    AREA,
    "unforeseen bytes",
    elsewhere="a parser receives them on the hand, and the process ends in a traceback",
    here="coverage-guided fuzzing of every parser: bytes are taken, or refused with a typed error",
)
@pytest.mark.parametrize("name", TARGETS)
def test_fuzzing_finds_nothing_but_errors_of_ours(fuzzed, name, record_property):
    record_property("runs", TARGETS[name].runs)
    assert fuzzed[name] == "holds"
