"""Pages that teach do what they say: their commands (sh), their code and their notebooks run."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from long_steps import long_steps

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```", re.DOTALL | re.MULTILINE)
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

    What another page simulates by the same words is copied. smaller: a text of a command -> what
    is run in its place.
    """
    monkeypatch.chdir(tmp_path)

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

    def of(page: str, smaller: tuple[str, str] = ("", "")) -> str:
        printed = ""
        text = (ROOT / "docs" / page).read_text("utf-8")
        assert smaller[0] in text
        for kind, block in BLOCK.findall(text.replace(*smaller)):
            if kind == "python":
                exec(block, {})
                continue
            for line in block.splitlines():
                printed += command(shlex.split(line)[1:])
        return printed

    return of


@pytest.mark.filterwarnings("ignore")
def test_getting_started_ends_with_figures(follow: Callable[..., str]) -> None:
    printed = follow("getting-started.md")
    assert '"state": "risky_slip"' in printed or '"state":"risky_slip"' in printed
    assert "macro F1 over four situations" in printed


def test_calibrate_finds_the_matrix_of_its_own_example(
    follow: Callable[..., str],
) -> None:
    printed = follow("calibrate.md")
    assert "10 probings, 600 rows, 1 sensors" in printed
    found = json.loads(Path("build/calibrate/hand.json").read_text("utf-8"))
    true = [[0.012, 0.001, 0.0], [0.0, 0.011, 0.001], [0.0, 0.001, 0.020]]
    np.testing.assert_allclose(found["matrix_n_per_ut"][0], true, atol=1e-4)


@pytest.mark.filterwarnings("ignore")
def test_train_ends_with_a_model_file(follow: Callable[..., str]) -> None:
    follow("train.md", ("--trials 60 ", "--trials 30 --rate 50 "))
    assert Path("build/train/model/holdfast.onnx").is_file()


def test_evaluate_ends_with_figures_of_simulated_trials(
    follow: Callable[..., str],
) -> None:
    follow("evaluate.md")
    figures = json.loads(Path("build/evaluate-page/figures.json").read_text("utf-8"))
    (unseen,) = figures["sets"].values()
    assert (unseen["data"]["kind"], unseen["data"]["recordings"]) == ("simulated", 20)


def test_the_api_page_answers_a_trial_and_a_hand(
    follow: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    follow("api.md")
    states = r"(unknown|nothing|grasp|safe_slip|risky_slip)"
    printed = capsys.readouterr().out
    # the arrays of a recording, then the last of its samples one by one
    ends = re.findall(rf"^{states} 0\.\d+ (?:True|False)$", printed, re.MULTILINE)
    assert len(ends) == 2
    assert ends[0] == ends[1]
    assert "cue to act at [" in printed
    assert re.search(rf"^{states} \d+ us$", printed, re.MULTILINE)
    assert "no such model file | export one" in printed


def test_the_file_runs_by_plain_onnxruntime_as_its_page_shows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    page = Path("docs/any-runtime.md").read_text("utf-8")
    ((_, block),) = BLOCK.findall(page)
    assert "holdfast" not in block.replace("models/holdfast-150hz.onnx", "")
    exec(block, {})
    assert f"```text\n{capsys.readouterr().out}```" in page


def test_live_sources_runs_a_recording(follow: Callable[..., str], capsys) -> None:
    follow("live-sources.md")
    assert "its lines ended after 60 samples" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "says", "smaller"),
    [
        ("read-a-recording", "first request to act: ", ("", "")),
        (
            "train-on-your-data",
            "holdfast.onnx: ",
            ('"--trials", "40"', '"--trials", "40", "--rate", "50"'),
        ),
        (
            "from-your-recordings",
            "unseen, this model, as deployed: recall ",
            ('"--rate", "100"', '"--rate", "50"'),
        ),
    ],
    ids=["read-a-recording", "train-on-your-data", "from-your-recordings"],
)
def test_a_notebook_runs_as_a_program(
    name: str,
    says: str,
    smaller: tuple[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """smaller: a text of it -> what is run in its place, with fewer samples a second."""
    monkeypatch.chdir(ROOT)  # a notebook goes to a temporary folder of its own
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    path = ROOT / f"docs/notebooks/{name}.py"
    text = path.read_text("utf-8")
    assert smaller[0] in text
    exec(compile(text.replace(*smaller), path, "exec"), {"__name__": "__main__"})
    printed = capsys.readouterr().out
    assert says in printed
    assert str(ROOT) not in printed
