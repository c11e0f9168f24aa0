"""The command line in the process of the test."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from functools import partial

import pytest

from holdfast.cli.main import main
from studies.__main__ import PROGRAMS
from tools.harness import start

PROGRESS = re.compile(r"warning: |exporting | *\d+ s  |  ")
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a command in this process: exit code, stdout, stderr. Warnings are printed, as they are
    for a user."""
    return _runner(main, capsys, monkeypatch)


@pytest.fixture
def study(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """The same for `python -m studies`."""
    return _runner(partial(start, "studies", PROGRAMS), capsys, monkeypatch)


def _runner(
    main: Callable[[list[str]], int],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> Run:
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)

    def command(*words: object) -> tuple[int, str, str]:
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            code = main([str(word) for word in words])
        return code, *capsys.readouterr()

    return command


def fails(run: Run, code: int, kind: str, *words: object, says: str = "") -> None:
    """Beside progress, one line on stderr that begins with the error's own name."""
    got, _, err = run(*words)
    lines = [line for line in err.splitlines() if not PROGRESS.match(line)]
    assert (got, len(lines)) == (code, 1), err
    assert lines[0].startswith(f"error: {kind}: "), err
    assert says in lines[0]
    assert "Traceback" not in err
