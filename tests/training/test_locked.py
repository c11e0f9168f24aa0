"""Sets that no choice may see are recognised, and refused by what chooses."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path

import pytest

from holdfast.core.errors import SetLocked
from holdfast.core.locked import Style, lock_of, locked_sets
from holdfast.core.progress import Stages, ignored
from holdfast.evaluation.evaluate import EvaluationRequest, evaluate_events
from holdfast.sessions.adapt import adapt_file
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.training.fitting import TrainingRequest, train_on_sets

MODEL = Path("models/holdfast-150hz.onnx")
SHARED_CONTROL = Path("studies/shared_control/cards")


def a_set(folder: Path, name: str = "thesis", seed: int = 7001, sha: str = "0") -> Path:
    """A folder with the meta.json of a simulated set."""
    folder.mkdir(parents=True)
    meta = {"name": name, "card_sha256": sha, "seed": seed, "kind": "simulated"}
    (folder / "meta.json").write_text(json.dumps(meta))
    return folder


@pytest.mark.parametrize("seed", [7000, 7999, 8000, 8999])
def test_a_locked_seed_is_locked_for_every_scene(tmp_path: Path, seed: int) -> None:
    folder = a_set(tmp_path / "set", "my-scene", seed)
    assert str(seed) in lock_of(folder)


@pytest.mark.parametrize("seed", [0, 100, 199, 6999, 9000])
def test_other_seeds_are_open(tmp_path: Path, seed: int) -> None:
    assert lock_of(a_set(tmp_path / "set", seed=seed)) == ""


@pytest.mark.parametrize(
    ("seed", "day"),
    [
        (7001, 23),
        (7101, 28),
        (7102, 28),
        (7103, 29),
        (8001, 23),
        (8102, 28),
        (8103, 29),
    ],
)
def test_a_locked_seed_tells_since_when(tmp_path: Path, seed: int, day: int) -> None:
    """Of two entries that have it, the later one is about it."""
    locked = locked_sets().lock_of_seed(seed)
    assert locked is not None
    assert locked.locked_on == date(2026, 11, day)
    told = lock_of(a_set(tmp_path / "set", seed=seed))
    assert f"since 2026-11-{day}" in told
    assert locked.about in told


def test_a_style_is_locked_at_every_seed_by_name_and_content(tmp_path: Path) -> None:
    styles = locked_sets().styles
    (sha,) = [one.sha256 for one in styles if one.scene == "quick"]
    assert "quick" in lock_of(a_set(tmp_path / "a", "quick", seed=100))
    assert "quick" in lock_of(a_set(tmp_path / "b", "renamed", seed=100, sha=sha))
    assert lock_of(a_set(tmp_path / "c", "quick", seed=100), styles=False) == ""


@pytest.mark.parametrize("name", ["p1", "p2", "quick", "slow"])
def test_the_locked_styles_are_the_scenes_as_they_are_now(name: str) -> None:
    """Otherwise a copy of the scene under another name would be open."""
    path = SHARED_CONTROL / f"{name}.toml"
    scene = read_scene_file(str(path) if path.is_file() else name)
    assert Style(name, scene.sha256) in locked_sets().styles


def test_a_part_of_a_locked_set_is_locked(tmp_path: Path) -> None:
    action = a_set(tmp_path / "set") / "soft-ball" / "pull"
    action.mkdir(parents=True)
    assert lock_of(action)
    assert lock_of(action.parent)


def test_recordings_copied_out_of_a_locked_set_are_locked(tmp_path: Path) -> None:
    truth = {"card": "thesis", "card_sha256": "0", "seed": 7001, "phases": []}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "trial_1.truth.json").write_text(json.dumps(truth))
    assert lock_of(tmp_path / "mine")


def test_recorded_data_are_open_whatever_their_keys_are(tmp_path: Path) -> None:
    (tmp_path / "meta.json").write_text(json.dumps({"name": "p1", "seed": 7001}))
    assert lock_of(tmp_path) == ""


def test_training_refuses_a_locked_set_before_it_reads_one(tmp_path: Path) -> None:
    folder = a_set(tmp_path / "set")
    request = TrainingRequest(data=(str(folder),), out=tmp_path / "out")
    with pytest.raises(SetLocked, match="a model may not see"):
        train_on_sets(request, Stages(), ignored)


def test_an_adaptation_refuses_a_locked_seed(tmp_path: Path) -> None:
    folder = str(a_set(tmp_path / "set", "p1"))
    with pytest.raises(SetLocked, match="seed 7001"):
        adapt_file(MODEL, folder, "p1", folder, tmp_path / "a.onnx", Stages())


@pytest.mark.parametrize("option", ["choose", "train"])
def test_an_evaluation_chooses_on_no_locked_set(tmp_path: Path, option: str) -> None:
    locked = str(a_set(tmp_path / "locked"))
    scored = str(a_set(tmp_path / "scored", seed=7002))
    request = EvaluationRequest(data=(scored,))
    if option == "choose":
        request = EvaluationRequest(data=(scored,), choose=(locked,))
    if option == "train":
        request = EvaluationRequest(data=(scored,), train=locked)
    with pytest.raises(SetLocked, match="seed 7001"):
        evaluate_events(MODEL, request)  # type: ignore[arg-type]
