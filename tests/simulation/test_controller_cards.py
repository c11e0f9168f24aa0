"""Cards with `[controller]`: the recording is that of the hand that acted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from loop_bench import MODEL, WHOLE_BRUSH, card_text, row

from holdfast.core.contract import FloatArray
from holdfast.core.errors import CardError, HoldfastError, NotAModel, RateError
from holdfast.simulation.drive import GRIP_COLUMNS
from holdfast.simulation.folder import write_set
from holdfast.simulation.loop_recording import (
    RecordedLoop,
    require_controller,
    scene_of,
)
from holdfast.simulation.scene import Scene, SimulatedTrial
from holdfast.simulation.scene_file import read_scene_file

SENSED = WHOLE_BRUSH + "[effects.dipole]\n[effects.hall_noise]\n"
ROWS = (row("fall", "weak_grip = 0.5\n"), row("pass"))
EMPTY = '[[trials]]\naction = "nothing"\nlasts_s = 1\n'


def section(name: str, more: str = "") -> str:
    """The `[controller]` of a card, with the shipped model."""
    return f'[controller]\nname = "{name}"\nmodel = "{MODEL}"\n{more}'


def scene(folder: Path, text: str, seed: int = 4) -> Scene:
    """The scene of a card's text, whose hand acts."""
    path = folder / "short.toml"
    path.write_text(text, encoding="utf-8")
    return scene_of(read_scene_file(str(path)), seed)


def simulated(folder: Path, controller: str) -> list[SimulatedTrial]:
    """A fall, a hand-over and an empty hand."""
    folder.mkdir()
    one = scene(folder, card_text(*ROWS, EMPTY, effects=SENSED + controller))
    return sorted(one.run(one.trials()), key=lambda trial: trial.trial.number)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[SimulatedTrial]]:
    """The same trials without a section, with controller none, and with holdfast."""
    folder = tmp_path_factory.mktemp("three")
    sections = {"open": "", "none": section("none"), "holdfast": section("holdfast")}
    return {name: simulated(folder / name, text) for name, text in sections.items()}


def test_a_controller_that_wants_nothing_gives_the_recording_without_the_section(
    three: dict[str, list[SimulatedTrial]],
) -> None:
    for one, other in zip(three["open"], three["none"], strict=True):
        assert one.signal.values.tobytes() == other.signal.values.tobytes()
        assert one.motion.position_m.tobytes() == other.motion.position_m.tobytes()
        assert one.truth == other.truth
        assert one.grip is None
        assert (other.grip is None) == (one.trial.action == "nothing")


def test_an_object_that_was_lost_stays_with_holdfast(
    three: dict[str, list[SimulatedTrial]],
) -> None:
    bare = three["none"][0]
    held = three["holdfast"][0]
    assert bare.trial.action == "fall"
    assert bare.truth.contact_lost_s is not None
    assert held.truth.contact_lost_s is None
    assert held.motion.gripped[-1]
    assert held.grip is not None
    commanded_n = held.grip.rows[:, 0]
    grip_n = held.grip.rows[:, -1]
    assert np.nanmax(commanded_n) > bare.trial.grip_n + 1.0
    assert grip_n[-1] > bare.trial.grip_n + 1.0
    assert grip_n[0] == bare.trial.grip_n


def test_a_slip_that_the_hand_stopped_ends_as_a_grasp(
    three: dict[str, list[SimulatedTrial]],
) -> None:
    labels = [
        phase["label"] for phase in three["holdfast"][0].truth.to_json()["phases"]
    ]
    assert labels[:4] == ["nothing", "grasp", "risky_slip", "grasp"]
    bare = [phase["label"] for phase in three["none"][0].truth.to_json()["phases"]]
    assert bare == ["nothing", "grasp", "risky_slip", "nothing"]


def test_a_recording_holds_the_samples_and_the_commands_of_the_loop(
    tmp_path: Path,
) -> None:
    text = card_text(*ROWS, effects=SENSED + section("holdfast"))
    acting = scene(tmp_path, text)
    recorded = RecordedLoop(acting, acting.trials())
    sensed: list[FloatArray] = []
    answer = recorded.loop.models.answer

    def noting(values: FloatArray, valid: np.ndarray) -> object:
        sensed.append(values.copy())
        return answer(values, valid)

    recorded.loop.models.answer = noting  # type: ignore[method-assign, assignment]
    motions = recorded.run()
    spans = recorded.loop.spans
    for place, (trial, (motion, _)) in enumerate(
        zip(acting.trials(), motions, strict=True)
    ):
        signal = acting.sense(trial, motion.t_s, motion.forces_n)[0]
        begins = int(spans.begins[place])
        ends = int(spans.ends[place])
        in_loop = np.array([values[place] for values in sensed[: ends - begins]])
        assert (
            signal.values[begins:ends].reshape(ends - begins, -1).tobytes()
            == in_loop.tobytes()
        )


def test_the_folder_says_who_acted_and_what_was_commanded(tmp_path: Path) -> None:
    text = card_text(
        ROWS[0], EMPTY, effects=SENSED + section("holdfast", "lag_ms = 20\n")
    )
    write_set(scene(tmp_path, text), tmp_path / "set")
    truth = json.loads(
        (tmp_path / "set/full-bottle/fall/trial_1.truth.json").read_text("utf-8")
    )
    assert truth["controller"]["name"] == "holdfast"
    assert truth["controller"]["drive"]["lag_ms"] == 20
    assert len(truth["controller"]["model_id"]) > 8
    grip = np.genfromtxt(
        tmp_path / "set/full-bottle/fall/trial_1.grip.csv", delimiter=",", names=True
    )
    samples = np.genfromtxt(
        tmp_path / "set/full-bottle/fall/trial_1.csv", delimiter=",", names=True
    )
    assert grip.dtype.names == ("Time", *GRIP_COLUMNS)
    assert (grip["Time"] == samples["Time"]).all()
    assert set(np.unique(grip["mode"])) <= {0, 1, 2, 3, 4}
    assert 2 in grip["mode"]
    assert not (tmp_path / "set/nothing/trial_1.grip.csv").exists()
    assert (
        json.loads((tmp_path / "set/meta.json").read_text("utf-8"))["controller"]
        == "holdfast"
    )


def test_a_recording_of_a_pull_lasts_until_the_puller_has_given_up(
    tmp_path: Path,
) -> None:
    short = row("pull", "cap_n = 0.5\nmove_s = 0.3\ntail_s = 0.2\n")
    acting = scene(tmp_path, card_text(short, effects=section("none")))
    (one,) = acting.run_together(acting.trials())
    force_n = np.linalg.norm(one.motion.agents_n, axis=1)
    assert one.motion.gripped[-1]
    assert force_n.max() > 0.3
    assert force_n[-1] < 0.01


REFUSED = [
    ('name = "firm"\n', CardError, ["controller.name", "firm", "pd-shear"]),
    ('name = "none"\nlag = 3\n', CardError, ["lag", "not known", "lag_ms"]),
    ('name = "none"\nlag_ms = -1\n', CardError, ["lag_ms", "0 to 1000 ms"]),
    ('name = "none"\nmodel = 3\n', CardError, ["controller.model", "path of a model"]),
    ('name = "none"\nceiling_n = 0.2\n', CardError, ["ceiling_n", "0.2", "or more"]),
    ('name = "none"\nmodel = "no.onnx"\n', HoldfastError, ["no.onnx"]),
]


@pytest.mark.parametrize(("text", "error", "named"), REFUSED)
def test_a_controller_that_cannot_act_is_refused(
    tmp_path: Path, text: str, error: type[HoldfastError], named: list[str]
) -> None:
    path = tmp_path / "card.toml"
    model = "" if "model" in text else f'model = "{MODEL}"\n'
    path.write_text(
        card_text(ROWS[0]) + "[controller]\n" + text + model, encoding="utf-8"
    )
    with pytest.raises(error) as refused:
        _require(path)
    for name in named:
        assert name in str(refused.value)


def test_a_rate_a_unit_or_a_stream_that_the_model_does_not_have_is_refused(
    tmp_path: Path,
) -> None:
    path = tmp_path / "card.toml"
    text = card_text(ROWS[0], effects=SENSED + section("none"))
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RateError, match="150 Hz"):
        _require(path, rate_hz=100.0)
    path.write_text(text.replace("[record]", '[record]\nunit = "uT"'), encoding="utf-8")
    with pytest.raises(CardError, match=r"record\.unit"):
        _require(path)
    path.write_text(text.replace("[record]", "[record]\njoin = 2"), encoding="utf-8")
    with pytest.raises(CardError, match=r"record\.join"):
        _require(path)
    other = tmp_path / "other.onnx"
    other.write_bytes(b"nothing")
    path.write_text(text.replace(str(MODEL), str(other)), encoding="utf-8")
    with pytest.raises(NotAModel):
        _require(path)


def _require(path: Path, rate_hz: float | None = None) -> None:
    one = scene_of(read_scene_file(str(path), rate_hz=rate_hz), 0)
    require_controller(one, one.trials())
