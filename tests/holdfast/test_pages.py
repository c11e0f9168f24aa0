"""Pages that teach do what they say: their commands (sh), their code and their notebooks run."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from long_steps import long_steps

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```", re.DOTALL | re.MULTILINE)
HEREDOC = re.compile(r"cat > (\S+) <<'END'\n(.*)END\n", re.DOTALL)
Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(autouse=True)
def less_work() -> Iterator[None]:
    """No page claims the time of a slip to the millisecond."""
    with long_steps():
        yield


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sets that pages of this file have simulated, one folder for each command."""
    return tmp_path_factory.mktemp("simulated")


@pytest.fixture
def follow(
    run: Command, simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., str]:
    """Runs the blocks of a page in their order, in an empty folder; returns what they printed.

    What another page simulates by the same words is copied.
    """
    monkeypatch.chdir(tmp_path)
    Path("models").symlink_to(ROOT / "models")

    def command(words: list[str]) -> str:
        made = simulated / "-".join(words[:-2])
        if words[0] == "simulate" and made.is_dir():
            shutil.copytree(made, words[-1])
            return ""
        code, printed, err = run(*words)
        assert code == 0, (words, err)
        if words[0] == "simulate":
            assert words[-2] == "--out"
            shutil.copytree(words[-1], made)
        return printed

    def of(page: str, elsewhere: str | None = None) -> str:
        printed = ""
        for kind, block in BLOCK.findall((ROOT / "docs" / page).read_text("utf-8")):
            if elsewhere is not None and elsewhere in block:
                continue
            if kind == "python":
                names: dict[str, Any] = {}
                exec(block, names)
                printed += getattr(names.get("done"), "stderr", "")
                continue
            if made := HEREDOC.fullmatch(block):
                Path(made[1]).parent.mkdir(parents=True, exist_ok=True)
                Path(made[1]).write_text(made[2], "utf-8")
                continue
            for line in block.splitlines():
                printed += command(shlex.split(line)[1:])
        return printed

    return of


@pytest.mark.filterwarnings("ignore")
def test_getting_started_ends_with_figures(follow: Callable[..., str]) -> None:
    printed = follow("getting-started.md")
    page = (ROOT / "docs/getting-started.md").read_text("utf-8")
    (listed,) = re.findall(r"^```text\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert listed in printed
    assert '"state": "risky_slip"' in printed or '"state":"risky_slip"' in printed
    assert "macro F1 over four situations" in printed


@pytest.mark.filterwarnings("ignore")
def test_a_student_without_hardware_ends_with_a_judged_model(
    follow: Callable[..., str],
) -> None:
    printed = follow("for-students.md")
    assert "macro F1 over four situations" in printed


def test_on_a_hand_finds_the_matrix_of_its_own_example_and_runs_a_recording(
    follow: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    printed = follow("on-a-hand.md")
    assert "10 probings, 600 rows, 1 sensors" in printed
    found = json.loads(Path("build/calibrate/hand.json").read_text("utf-8"))
    true = [[0.012, 0.001, 0.0], [0.0, 0.011, 0.001], [0.0, 0.001, 0.020]]
    np.testing.assert_allclose(found["matrix_n_per_ut"][0], true, atol=1e-4)
    # a run on a machine that is too busy drops lines, and its summary counts them
    (dropped,) = re.findall(r"60 samples, (?:.*?(\d+) dropped)?", printed)
    assert capsys.readouterr().out.count('"state"') + int(dropped or 0) == 60


@pytest.mark.filterwarnings("ignore")
def test_scenes_are_made_of_the_page_s_own_card(follow: Callable[..., str]) -> None:
    assert '"state"' in follow("scenes.md")
    assert len(list(Path("build/scenes/mine").rglob("trial_?.csv"))) == 18


@pytest.mark.filterwarnings("ignore")
def test_the_page_on_studies_lists_the_steps_of_its_own_protocol(
    follow: Callable[..., str],
) -> None:
    """Its part on adapting is run by test_adapt.py."""
    printed = follow("recording-and-study.md", elsewhere="holdfast adapt")
    page = (ROOT / "docs/recording-and-study.md").read_text("utf-8")
    (listed,) = re.findall(r"^```text\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert listed in printed


def test_the_api_page_answers_a_trial_and_a_hand(
    follow: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    follow("api.md")
    states = r"(unknown|nothing|grasp|safe_slip|risky_slip)"
    printed = capsys.readouterr().out
    assert re.search(rf"^{states} \d+ us$", printed, re.MULTILINE)
    # what a machine's speed has no part in stands in comments at the end of a block
    page = (ROOT / "docs/api.md").read_text("utf-8")
    shown = re.findall(r"^((?:# [^\n]*\n)+)```$", page, re.MULTILINE)
    assert len(shown) == 4
    by_speed = re.compile(r"^.* us\n", re.MULTILINE)
    assert "".join(shown).replace("# ", "") == by_speed.sub("", printed)


def test_the_file_runs_by_plain_onnxruntime_as_its_page_shows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    page = Path("docs/any-runtime.md").read_text("utf-8")
    (block,) = [text for kind, text in BLOCK.findall(page) if kind == "python"]
    assert "holdfast" not in block.replace("models/holdfast-150hz.onnx", "")
    exec(block, {})
    printed = capsys.readouterr().out.splitlines()
    assert "".join(f"# {line}\n" for line in printed) in block
    assert len(printed) == 3


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "says", "smaller"),
    [
        ("read-a-recording", "first request to act: ", ("", "")),
        (
            "train-on-your-data",
            "holdfast.onnx: ",
            ('"--trials", "40"', '"--trials", "24", "--rate", "50"'),
        ),
        (
            "from-your-recordings",
            "unseen, this model, as deployed: recall ",
            ('"36", "--rate", "100"', '"24", "--rate", "50"'),
        ),
    ],
    ids=["read-a-recording", "train-on-your-data", "from-your-recordings"],
)
def test_a_notebook_runs_as_a_program(
    name: str,
    says: str,
    smaller: tuple[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """smaller: a text of it -> what is run in its place, with fewer trials and samples a second."""
    monkeypatch.chdir(ROOT)  # a notebook goes to a temporary folder of its own
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    path = ROOT / f"docs/notebooks/{name}.py"
    text = path.read_text("utf-8")
    assert smaller[0] in text
    exec(compile(text.replace(*smaller), path, "exec"), {"__name__": "__main__"})
    printed = capsys.readouterr().out
    assert says in printed
    assert str(ROOT) not in printed
