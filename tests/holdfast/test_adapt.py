"""`holdfast adapt`: the commands of its page run as they stand; too little is refused."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import fails
from conftest import Built
from long_steps import long_steps

from holdfast.core.errors import UsageError
from holdfast.data.datasets import load
from holdfast.data.fixture import write_fixture
from holdfast.edge_runtime.model import Model
from holdfast.sessions.adapt import of_person

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/recording-and-study.md"
RELEASED = ROOT / "models/holdfast-50hz.onnx"
Run = Callable[..., tuple[int, str, str]]


@pytest.mark.filterwarnings("ignore")
def test_the_page_runs_and_the_file_is_one_person_s_until_it_is_undone(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").symlink_to(ROOT / "models")
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    (commands,) = [block for block in blocks if "holdfast adapt" in block]
    with long_steps():
        results = [run(*shlex.split(line)[1:]) for line in commands.splitlines()]
    assert not [result for result in results if result[0] != 0]
    assert "based on 8 hand-overs" in results[2][1]
    assert "0 labels differ from the reference" in results[2][1]
    made = tmp_path / "build/adapt/p01.onnx"
    assert (tmp_path / "build/adapt/base.onnx").read_bytes() == RELEASED.read_bytes()
    card = Model(made).card
    about = card.raw["adaptation"]
    assert about["person"]["hand_overs"] == 8
    assert about["person"]["slips"] == 0
    recall, of_base = (about[name]["recall"] for name in ("held_out", "base_held_out"))
    assert recall >= of_base >= 0.85
    assert "p01" not in json.dumps(about)
    assert set(about["others"]) == {"recordings", "slips"}, (
        "a folder may be named after a person"
    )
    assert "correction" in (made.with_suffix(".json")).read_text("utf-8")
    trial = next((tmp_path / "build/adapt/trials").rglob("pass/trial_1.csv"))
    code, out, _ = run("replay", made, trial)
    assert code == 0
    assert card.model_id in out
    _refused(run, tmp_path)


def _refused(run: Run, folder: Path) -> None:
    """Too few hand-overs, no slips, an existing file: one line that says what to do."""
    few = folder / "few"
    shutil.copytree(folder / "build/adapt/trials", few)
    words = (
        "adapt",
        RELEASED,
        "--data",
        few,
        "--person",
        "p01",
        "--out",
        folder / "few.onnx",
    )
    slips = ("--slips", folder / "build/adapt/slips")
    shutil.rmtree(few / "hard-ball/pass")
    fails(run, 3, "TooLittleToAdapt", *words, *slips, says="6 hand-overs of 8")
    one_sided = (*words, "--slips", folder / "build/adapt/trials")
    fails(run, 3, "TooLittleToAdapt", *one_sided)
    made = folder / "build/adapt/p01.onnx"
    undo = ("adapt", made, "--undo", "--out", made)
    fails(run, 5, "OutputError", *undo, says="is an input")
    again = ("adapt", made, *words[2:], *slips)
    fails(run, 2, "UsageError", *again, says="is adapted already")
    undo = ("adapt", RELEASED, "--undo", "--out", folder / "b.onnx")
    fails(run, 4, "NotAdapted", *undo, says="not adapted")


@pytest.fixture
def slips_as_passes(fixture_folder: Path, tmp_path: Path) -> Path:
    """Trials with objects that no table knows; two in three pulls and falls are filed as passes."""
    out = tmp_path / "person"
    for number, thing in enumerate(sorted(fixture_folder.glob("*-*"))):
        shutil.copytree(thing, out / f"thing-{number}")
    for path in out.glob("*/[pf][ua]l*/trial_[23].*"):
        text = path.read_text().replace("risky_slip", "safe_slip")
        (path.parents[1] / "pass" / path.name.replace("_", "_9")).write_text(text)
        path.unlink()
    shutil.copy(fixture_folder / "meta.json", out)
    return out


def test_a_file_worse_than_its_base_is_not_written(
    run: Run, eight_classes: Built, slips_as_passes: Path, tmp_path: Path
) -> None:
    write_fixture(tmp_path / "slips", trials_per_cell=8, seed=1)
    out = tmp_path / "own.onnx"
    words = ["adapt", eight_classes.model, "--data", slips_as_passes, "--person", "p01"]
    words += ["--slips", tmp_path / "slips", "--out", out]
    code, _, _ = run(*words)
    assert (code, out.exists()) == (4, False)


def test_only_the_named_person_counts(tmp_path: Path, write_people: Path) -> None:
    data = load(write_people, windows="natural")
    own = of_person(data, "p01")
    assert {one.person for one in own.recordings} == {"p01"}
    assert len(own.recordings) < len(data.recordings)
    with pytest.raises(UsageError, match="p07"):
        of_person(data, "p07")


@pytest.fixture
def write_people(tmp_path: Path) -> Path:
    from own_data import write_people_folders

    return write_people_folders(tmp_path / "people")
