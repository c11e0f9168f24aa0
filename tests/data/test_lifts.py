"""Lifts in which nothing slips teach by contact alone, in any unit; what is unclear is asked."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, fails
from foreign_logs import axes

from holdfast.core.contract import GRASP, NOTHING, FloatArray, Unit
from holdfast.core.errors import LabelError
from holdfast.core.trial_layout import META, truth_path
from holdfast.data.datasets import load
from holdfast.data.lifts import lift_phases
from holdfast.data.timeline import Phase

RATE_HZ = 100.0
HELD_S = ((1.0, 2.5), (4.0, 5.5), (7.0, 8.5))
"""When the hand holds something."""
UNITS: dict[Unit, float] = {"N": 1.0, "uT": 150.0, "count": 900.0}
"""What a newton reads."""


def lifts(
    unit: Unit = "N", held_s: tuple[tuple[float, float], ...] = HELD_S
) -> FloatArray:
    """[T, 6] ten seconds of two fingertips that lift: load along y, grip along z, noise."""
    t_s = np.arange(1000) / RATE_HZ
    n = 0.01 * np.random.default_rng(4).normal(size=(1000, 2, 3))
    for begin_s, end_s in held_s:
        n[(t_s >= begin_s) & (t_s < end_s)] += [0.0, 1.2, 3.0]
    return UNITS[unit] * n.reshape(1000, 6)


def phases_of(samples: FloatArray, unit: Unit = "N") -> tuple[Phase, ...]:
    valid = np.ones((len(samples), 2), np.bool_)
    return lift_phases(samples, valid, RATE_HZ, unit, "trial")


@pytest.mark.parametrize("unit", UNITS)
def test_each_lift_is_a_grasp_and_the_hand_is_empty_between_them(unit: Unit) -> None:
    phases = phases_of(lifts(unit), unit)
    situations = [one.situation for one in phases]
    assert situations == [NOTHING, *[GRASP, NOTHING] * len(HELD_S)]
    for phase, (begin_s, end_s) in zip(phases[1::2], HELD_S, strict=True):
        # the mean of the contact rule lags
        assert 0.0 <= phase.first / RATE_HZ - begin_s <= 0.03
        assert 0.0 <= phase.stop / RATE_HZ - end_s <= 0.25
    assert (phases[0].first, phases[-1].stop) == (0, 1000)


def test_noise_and_drift_of_another_unit_are_no_contact() -> None:
    drift = np.linspace(0.0, 40.0, 1000)[:, None]
    loud = (
        lifts("count") + drift + 8.0 * np.random.default_rng(5).normal(size=(1000, 6))
    )
    grasps = [one for one in phases_of(loud, "count") if one.situation == GRASP]
    assert len(grasps) == len(HELD_S)
    # readings in whole steps rest without noise
    steps = np.rint(lifts("count") / 100.0)
    grasps = [one for one in phases_of(steps, "count") if one.situation == GRASP]
    assert len(grasps) == len(HELD_S)


@pytest.mark.parametrize("unit", UNITS)
def test_no_contact_and_one_from_the_start_on_are_asked(unit: Unit) -> None:
    with pytest.raises(
        LabelError, match=r"no contact found: nothing above .*\.truth\.json"
    ):
        phases_of(lifts(unit, ()), unit)
    early = lifts(unit, ((0.3, 2.0), (4.0, 5.0)))
    with pytest.raises(LabelError, match=r"first 0\.5 s|no contact found"):
        phases_of(early, unit)
    with pytest.raises(LabelError, match=r"touches something in the first 0\.5 s"):
        phases_of(lifts("N", ((0.3, 2.0),)))


def test_rows_at_which_the_hand_is_lost_have_no_label() -> None:
    samples, valid = lifts(), np.ones((1000, 2), np.bool_)
    valid[480:520] = False
    labelled = np.zeros(1000, np.bool_)
    for phase in lift_phases(samples, valid, RATE_HZ, "N", "trial"):
        labelled[phase.first : phase.stop] = True
    # until the history is whole again
    assert not labelled[483:560].any()
    assert labelled[:480].all()
    assert labelled[575:].all()


def write_set(root: Path, unit: Unit, samples: FloatArray) -> Path:
    path = root / "p01/mug/lift/trial_1.csv"
    path.parent.mkdir(parents=True)
    table = np.column_stack([np.arange(len(samples)) / RATE_HZ, samples])
    header = "Time,X1,Y1,Z1,X2,Y2,Z2"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.6g")
    about = {"unit": unit, "masses_g": {"mug": 300}}
    (root / META).write_text(json.dumps(about), "utf-8")
    return path


@pytest.mark.parametrize("unit", UNITS)
def test_a_folder_of_lifts_teaches_and_check_names_the_limit_of_another_unit(
    run: Run, tmp_path: Path, unit: Unit
) -> None:
    write_set(tmp_path / "own", unit, lifts(unit))
    (recording,) = (data := load(tmp_path / "own")).recordings
    assert len([one for one in recording.phases if one.situation == GRASP]) == 3
    assert recording.events == ()
    counts = data.tasks["classes"].class_counts()
    assert counts["grasp_heavy"] >= 5
    assert counts["nothing_heavy"] >= 5
    code, out, _ = run("check", tmp_path / "own")
    assert code == 0
    assert "its folder, by contact" in out
    named = "contact in 1 trial of lifts is what exceeds"
    assert (named in out) == (unit != "N")
    if unit != "N":
        noise = 0.01 * UNITS[unit] * np.sqrt(6.0)
        limit = float(out.split(named)[1].split()[0])
        assert limit == pytest.approx(6.0 * noise, rel=0.1)
        assert "6 times the noise of the first rest" in out


def test_a_truth_goes_before_contact_but_for_the_recorders_rule(tmp_path: Path) -> None:
    path = write_set(tmp_path / "own", "N", lifts())
    whole = {"t0_s": 1.0, "t1_s": 8.5, "label": "grasp"}
    for provenance, grasps in (("video", 1), ("rule", 3)):
        phases = {"phases": [{**whole, "provenance": provenance}]}
        truth_path(path).write_text(json.dumps(phases), "utf-8")
        (recording,) = load(tmp_path / "own").recordings
        found = [one for one in recording.phases if one.situation == GRASP]
        assert len(found) == grasps


@pytest.fixture
def log(tmp_path: Path) -> Callable[[FloatArray], Path]:
    """Writes a log of lifts of another program; its folder."""

    def write(samples: FloatArray) -> Path:
        folder = tmp_path / "logs"
        folder.mkdir(exist_ok=True)
        rows = np.column_stack([1e3 * np.arange(len(samples)) / RATE_HZ, samples])
        header = ",".join(["millis", *axes(2)])
        path = folder / "p01_mug_lift_1.csv"
        np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.6g")
        return folder

    return write


def test_import_keeps_a_lift_a_lift_and_asks_where_its_forces_do_not_tell(
    run: Run, tmp_path: Path, log: Callable[[FloatArray], Path]
) -> None:
    words = ("--unit", "N", "--action", "lift", "--yes", "--out", tmp_path / "set")
    code, out, err = run("import", log(lifts()), *words)
    assert code == 0, out + err
    assert "1 lift" in out
    (recording,) = load(tmp_path / "set").recordings
    assert recording.action == "lift"
    assert len([one for one in recording.phases if one.situation == GRASP]) == 3

    words = (*words[:-1], tmp_path / "other")
    early = log(lifts("N", ((0.2, 3.0), (5.0, 6.0))))
    fails(run, 3, "LabelError", "import", early, *words, says="lift=hold")
    assert not (tmp_path / "other").exists()
