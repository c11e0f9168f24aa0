"""docs/your-data.md does what it says: its commands and its code run in their order."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import fails

from holdfast.core.contract import SITUATIONS
from holdfast.data.datasets.trials import FOLDERS
from holdfast.data.fixture import write_example

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/your-data.md"
BLOCK = re.compile(r"```(sh|python|text)\n(.*?)```", re.DOTALL)


@pytest.mark.filterwarnings("ignore")
def test_the_page_runs_from_the_first_command_to_the_last(
    run: Callable[..., tuple[int, str, str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = PAGE.read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    printed, everything, shown = "", "", []
    for kind, text in BLOCK.findall(page):
        if kind == "python":
            capsys.readouterr()
            exec(text, names)
            printed = capsys.readouterr().out
        elif kind == "text":
            shown.append((text, printed))
        elif text.startswith("holdfast "):
            results = [run(*shlex.split(line)[1:]) for line in text.splitlines()]
            printed = "".join(out for _, out, _ in results)
            everything += printed
            assert all(code in (0, 3) for code, _, _ in results), results
        else:
            subprocess.run(["sh", "-e", "-c", text], check=True)
    assert [old for old, _ in shown] == [new for _, new in shown]
    ends = [new.splitlines()[-1][:9] for _, new in shown]
    assert ends == ["next: hol", "ready for", "safe_slip"]
    assert "held out by person: macro F1" in everything
    assert "grouped" not in everything
    assert "21 trials, 3 people" in everything
    assert "95 % interval over people" in everything
    card = json.loads(Path("build/your-data/model/holdfast.json").read_text())[
        "training"
    ]
    assert (card["groups"], card["group_kind"]) == (3, "person")
    truth = names["answers"]["truth"].dropna()  # type: ignore[index]
    assert set(truth) == set(SITUATIONS)


def test_the_page_names_every_action_that_a_map_may_have() -> None:
    page = PAGE.read_text("utf-8")
    assert [action for action in FOLDERS if f"`{action}`" not in page] == []


def test_the_example_is_the_same_every_time_and_overwrites_nothing(
    run: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    for name in ("one", "other"):
        write_example(tmp_path / name)
    paths = [
        path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*.csv")
    ]
    assert len(paths) == 21
    for path in paths:
        assert (tmp_path / "one" / path).read_bytes() == (
            tmp_path / "other" / path
        ).read_bytes()
    fails(
        run, 5, "OutputError", "check", tmp_path / "one", "--example", says="not empty"
    )
