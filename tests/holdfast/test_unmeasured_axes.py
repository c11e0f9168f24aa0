"""A hand that measures one axis of the shear: on every way to a model 0.0 stands for the other."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import small_model
from command_line import Run
from own_data import rewrite

from holdfast.core.contract import Sample
from holdfast.core.errors import ChannelError
from holdfast.core.hand_card import HandCard, read_hand_card
from holdfast.core.schema import json_of
from holdfast.core.trial_file import read_trial
from holdfast.data.datasets import load
from holdfast.data.datasets.joining import join
from holdfast.data.datasets.trials import DoubtfulData
from holdfast.drivers.lines import SampleReader
from holdfast.drivers.replay import PacedReplay, open_replay
from holdfast.edge_runtime.model_file import card_of
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.evaluation.model_outputs import require_model_fits
from holdfast.export.changed import changed
from holdfast.export.exporting import export_artifact
from holdfast.live.hand_files import tare_of
from holdfast.live.outputs import SampleFile
from holdfast.live.page.run_page import drawn_hand
from holdfast.live.sources import open_source
from holdfast.simulation.loop.sensing import HandModels
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.step.artifact import write_artifact
from holdfast.step.pooled import FAMILIES
from holdfast.step.spec import StepSpec

PADS = """
name = "pads"
[[sensors]]
name = "left"
side = "thumb"
along_mm = 0
measures = "yz"
[[sensors]]
name = "right"
side = "opposing"
along_mm = 0
measures = "yz"
"""
SCENE = """
[record]
rate_hz = 50
[hand]
card = "pads.toml"
[[trials]]
objects = ["soft-ball", "full-bottle"]
action = "pass"
weak_share = 0
close_at_s = 0.3
hold_s = 1.2
tail_s = 0.3
[effects.white_noise]
rms_n = 0.02
"""
TRIAL = "soft-ball/pass/trial_1.csv"


@pytest.fixture(scope="module")
def pads(tmp_path_factory: pytest.TempPathFactory) -> HandCard:
    return hand_of(tmp_path_factory.mktemp("pads"), PADS)


def hand_of(folder: Path, text: str) -> HandCard:
    path = folder / "pads.toml"
    path.write_text(text, encoding="utf-8")
    return read_hand_card(path)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    hand_of(folder, PADS)
    path = folder / "scene.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def made(scene: Path) -> Path:
    write_set(Scene(read_scene_file(str(scene)), 1), scene.parent / "made")
    return scene.parent / "made"


@pytest.fixture
def own(made: Path, tmp_path: Path) -> Path:
    """A set of such a hand."""
    return shutil.copytree(made, tmp_path / "own")


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of pooled features for the usual hand."""
    folder = tmp_path_factory.mktemp("six") / "artifact"
    spec = small_model.spec(tuple(FAMILIES), n_sensors=6)
    write_artifact(folder, small_model.artifact(spec, extra=False))
    return export_artifact(folder)[0]


@pytest.fixture(scope="module")
def model(six: Path, pads: HandCard, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same for the pads."""
    path = tmp_path_factory.mktemp("model") / "pads.onnx"
    path.write_bytes(changed(six.read_bytes(), pads))
    return path


def silent(values: np.ndarray) -> bool:
    """Whether X1 and X2 are 0.0, and nothing else is."""
    return not values[..., 0::3].any() and bool(np.all(values[..., 1] != 0.0))


# -- files


def test_a_set_of_such_a_hand_has_no_such_columns_and_is_read_with_zeros(
    own: Path, scene: Path
) -> None:
    header = (own / TRIAL).read_text().split("\n", 1)[0]
    assert header == "Time,Y1,Z1,Y2,Z2"
    data = load(own)
    assert data.hand is not None
    assert data.hand.unmeasured_names == ("X1", "X2")
    for recording in data.recordings:
        assert silent(recording.samples)
        assert recording.valid.all()
    stream = open_source(f"sim://{scene}?seed=1")
    np.testing.assert_allclose(
        open_replay(own / TRIAL).values, stream.values, atol=1e-4
    )


def test_such_a_column_may_also_be_there_and_empty(own: Path, pads: HandCard) -> None:
    whole = (own / TRIAL).read_text()
    for cell in ("", " ", "nan", "0"):
        (own / TRIAL).write_text(with_x1(whole, cell))
        trial = read_trial(own / TRIAL, pads)
        assert silent(trial.raw)
        assert trial.denied == ()


def with_x1(text: str, cell: str) -> str:
    """A table with a column X1 of such cells."""
    head, *rows = text.splitlines()
    filled = [row.replace(",", f",{cell},", 1) for row in rows]
    return "\n".join([head.replace("Y1", "X1,Y1"), *filled]) + "\n"


def test_a_missing_column_is_still_missed_where_no_card_denies_it(
    run: Run, own: Path
) -> None:
    (own / "hand.toml").write_text(PADS.replace('measures = "yz"\n', "", 1))
    meta = json.loads((own / "meta.json").read_text())
    del meta["hand"]
    (own / "meta.json").write_text(json.dumps(meta))
    code, out, _ = run("check", own)
    assert code == 3
    assert "columns missing: X1" in out
    assert "an axis that no sensor measures: say so in hand.toml" in out


def test_check_says_what_is_not_measured_and_names_columns_that_say_otherwise(
    run: Run, own: Path
) -> None:
    code, out, _ = run("check", own)
    assert code == 0
    assert "not measured, by hand.toml: X1, X2" in out
    assert "DOUBTFUL" not in out

    # a column with numbers of an axis that the card denies
    (own / TRIAL).write_text(with_x1((own / TRIAL).read_text(), "0.7"))
    _, out, _ = run("check", own)
    assert "column X1 has numbers, and hand.toml says that it is not measured" in out
    with pytest.warns(DoubtfulData, match="column X1 has numbers"):
        assert silent(load(own).recordings[0].samples)


def test_check_names_an_axis_that_the_card_promises_and_that_stays_zero(
    run: Run, own: Path
) -> None:
    meta = json.loads((own / "meta.json").read_text())
    del meta["hand"]
    (own / "meta.json").write_text(json.dumps(meta))
    (own / "hand.toml").write_text(PADS.replace('measures = "yz"\n', "", 1))
    for path in own.glob("*/*/trial_?.csv"):
        path.write_text(with_x1(path.read_text(), "0"))
    _, out, _ = run("check", own)
    assert (
        "column X1 stays 0.0 throughout, and hand.toml says that it is measured" in out
    )
    assert "X2 stays" not in out
    # one reading is enough to be measured
    rewrite(own / TRIAL, with_a_last_reading)
    _, out, _ = run("check", own)
    assert "X1 stays" not in out


def with_a_last_reading(table: np.ndarray) -> np.ndarray:
    table[-1, 1] += 0.5
    return table


def test_sets_that_measure_other_axes_are_not_joined(own: Path) -> None:
    data = load(own)
    assert data.hand is not None
    whole = [msgspec.structs.replace(c, measures="xyz") for c in data.hand.contacts]
    other = replace(data, name="b", hand=replace(data.hand, contacts=tuple(whole)))
    with pytest.raises(ChannelError, match="axes that are not measured"):
        join([data, other])


# -- streams


def test_lines_leave_such_a_column_out_and_the_sensor_is_valid(pads: HandCard) -> None:
    reader = SampleReader(hand=pads)
    line = json.dumps({"Y1": 1.0, "Z1": 2.0, "Y2": 3.0, "Z2": 4.0}).encode()
    reading = reader.take(line, 0)
    assert reading is not None
    assert reading.values.tolist() == [0.0, 1.0, 2.0, 0.0, 3.0, 4.0]
    assert reading.valid.all()
    # a number that is sent all the same goes nowhere
    reading = reader.take(json.dumps({**json.loads(line), "X1": 9.0}).encode(), 10**7)
    assert reading is not None
    assert reading.values[0] == 0.0


def test_a_model_of_three_axes_does_not_answer_such_a_hand(
    model: Path, own: Path
) -> None:
    card = Model(model).card
    raw = json.loads(json.dumps(card.raw))
    for contact in raw["spec"]["hand"]["contacts"]:
        del contact["measures"]
    three_axes = card_of(raw, card.model_id)
    source = PacedReplay(open_replay(own / TRIAL), lambda: 0)
    with pytest.raises(ChannelError, match=r"X1, X2: not measured by the hand pads"):
        tare_of(three_axes, source, None)
    tare_of(card, source, None)
    data = load(own, windows="none")
    require_model_fits(Model(model), data)
    with pytest.raises(ChannelError, match="not measured in the set: X1, X2; by the"):
        require_model_fits(SimpleNamespace(card=three_axes), data)
    with pytest.raises(ChannelError, match="not measured in the set: nothing"):
        require_model_fits(Model(model), replace(data, hand=None))


# -- the model


def test_whatever_stands_there_the_model_gets_zero(model: Path, own: Path) -> None:
    replay = open_replay(own / TRIAL)
    answers: dict[str, object] = {}
    for name, there in (("zero", 0.0), ("nan", np.nan), ("number", 7.0)):
        values = replay.values.copy()
        values[:, 0::3] = there
        valid = np.ones((len(values), 2), np.bool_)
        fed = GripMonitor(Model(model), None)
        samples = map(Sample, replay.t_ns.tolist(), values, valid, range(len(values)))
        one_by_one: list[object] = [fed.feed(one).p_situation for one in samples]
        whole = GripMonitor(Model(model), None).replay(values, 1e-9 * replay.t_ns)
        looped = HandModels(Model(model), 1)
        never = np.zeros(1, np.bool_)
        rows = zip(values[:, None], valid[:, None], strict=True)
        senses = [looped.answer(now, there, never, never) for now, there in rows]
        grips = [[float(one.load_n[0]), float(one.p_risky[0])] for one in senses]
        one_by_one.append(grips)
        answers[name] = one_by_one, whole.p_situation.tolist(), whole.state.tolist()
    assert answers["nan"] == answers["zero"] == answers["number"]
    assert {"unknown"} < set(whole.state.tolist())


def test_a_run_shows_the_axes_and_keeps_nothing_in_their_place(
    run: Run, model: Path, own: Path, pads: HandCard, tmp_path: Path
) -> None:
    out = tmp_path / "samples.csv"
    keeps = SampleFile(out, 6, hand=pads)
    prediction = GripMonitor(Model(model), None).feed(
        sample := Sample(0, np.array([0.0, 1, 2, 0, 4, 5]), np.ones(2, np.bool_), 0)
    )
    keeps.write(prediction, sample)
    keeps.close()
    assert out.read_text().splitlines()[1].split(",")[1:4] == ["nan", "1.0", "2.0"]
    code, lines, _ = run("replay", model, own / TRIAL)
    assert code == 0
    assert any(json_of(one)["state"] != "unknown" for one in lines.splitlines())
    drawn = drawn_hand(pads, 2)
    assert [one["measures"] for one in drawn] == ["yz", "yz"]


def test_the_file_its_card_the_export_and_the_c_header_name_what_is_not_measured(
    run: Run, six: Path, pads: HandCard, tmp_path: Path
) -> None:
    (tmp_path / "pads.toml").write_text(pads.text)
    made = tmp_path / "pads.onnx"
    code, out, _ = run("export", six, "--hand", tmp_path / "pads.toml", "--out", made)
    assert code == 0
    assert "hand: pads, 2 sensors (1 against 1); not measured: X1, X2" in out
    card = json.loads(made.with_suffix(".json").read_text("utf-8"))
    assert [one["measures"] for one in card["spec"]["hand"]["contacts"]] == ["yz"] * 2

    code, _, _ = run("export", made, "--to", "c", "--no-build")
    assert code == 0
    header = next((tmp_path / "pads-c").glob("*.h")).read_text()
    assert "Not measured by this hand, so write 0.0: X1, X2." in header
    run("export", six, "--to", "c", "--no-build", "--out", tmp_path / "six-c")
    header = next((tmp_path / "six-c").glob("holdfast.h")).read_text()
    assert "Not measured" not in header


def test_fixed_features_and_fields_refuse_such_a_hand(pads: HandCard) -> None:
    pooled = tuple(FAMILIES)
    StepSpec(2, 50.0, "N", pooled, hand=pads)
    for unit, groups in (("N", ("now",)), ("uT", pooled)):
        with pytest.raises(ChannelError, match="X1, X2: not measured"):
            StepSpec(2, 50.0, unit, groups, hand=pads)  # type: ignore[arg-type]


def test_hands_that_measure_yz_and_xz_of_the_same_forces_answer_alike(
    six: Path, model: Path, own: Path, tmp_path: Path
) -> None:
    replay = open_replay(own / TRIAL)
    expected = GripMonitor(Model(model), None).replay(replay.values)
    # the right pad has its shear on the other axis
    hand = hand_of(tmp_path, '"xz"'.join(PADS.rsplit('"yz"', 1)))
    assert hand.unmeasured_names == ("X1", "Y2")
    turned = replay.values[:, [0, 1, 2, 4, 3, 5]]
    other = tmp_path / "other.onnx"
    other.write_bytes(changed(six.read_bytes(), hand))
    answers = GripMonitor(Model(other), None).replay(turned)
    assert (expected.state != "unknown").any()
    assert answers.state.tolist() == expected.state.tolist()
    np.testing.assert_allclose(answers.p_situation, expected.p_situation, atol=1e-6)
