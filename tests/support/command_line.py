"""The command line in the process of the test."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from holdfast.cli import importing
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


def imported(
    run: Run, tmp_path: Path, *words: object, out: str = "set", code: int = 0
) -> str:
    """What `holdfast import logs --out set --yes` prints; code: that it must end with.

    Without its picture, which takes half of the time and which a test of its own draws.
    """
    command = ("import", tmp_path / "logs", "--out", tmp_path / out, "--yes")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(importing, "_picture", lambda args: [])
        found, printed, errors = run(*command, *words)
    assert found == code, printed + errors
    assert (tmp_path / out).exists() == (code == 0)
    return printed + errors
