"""What the simulation is worth: the parts of the study on tiny made sets, and its page."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_model
from page_tables import filled

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, SAFE_SLIP, SITUATIONS
from holdfast.edge_runtime.preparation import Preparation
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import load
from holdfast.training.recording import DataSet, LabelledRows, Recording
from holdfast.training.timeline import Phase, RiskyEvent
from studies.transfer import domain, statistics, tables, traces, tugs
from studies.transfer.levels import at_level, levels
from studies.transfer.people import (
    AS_RECORDED,
    OWN_LEVEL,
    REAL_ONLY,
    prediction_rows,
    reported_on,
)
from studies.transfer.pictures import PICTURES
from studies.transfer.scene_sets import (
    CHIP_NOISE,
    COMPARED,
    PINCH_SPREAD,
    SHIPPED,
    SceneSet,
    card_text,
    without_chip_noise,
)

RATE_HZ = 60.0
ONE_PAD = [[0, 1]]


def recording(samples: np.ndarray, name: str = "a", **more: Any) -> Recording:
    """A trial of two sensors."""
    valid = np.ones((len(samples), samples.shape[1] // 3), np.bool_)
    return Recording(name, name, samples, valid, RATE_HZ, "N", **more)


def held(
    grip_n: float, shear_n: float, noise_n: float = 0.0, seed: int = 0
) -> Recording:
    """A second of nothing, then four of holding with this grip and shear, both summed."""
    samples = np.zeros((300, 6))
    samples[60:, 2::3] = grip_n / 2
    samples[60:, 0::3] = shear_n / 2
    samples += noise_n * np.random.default_rng(seed).normal(size=samples.shape)
    phases = (Phase(0, 60, NOTHING), Phase(60, 300, GRASP))
    return recording(samples, f"t{seed}", phases=phases)


def set_of(
    recordings: list[Recording], tasks: dict[str, LabelledRows] | None = None
) -> DataSet:
    return DataSet(
        name="made",
        recordings=recordings,
        tasks=tasks or {},
        rate_hz=RATE_HZ,
        unit=recordings[0].unit,
        preparation=Preparation(bias_rows=5),
        kind="made",
        redistributable=True,
        caveat="",
    )


def windows(features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of features, and a group for every ten of them."""
    return features.astype(np.float32), np.repeat(
        [f"g{k}" for k in range(len(features) // 10)], 10
    )


@pytest.fixture
def small_forest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(domain, "FOREST", replace(domain.FOREST, n_estimators=10))


@pytest.mark.usefixtures("small_forest")
def test_two_samples_of_the_same_are_not_told_apart_and_a_shift_is() -> None:
    rng = np.random.default_rng(0)
    first, groups = windows(rng.normal(size=(200, 4)))
    alike, others = windows(rng.normal(size=(200, 4)))
    shifted = (alike + np.float32(4.0)).astype(np.float32)
    same = domain.told_apart(first, alike, (groups, others), seed=0).auc
    apart = domain.told_apart(first, shifted, (groups, others), seed=0).auc
    assert same is not None
    assert apart is not None
    assert 0.35 < same < 0.65
    assert apart > 0.99


@pytest.mark.usefixtures("small_forest")
def test_a_group_that_names_itself_does_not_tell_the_sides_apart() -> None:
    """A feature that is the group's own number would be learned by heart in a split of windows."""
    rng = np.random.default_rng(1)
    marks = np.repeat(rng.normal(size=(40, 1)), 10, axis=0)
    first, groups = windows(marks[:200])
    second, others = windows(marks[200:])
    found = domain.told_apart(first, second, (groups, others), seed=0).auc
    assert found is not None
    assert found < 0.8


def test_the_same_number_of_windows_of_each_situation_is_drawn_from_both() -> None:
    label = np.repeat([NOTHING, GRASP, SAFE_SLIP, RISKY_SLIP], [30, 20, 40, 10])
    rows = LabelledRows(np.zeros(100, np.int64), np.arange(100), label, SITUATIONS)
    more = rows.take(np.arange(100) % 2 == 0)
    trial = recording(np.zeros((100, 6)))
    sets = [set_of([trial], {"situations": one}) for one in (rows, more)]
    counts = domain.counts_of(sets)
    assert counts == {NOTHING: 15, GRASP: 10, RISKY_SLIP: 5}
    for one in sets:
        taken = domain.drawn(one, counts, seed=0).tasks["situations"].label
        assert np.bincount(taken).tolist() == [15, 10, 0, 5]


def test_a_hold_gives_its_grip_and_the_shear_over_it_whichever_way_the_sensors_turn() -> (
    None
):
    trial = held(grip_n=10.0, shear_n=4.0)
    turned = trial.samples.copy()
    turned[:, 1::3], turned[:, 0::3] = trial.samples[:, 0::3], 0.0
    for samples in (trial.samples, turned):
        found = statistics.statistics(
            set_of([replace(trial, samples=samples)]), ONE_PAD
        )
        assert found["grip_n"] == pytest.approx([10.0])
        assert found["shear_over_normal"] == pytest.approx([0.4])
        assert found["load_rate_n_s"] == pytest.approx([0.0])
        assert found["noise_shear_mn"] == pytest.approx([0.0] * 4)


def test_opposite_shear_on_two_sides_of_a_grip_adds_up() -> None:
    trial = held(grip_n=10.0, shear_n=0.0)
    trial.samples[60:, 0], trial.samples[60:, 3] = 2.0, -2.0
    one_pad = statistics.statistics(set_of([trial]), [[0, 1]])
    two_sides = statistics.statistics(set_of([trial]), [[0], [1]])
    assert one_pad["shear_over_normal"] == pytest.approx([0.0])
    assert two_sides["shear_over_normal"] == pytest.approx([0.4])


def test_noise_is_that_of_the_open_hand_and_drift_is_not_in_it() -> None:
    trial = held(10.0, 0.0, noise_n=0.005, seed=3)
    trial.samples[:60] += np.linspace(0.0, 0.1, 60)[:, None]
    found = statistics.statistics(set_of([trial]), ONE_PAD)
    assert np.median(found["noise_shear_mn"]) == pytest.approx(5.0, rel=0.4)
    assert len(found["noise_normal_mn"]) == 2


def test_a_tremor_of_8_hz_is_in_the_band_and_a_sway_of_1_hz_is_not() -> None:
    t_s = np.arange(300) / RATE_HZ
    tremor = statistics.rms_in_band(np.sin(2 * np.pi * 8 * t_s), RATE_HZ)
    sway = statistics.rms_in_band(np.sin(2 * np.pi * 1 * t_s), RATE_HZ)
    assert tremor == pytest.approx(np.sqrt(0.5), rel=0.1)
    assert sway < 0.05


def test_a_load_that_rises_after_the_grip_is_gone_is_no_load_rate() -> None:
    trial = held(10.0, 0.0)
    trial.samples[200:, 0] = 3.0
    pulled = statistics.statistics(set_of([trial]), ONE_PAD)["load_rate_n_s"]
    trial.samples[195:, 2::3] = 0.0
    lost = statistics.statistics(set_of([trial]), ONE_PAD)["load_rate_n_s"]
    assert pulled == pytest.approx([30.0])
    assert lost == pytest.approx([0.0])


def test_the_table_says_which_end_of_the_real_spread_no_scene_covers() -> None:
    rows = [
        *statistics.spread_rows("people", True, {"grip_n": [1.0, 5.0, 30.0]}),
        *statistics.spread_rows("low", False, {"grip_n": [0.0, 4.0, 8.0]}),
        *statistics.spread_rows("high", False, {"grip_n": [4.0, 20.0, 22.0]}),
    ]
    (verdict,) = statistics.within(rows)
    assert (verdict["p5_within"], verdict["p95_within"]) == (True, False)
    assert verdict["by_one_scene"] == []


def test_scenes_on_both_sides_of_a_real_spread_do_not_cover_it() -> None:
    rows = statistics.spread_rows("people", True, {"noise_shear_mn": [2.0, 3.0, 4.0]})
    for name, values in (("none", [0.0, 0.0]), ("much", [9.0, 15.0])):
        rows += statistics.spread_rows(name, False, {"noise_shear_mn": values})
    (verdict,) = statistics.within(rows)
    assert (verdict["p5_within"], verdict["p95_within"]) == (False, False)


def test_people_at_the_level_of_scenes_have_their_grip_and_keep_their_ratios() -> None:
    weak, strong = held(2.0, 1.0, seed=1), held(20.0, 4.0, seed=2)
    data = at_level(set_of([weak, strong]), 8.0)
    assert levels(data, by_group=True) == pytest.approx({"t1": 8.0, "t2": 8.0})
    found = statistics.statistics(data, ONE_PAD)
    assert found["shear_over_normal"] == pytest.approx([0.5, 0.2])


def test_a_row_is_asked_for_gross_slip_in_the_next_quarter_second() -> None:
    phases = (
        Phase(0, 60, NOTHING),
        Phase(60, 200, GRASP),
        Phase(200, 240, RISKY_SLIP),
        Phase(240, 300, NOTHING),
    )
    event = RiskyEvent(200 / RATE_HZ, 210 / RATE_HZ, 240 / RATE_HZ)
    trial = recording(np.zeros((300, 6)), phases=phases, events=(event,))
    row, label = prediction_rows(trial)
    assert row.min() >= 60
    assert row.max() < 210
    assert row[label == 1].tolist() == [195, 198, 201, 204, 207]


def test_a_scene_becomes_clips_that_begin_in_the_grip() -> None:
    rate_hz = 100.0
    samples = np.ones((900, 6))
    phases = (Phase(0, 500, GRASP), Phase(500, 560, RISKY_SLIP))
    pulled = replace(
        recording(samples, "pull", phases=phases), rate_hz=rate_hz, unit="uT"
    )
    phases = (Phase(0, 500, GRASP), Phase(500, 560, SAFE_SLIP))
    passed = replace(pulled, trial_id="pass", group="pass", phases=phases)
    short = replace(pulled, trial_id="short", phases=(Phase(480, 500, GRASP),))
    found = tugs.clips(replace(set_of([pulled, passed, short]), unit="uT"), seed=0)
    assert [one.action for one in found.recordings] == ["tug", "hold"]
    assert all(one.samples.shape == (300, 6) for one in found.recordings)
    assert all((one.samples == 0.0).all() for one in found.recordings)
    assert set(found.tasks["situations"].label.tolist()) == {GRASP, RISKY_SLIP}


def test_a_file_of_two_sensors_reads_the_gripper_at_its_own_level(
    tmp_path: Path,
) -> None:
    """In N, 0.2 N a tug; the recordings are 100 times as large, in another unit."""
    held_still, tugged = np.zeros((300, 18)), np.zeros((300, 18))
    tugged[100:] = 20.0
    recordings = []
    for action, samples in (("tug", tugged), ("hold", held_still)):
        one = recording(samples, action, action=action)
        recordings.append(replace(one, unit="uT", rate_hz=100.0))
    real = replace(set_of(recordings), rate_hz=100.0)
    samples = np.zeros((900, 6))
    samples[500:] = 0.2
    phases = (Phase(0, 500, GRASP), Phase(500, 560, RISKY_SLIP))
    scenes = set_of([recording(samples, "pull", phases=phases)])
    scenes = replace(scenes, recordings=[replace(scenes.recordings[0], rate_hz=100.0)])

    pooled = small_model.artifact(small_model.spec(("pooled_state",)))
    card = small_model.model_card(pooled)
    path = tmp_path / "pooled.onnx"
    path.write_bytes(small_model.seal(small_model.graph_of(pooled), card, pooled.spec))
    (row,) = tugs.file_rows(path, scenes, real, 0)
    assert row["level_n"] == pytest.approx(np.sqrt(6) * 0.2)
    assert row["real_level_ut"] == pytest.approx(0.9 * np.sqrt(18) * 20.0)
    assert row["scaling"] == OWN_LEVEL

    path.write_bytes(small_model.sealed_bytes())
    assert tugs.file_rows(path, scenes, real, 0) == []


def test_a_card_without_chip_noise_is_the_card_without_two_effects(
    tmp_path: Path,
) -> None:
    quiet = without_chip_noise(SceneSet("broad", ("broad",), unit="uT"))
    path = tmp_path / "broad.toml"
    path.write_text(card_text("broad", quiet))
    whole, left = read_scene_file("broad"), read_scene_file(str(path))
    assert set(whole.effects) - set(left.effects) == set(CHIP_NOISE)
    assert left.rows == whole.rows
    assert left.unit == "uT"


def test_the_three_real_trials_that_slip_are_drawn(
    real_set: Callable[[str], Path],
) -> None:
    data = load(real_set("proactive_slip_uskin"))
    found = traces.real_traces(data, [[0, 1, 2], [3, 4, 5]])
    assert len(found) == 3
    for one in found:
        assert one["t_s"][0] == pytest.approx(-1.0, abs=0.02)
        assert 0.99 <= max(map(abs, one["normal"] + one["shear"])) <= 1.0


def figure(value: float) -> dict[str, Any]:
    return {"auc": value, "auc_ci": [value - 0.1, value + 0.1]} | {
        "average_precision": 0.3,
        "average_precision_ci": [0.2, 0.4],
    }


def row(name: str, scaling: str, f1: float) -> dict[str, Any]:
    share = {"share": 0.25, "share_ci": [0.2, 0.3], "n": 9}
    four = {"macro_f1": f1, "macro_f1_ci": [f1 - 0.1, f1 + 0.1]}
    return {
        "row": name,
        "scaling": scaling,
        "n_groups": 18,
        "n_trials": 676,
        "situations": four,
        "predict_250ms": figure(0.8),
        "by_risky_votes": figure(0.6),
        "recall": {"nothing": share, "grasp": share},
    }


@pytest.fixture
def figures() -> dict[str, Any]:
    drawn = {"name": "one", "t_s": [0.0, 1.0], "normal": [0.0, 1.0]}
    drawn |= {"shear": [0.0, 0.5], "slip_s": [0.0, 0.5]}
    spread = statistics.spread_rows(tables.PEOPLE, True, {"grip_n": [1.0, 5.0]})
    for one in COMPARED[:2]:
        spread += statistics.spread_rows(one.name, False, {"grip_n": [2.0, 6.0]})
    domain_row = {"scene": SHIPPED.name, "group": "now", "auc": 0.97}
    return {
        "date": "2026-11-23",
        "commit": "abc",
        "trials_a_card": 300,
        "scenes_seed": 101,
        "seconds": 10.0,
        "people": {"rows": [row(REAL_ONLY, AS_RECORDED, 0.66)]},
        "scenes": {
            "rows": [row(SHIPPED.name, one, 0.3) for one in (AS_RECORDED, OWN_LEVEL)]
        },
        "tugs": {"rows": [{"row": "t", "scaling": OWN_LEVEL, "accuracy": 0.42}]},
        "domain": {"rows": [domain_row]},
        "statistics": {"rows": spread, "within": statistics.within(spread)},
        "traces": {"real": [drawn] * 3, "simulated": [drawn] * 2},
    }


def test_the_tables_have_a_row_for_each_model_and_none_of_a_part_left_out(
    figures: dict[str, Any],
) -> None:
    people = tables.people_table(figures)
    assert f"| {SHIPPED.name} | own level | 0.30 (0.20 to 0.40) | 0.80" in people
    assert f"| {REAL_ONLY} | - | 0.66 (0.56 to 0.76) |" in people
    assert "| t | own level | 0.42 | - | - | - |" in tables.tugs_table(figures)
    assert "not 5 %" in tables.statistics_table(figures)
    for name in ("people", "tugs", "domain", "statistics"):
        del figures[name]
    assert {draw(figures) for draw in tables.FUNCTIONS.values()} == {""}


def test_both_pictures_say_what_is_real_and_what_is_simulated(
    figures: dict[str, Any],
) -> None:
    drawn = {name: draw(figures) for name, draw in PICTURES.items()}
    assert "18 people, real" in drawn["transfer.svg"]
    assert SHIPPED.name in drawn["transfer.svg"]
    for words in ("real, robot: one", "simulated: one"):
        assert words in drawn["transfer-traces.svg"]
    for text in drawn.values():
        assert ET.fromstring(text).get("role") == "img"


def test_the_page_and_the_readme_have_the_tables(
    figures: dict[str, Any], tmp_path: Path
) -> None:
    page = filled("docs/transfer.md", {"transfer": figures, "tugs": figures}, tmp_path)
    for name in ("people", "tugs", "domain", "statistics"):
        assert getattr(tables, f"{name}_table")(figures) in page
    readme = filled("docs/people.md", {"transfer": figures}, tmp_path)
    short = f"| {SHIPPED.name} | 0.30 (0.20 to 0.40) | 0.80 (0.70 to 0.90) | 0.60 "
    assert short in readme


def test_a_set_may_have_another_hand_than_its_card(tmp_path: Path) -> None:
    path = tmp_path / "pinch.toml"
    path.write_text(card_text("pinch", PINCH_SPREAD))
    assert read_scene_file(str(path)).hand.name == "pinch-pad-spread"


def test_half_of_the_people_are_kept_for_the_report() -> None:
    people = [
        replace(held(4.0, 1.0, seed=k), group=name) for k, name in enumerate("dbcae")
    ]
    assert set(reported_on(set_of(people)).groups()) == {"b", "d"}
