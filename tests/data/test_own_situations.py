"""Own trials train a model of whatever situations and weights they have, and it says the rest."""

from __future__ import annotations

import io
import json
import math
import shutil
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import Run
from made_prediction import prediction
from own_data import write_meta, write_phases

from holdfast.cli.main import main
from holdfast.core.contract import GRASP, RISKY_SLIP, SAFE_SLIP, channel_names
from holdfast.core.trial_layout import truth_path
from holdfast.data.datasets import load
from holdfast.data.datasets.eflesh_slip import SIX_MAGNETOMETERS
from holdfast.data.datasets.joining import join
from holdfast.data.datasets.public_files import channels_of
from holdfast.data.recording import cannot_tell, learnable
from holdfast.drivers.lsl import DECISION, decision_row


def trained(run: Run, data: Path, out: Path, *words: str) -> tuple[str, dict]:
    code, said, _ = run("train", "--data", data, "--out", out, "--size", "tiny", *words)
    assert code == 0
    artifact: dict = json.loads((out / "artifact.json").read_text())
    return said, artifact["training"]


def test_a_weight_that_a_situation_gives_away_is_not_learned(tmp_path: Path) -> None:
    write_meta_of(tmp_path, {"cup": 20, "jar": 400})
    write_phases(tmp_path / "cup/pull/trial_1.csv", "grasp", "risky_slip")
    write_phases(tmp_path / "jar/hold/trial_1.csv", "grasp")
    data = load(tmp_path)
    assert list(data.tasks) == ["classes"]
    learned = learnable(data)
    assert list(learned.tasks) == ["situations"]
    assert len(learned.tasks["situations"]) == len(data.tasks["classes"])
    not_learned = cannot_tell(learned, by_force=False)
    assert set(not_learned) == {"nothing", "safe_slip", "weight"}
    # In N the contact rule tells an empty hand from a closed one, which no window shows.
    assert set(cannot_tell(learned, by_force=True)) == {"safe_slip", "weight"}


def write_meta_of(root: Path, masses_g: dict[str, float]) -> None:
    root.mkdir(exist_ok=True)
    write_meta(root, unit="N", masses_g=masses_g)


def test_a_set_with_weights_and_one_without_are_learned_together(
    tmp_path: Path,
) -> None:
    write_meta_of(tmp_path / "known", {"cup": 20})
    write_phases(tmp_path / "known/cup/pull/trial_1.csv", "grasp", "risky_slip")
    write_phases(tmp_path / "other/jar/pass/trial_1.csv", "grasp", "safe_slip")
    both = join([load(tmp_path / "known"), load(tmp_path / "other")])
    counts = both.tasks["situations"].class_counts()
    assert [name for name, count in counts.items() if count] == [
        "grasp",
        "safe_slip",
        "risky_slip",
    ]


# -- trials labelled slip or hold as a whole


def test_without_times_a_hold_is_grasp_and_a_slip_lies_about_the_largest_change(
    tmp_path: Path,
) -> None:
    t_s = np.arange(0.0, 6.0, 0.02)
    force = np.interp(t_s, [1.0, 1.2, 4.0, 4.1, 5.0, 5.1], [0, 5, 5, 4, 4, 0])
    shear = np.interp(t_s, [4.0, 4.1], [0.0, 6.0]) * (force > 0.0)
    shear[t_s > 4.9] *= np.linspace(1.0, 0.0, int((t_s > 4.9).sum()))
    rows = np.column_stack([t_s, shear, 0.0 * t_s, force])
    for action in ("hold", "slip"):
        path = tmp_path / f"cup/{action}/trial_1.csv"
        path.parent.mkdir(parents=True)
        np.savetxt(path, rows, delimiter=",", header="Time,X1,Y1,Z1", comments="")
    hold, slip = (one.phases for one in load(tmp_path, windows="none").recordings)
    (held,) = hold
    assert held.situation == GRASP
    assert (held.first / 50, held.stop / 50) == pytest.approx((1.0, 5.1), abs=0.15)
    (slipped,) = slip
    assert slipped.situation == RISKY_SLIP
    assert slipped.first / 50 == pytest.approx(3.95, abs=0.1)
    assert slipped.stop / 50 == pytest.approx(4.35, abs=0.1)
    assert "object slipped is not known in 1 of 2 trials" in load(tmp_path).caveat
    of_hold, of_slip = (one.events for one in load(tmp_path, windows="none").recordings)
    assert of_hold == ()
    # The slip is somewhere in the trial, so an alarm anywhere is right, and none has a delay.
    (event,) = of_slip
    assert (event.onset_s, event.timed) == (0.0, False)
    assert event.end_s == pytest.approx(6.0)
    # A time that is known is believed before the guess.
    truth = truth_path(tmp_path / "cup/slip/trial_1.csv")
    phases = [{"t0_s": 2.0, "t1_s": 2.5, "label": "risky_slip"}]
    truth.write_text(json.dumps({"phases": phases}))
    _, timed = (one.phases for one in load(tmp_path, windows="none").recordings)
    assert [(one.first / 50, one.stop / 50) for one in timed] == [(2.0, 2.5)]


@pytest.fixture(scope="module")
def gripper(
    tmp_path_factory: pytest.TempPathFactory, real_set: Callable[[str], Path]
) -> Path:
    """Every third real trial of the two-pad gripper in folders, slip or hold, without a time."""
    root = tmp_path_factory.mktemp("gripper")
    with np.load(real_set("eflesh_slip") / "eflesh_slip.npz") as arrays:
        values = arrays["X"][::3][:, :, channels_of(SIX_MAGNETOMETERS)]
        tugged = arrays["y"][::3]
    header = ",".join(["Time", *channel_names(6)])
    for number, (trial, tug) in enumerate(zip(values, tugged, strict=True)):
        action = "slip" if tug else "hold"
        path = root / f"block-{number // 4}" / action / f"trial_{number}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        rows = np.column_stack([np.arange(len(trial)) / 100.0, trial])
        np.savetxt(path, rows, "%.6g", ",", header=header, comments="")
    write_meta(root, unit="uT")
    return root


@dataclass(frozen=True)
class Gripper:
    """The trials, the model that was trained on them, and what train printed."""

    data: Path
    folder: Path
    said: str
    card: dict


@pytest.fixture(scope="module")
def of_gripper(gripper: Path, tmp_path_factory: pytest.TempPathFactory) -> Gripper:
    folder = tmp_path_factory.mktemp("of-gripper") / "model"
    words = ["--data", str(gripper), "--out", str(folder), "--size", "tiny"]
    said = io.StringIO()
    with redirect_stdout(said), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        report = ["--report", str(folder.with_name("report.html"))]
        assert main(["train", *words, "--learner", "forest", *report]) == 0
    card = json.loads((folder / "holdfast.json").read_text())["training"]
    return Gripper(gripper, folder, said.getvalue(), card)


def test_real_trials_of_a_gripper_labelled_slip_or_hold_train(
    run: Run, of_gripper: Gripper
) -> None:
    code, checked, _ = run("check", of_gripper.data)
    assert (code, "ready for holdfast train" in checked) == (0, True)
    said, card = of_gripper.said, of_gripper.card
    assert set(card["cannot_tell"]) == {"nothing", "safe_slip", "weight"}
    f1 = card["held_out"]["situations"]["f1"]
    assert f1["nothing"] is None
    # An easy set: one threshold is right in nearly every trial.
    assert min(f1["grasp"], f1["risky_slip"]) > 0.8
    assert "cannot tell nothing: no empty hand in the training data" in said


def test_a_model_has_no_figure_for_a_situation_that_the_set_has_and_it_cannot_tell(
    run: Run, of_gripper: Gripper, tmp_path: Path
) -> None:
    trial = next(of_gripper.data.rglob("hold/trial_*.csv"))
    place = tmp_path / "jar/hold/trial_1.csv"
    place.parent.mkdir(parents=True)
    shutil.copy(trial, place)
    phases = [
        {"t0_s": 0.0, "t1_s": 2.0, "label": "grasp"},
        {"t0_s": 2.0, "t1_s": 3.0, "label": "safe_slip"},
    ]
    truth_path(place).write_text(json.dumps({"phases": phases}))
    write_meta(tmp_path, unit="uT")
    model, figures = of_gripper.folder / "holdfast.onnx", tmp_path / "figures.json"
    run("evaluate", model, "--data", tmp_path, "--json", figures)
    found = json.loads(figures.read_text())
    assert found["model"]["cannot_tell"] == of_gripper.card["cannot_tell"]
    four = next(iter(found["sets"].values()))["states"]["confusion"]["four"]
    assert four["f1"]["safe_slip"] is None
    assert sum(four["counts"][SAFE_SLIP]) > 0
    assert four["macro_f1"] == four["f1"]["grasp"]


def test_run_and_replay_name_what_is_unknown_and_give_it_no_probability(
    run: Run, of_gripper: Gripper
) -> None:
    trial = next(of_gripper.data.rglob("slip/trial_*.csv"))
    model = of_gripper.folder / "holdfast.onnx"
    for words in (
        ("run", model, "--source", f"replay://{trial}"),
        ("replay", model, trial),
    ):
        code, out, err = run(*words)
        assert code == 0
        assert "cannot tell safe slip: no voluntary release in the training" in err
        p = json.loads(out.splitlines()[-1])["p_situation"]
        assert (p["nothing"], p["safe_slip"]) == (None, None)
        assert p["grasp"] + p["risky_slip"] == pytest.approx(1.0, abs=1e-5)


def test_a_stream_has_nan_for_what_is_unknown() -> None:
    sent = dict(zip(DECISION, decision_row(prediction(), ["safe_slip"]), strict=True))
    assert math.isnan(sent["p_safe_slip"])
    assert (sent["p_grasp"], sent["p_risky"]) == (1.0, 0.0)
    assert math.isnan(decision_row(prediction(), ["risky_slip"])[5])
