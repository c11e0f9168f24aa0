"""Holds with less force than the contact rule needs: counted apart, and dropped nowhere."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from holdfast.cli.main import main
from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, FloatArray
from holdfast.edge_runtime.model_file import CONTACT_KEY, ModelCard
from holdfast.edge_runtime.monitor import Model
from holdfast.evaluation.contact_floor import BelowFloor, below_floor, light_holds
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.training.recording import Recording
from holdfast.training.timeline import Phase, RiskyEvent

if TYPE_CHECKING:
    from conftest import Built

RATE_HZ = 100.0
FLOOR_N = 0.2
PHASES = Phase(0, 100, NOTHING), Phase(100, 200, GRASP), Phase(200, 220, RISKY_SLIP)
EVENT = RiskyEvent(2.0, 2.1, 2.2)
TRIAL = "soft-ball/pull/trial_1"


def hold(
    newton: float, noise: float = 0.0, phases: tuple[Phase, ...] = PHASES
) -> Recording:
    """Nothing, then two fingers that together read so much, of which one slips, then nothing."""
    samples = noise * np.random.default_rng(1).standard_normal((300, 18))
    samples[100:220, [2, 5]] += newton / np.sqrt(2.0)
    valid = np.ones((300, 6), dtype=bool)
    return Recording(
        "a", "a", samples, valid, RATE_HZ, "N", "soft-ball", "pull", phases, (EVENT,)
    )


def answered(recording: Recording, called_nothing: int) -> ModelOutputs:
    """So many of the samples from the hold's first one on are called nothing, then grasp."""
    n = len(recording.samples)
    situation = np.full(n, GRASP)
    situation[: 100 + called_nothing] = NOTHING
    none = np.zeros(n, dtype=np.int64)
    p: FloatArray = np.zeros((n, 4))
    return ModelOutputs(
        recording,
        situation=situation,
        risky_permille=none,
        p_situation=p.astype(np.float32),
        eight=none,
        seven=none,
        detectors=np.zeros((n, 3), dtype=bool),
    )


@pytest.fixture(scope="module")
def card(eight_classes: Built) -> ModelCard:
    return Model(eight_classes.model).card


def test_a_hold_is_light_by_its_force_whatever_the_noise_and_the_pull_at_its_end() -> (
    None
):
    assert light_holds(hold(0.15), FLOOR_N) == [(100, 220)]
    assert light_holds(hold(0.25), FLOOR_N) == []
    # the length of this noise alone is 0.25 N
    assert light_holds(hold(0.15, noise=0.06), FLOOR_N) == [(100, 220)]
    slips_long = Phase(100, 150, GRASP), Phase(150, 220, RISKY_SLIP)
    pulled = hold(0.15, phases=slips_long)
    pulled.samples[150:220, 0] = 3.0
    assert light_holds(pulled, FLOOR_N) == [(100, 220)]


def test_a_lost_finger_does_not_count_and_a_hand_that_reads_nothing_is_not_judged() -> (
    None
):
    lost = hold(0.15)
    lost.samples[:, 15:] = np.nan
    lost.valid[:, 5] = False
    assert light_holds(lost, FLOOR_N) == [(100, 220)]
    lost.valid[:] = False
    assert light_holds(lost, FLOOR_N) == []


def test_a_hold_that_fails_at_once_and_one_to_the_last_sample_are_holds() -> None:
    falls = Phase(0, 100, NOTHING), Phase(100, 200, RISKY_SLIP)
    assert light_holds(hold(0.15, phases=falls), FLOOR_N) == [(100, 200)]
    whole = (Phase(0, 300, GRASP),)
    assert light_holds(hold(0.15, phases=whole), FLOOR_N) == [(0, 300)]


def test_only_light_holds_are_counted_with_their_samples_and_slips(
    card: ModelCard,
) -> None:
    outputs = [
        answered(hold(0.15), 90),
        answered(hold(0.1), 60),
        answered(hold(2.0), 30),
    ]
    found = np.zeros(300, dtype=bool)
    found[205:215] = True
    row = below_floor(card, outputs, [found, np.zeros(300, dtype=bool), found])
    assert row is not None
    assert (row.floor, row.trials, row.holds) == (FLOOR_N, 2, 2)
    assert (row.samples, row.called_nothing) == (240, 150)
    assert row.slips_found.n == 2
    assert row.slips_found.share == 0.5
    words = row.in_words()
    assert "2 of them in 2 trials, 0.625 of 240 samples called nothing" in words
    assert "1 of 2 slips found; all other figures include them" in words


def test_no_row_without_a_light_hold_or_without_a_contact_rule(card: ModelCard) -> None:
    none = [np.zeros(300, dtype=bool)]
    assert below_floor(card, [answered(hold(2.0), 0)], none) is None
    light = [answered(hold(0.1), 120)]
    assert isinstance(below_floor(card, light, none), BelowFloor)
    learned = replace(card, raw={**card.raw, CONTACT_KEY: None})
    assert below_floor(learned, light, none) is None
    without = {key: value for key, value in card.raw.items() if key != CONTACT_KEY}
    assert below_floor(replace(card, raw=without), light, none) is None


def test_the_evaluation_shows_the_row_in_all_its_forms_and_counts_its_slips_as_ever(
    eight_classes: Built, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, gain in (("firm", 1.0), ("light", 0.01)):
        weaker(eight_classes.fixture, tmp_path / name, gain)
    words = [
        "evaluate",
        eight_classes.model,
        "--data",
        tmp_path / "firm",
        tmp_path / "light",
    ]
    words += ["--json", tmp_path / "f.json", "--report", tmp_path / "r.html"]
    words += ["--real", tmp_path / "nowhere"]
    assert main([str(word) for word in words]) == 0

    figures = json.loads((tmp_path / "f.json").read_text())
    firm, light = figures["sets"].values()
    assert "below_contact_floor" not in firm
    row = light["below_contact_floor"]
    assert (row["trials"], row["holds"]) == (1, 1)
    assert row["share_called_nothing"] > 0.5
    assert row["slips_found"] == {"share": 0.0, "share_ci": [0.0, 0.975], "n": 1}
    # missed, and so in the overall figures too
    assert figures["all"]["rows"]["ours, as deployed"]["events"] == 2
    said = capsys.readouterr().out
    assert said.count("below the contact floor (0.2 N): 1 of them in 1 trial,") == 1
    page = (tmp_path / "r.html").read_text()
    assert page.count("Below the contact floor") == 1


def weaker(source: Path, target: Path, gain: float) -> None:
    """A set of one pull, whose readings are so much smaller."""
    (target / TRIAL).parent.mkdir(parents=True)
    shutil.copy(f"{source / TRIAL}.truth.json", f"{target / TRIAL}.truth.json")
    csv = Path(f"{source / TRIAL}.csv")
    heads, *rows = csv.read_text().splitlines()
    values = np.array([row.split(",") for row in rows], dtype=np.float64)
    values[:, 1:] *= gain
    out = f"{target / TRIAL}.csv"
    np.savetxt(out, values, "%.6f", delimiter=",", header=heads, comments="")
