"""Whole streams evaluated: outputs, baselines, figures and the report."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest

from holdfast.cli.main import main
from holdfast.core.contract import (
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    Sample,
)
from holdfast.core.errors import UsageError
from holdfast.data.datasets import load
from holdfast.data.fixture import FIXTURE_OBJECTS, write_fixture
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase, RiskyEvent
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.edge_runtime.graph import open_session, steps_of
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.evaluation.alarms import event_scores, match_alarms
from holdfast.evaluation.baseline_signals import (
    band_pass_fires,
    cone_fires,
    detector_signals,
)
from holdfast.evaluation.baselines import (
    Baseline,
    held_until_let_go,
    matched,
    oracle_requests,
)
from holdfast.evaluation.evaluate import EvaluationRequest, evaluate_events
from holdfast.evaluation.formats import mcnemar
from holdfast.evaluation.methods import MethodFigures, method_figures, outcomes_of
from holdfast.evaluation.model_outputs import (
    NO_CLASS,
    ModelOutputs,
    everywhere,
    run_model,
)
from holdfast.evaluation.states import LabelledSamples, changes_per_s
from holdfast.evaluation.states import calibration as calibration_of
from holdfast.evaluation.states import confusion as confusion_of
from holdfast.evaluation.trials import LabelledTrial, VoluntaryAction, voluntary_actions
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.step.detectors import detector_names
from holdfast.step.features import feature_graph
from holdfast.step.spec import BandsLeftOut, StepSpec

if TYPE_CHECKING:
    from conftest import Built

RATE_HZ = 100.0
EVENT = RiskyEvent(1.0, 1.05, 1.10)
RULES = DecisionRules()
SPEC = StepSpec(n_sensors=6, rate_hz=RATE_HZ, unit="N", groups=("now",))
HANDED_OVER = (
    Phase(0, 100, GRASP),
    Phase(100, 120, SAFE_SLIP),
    Phase(120, 300, NOTHING),
)
CARD = """[record]
rate_hz = 50

[physics]
step_s = 0.003

[[trials]]
objects = ["soft-ball", "hard-ball"]
action = "pass"

[[trials]]
objects = ["soft-ball"]
action = "pull"

[[trials]]
objects = ["hard-ball"]
action = "fall"

[[trials]]
objects = ["hard-ball"]
action = "hold"
weak_share = 0
load_n = 0.5
"""


def recording(
    *events: RiskyEvent,
    phases: tuple[Phase, ...] = (),
    action: str | None = None,
    n: int = 300,
) -> Recording:
    samples, valid = np.zeros((n, 18)), np.ones((n, 6), dtype=bool)
    return Recording(
        "a", "a", samples, valid, RATE_HZ, "N", "soft-ball", action, phases, events
    )


def at(*spans: tuple[int, int], n: int = 300) -> np.ndarray:
    rows = np.arange(n)
    on = np.zeros(n, dtype=bool)
    for first, stop in spans:
        on |= (rows >= first) & (rows < stop)
    return on


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five simulated trials of the bare core at 50 Hz: two hand-overs, a pull, a fall, a disturbed
    hold. Read only."""
    folder = tmp_path_factory.mktemp("scenes")
    (folder / "small.toml").write_text(CARD)
    write_set(Scene(read_scene_file(str(folder / "small.toml")), 5), folder / "set")
    return folder / "set"


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made-up")
    few = FIXTURE_OBJECTS[:2]
    write_fixture(folder / "set", trials_per_cell=1, seed=4, objects=few)
    return folder / "set"


# -- what a model answered, and what the truth is


def test_outputs_and_figures_are_those_of_the_monitor_at_each_sample(
    eight_classes: Built, made_up: Path, evaluated: tuple[dict[str, Any], str]
) -> None:
    model = Model(eight_classes.model)
    data = load(made_up, windows="natural")
    assert model.card.decision == RULES
    matches = []
    for one in run_model(model, data):
        of = one.recording
        monitor = GripMonitor(model, None)
        answers = [
            monitor.feed(Sample(round(t * 1e9 / of.rate_hz), values, valid, t))
            for t, (values, valid) in enumerate(zip(of.samples, of.valid, strict=True))
        ]
        states = np.array(("unknown", *SITUATIONS))[one.situation + 1]
        assert [answer.state for answer in answers] == states.tolist()
        p_grasp = [answer.p_situation["grasp"] for answer in answers]
        np.testing.assert_allclose(p_grasp, one.p_situation[:, 1], rtol=1e-6)
        matches.append(match_alarms(of, np.array([answer.act for answer in answers])))
        assert ((one.eight == NO_CLASS) == (one.situation == UNKNOWN)).all()
    expected = event_scores(matches)
    (*_, of_set) = evaluated[0]["sets"].values()
    got = of_set["rows"]["ours, as deployed"]
    assert got["found"] == expected.found > 0
    assert got["false_alarms"] == expected.false_alarms
    assert got["already_on"] == expected.already_on


def test_a_put_down_is_one_voluntary_action_and_a_grip_that_fails_has_none() -> None:
    put_down = (
        Phase(0, 50, GRASP),
        Phase(50, 60, SAFE_SLIP),
        Phase(60, 80, GRASP),
        Phase(80, 90, SAFE_SLIP),
    )
    assert voluntary_actions(recording(phases=put_down)) == [VoluntaryAction(50, 90)]
    sliding = (Phase(100, 104, SAFE_SLIP), Phase(104, 110, RISKY_SLIP))
    assert voluntary_actions(recording(EVENT, phases=sliding)) == []
    assert voluntary_actions(recording(phases=put_down, action="hold")) == []


# -- baselines


def test_a_baseline_is_matched_at_its_most_sensitive_setting_with_no_more_false_alarms() -> (
    None
):
    on = [recording(EVENT)]
    per_min = 1 / (3 / 60)
    spans = ((10, 12), (20, 22), (30, 32))
    alarms = [at(*spans[:n]) for n in (3, 2, 1, 0)]

    def made_up(first: int, stop: int) -> Baseline:
        settings = tuple(float(k) for k in range(first, stop))
        return Baseline("made up", settings, lambda _: lambda k: [alarms[int(k)]])

    found = matched(made_up(0, 4), on, 2.0 * per_min)
    assert (found.setting, found.fits) == (1.0, True)
    assert found.false_per_min == pytest.approx(2.0 * per_min)
    assert matched(made_up(0, 4), on, 0.0).setting == 3.0
    too_many = matched(made_up(1, 3), on, 0.0)
    assert (too_many.setting, too_many.fits) == (2.0, False)


@pytest.mark.parametrize("onset_s", [0.0, 0.999, 1.0, 1.0001])
def test_the_oracle_finds_every_event_within_a_sample_and_nothing_else(
    onset_s: float,
) -> None:
    of = recording(RiskyEvent(onset_s, None, onset_s + 0.1))
    found = match_alarms(of, oracle_requests(of))
    assert found.false_s == ()
    assert found.outcomes[0].delay_s is not None
    assert 0.0 < found.outcomes[0].delay_s <= 1.0 / RATE_HZ + 1e-9


def test_a_detector_that_fires_in_the_air_asks_nothing_and_in_the_hand_holds_until_let_go() -> (
    None
):
    of = recording()
    of.samples[100:200, 2::3] = 1.0
    (acts,) = held_until_let_go([of], [at((20, 30), (120, 121), (250, 260))], RULES)
    assert np.flatnonzero(acts).tolist() == list(
        range(120, 200 + RULES.release_samples - 1)
    )


def test_detectors_fire_where_those_of_a_step_graph_with_their_thresholds_do() -> None:
    rng = np.random.default_rng(1)
    streams = [shaking(rng, n) for n in (300, 260)]
    signals = detector_signals(SPEC, streams)
    ratios = (1.5, 4.0)
    columns = detector_names(SPEC)
    both = band_pass_fires(signals, SPEC, ratios)
    for ratio, fires in zip(ratios, both, strict=True):
        rules = msgspec.structs.replace(
            SPEC.detectors, band_ratio=ratio, friction=ratio / 4.0
        )
        graph = feature_graph(
            msgspec.structs.replace(SPEC, detectors=rules)
        ).SerializeToString()
        expected = everywhere(steps_of(open_session(graph), ["detectors"]), streams)
        for one, fired, of_graph in zip(signals, fires, expected, strict=True):
            cone = cone_fires(SPEC, one, ratio / 4.0)
            for name, mine in (("band_pass", fired), ("friction_cone", cone)):
                assert mine.any()
                column = of_graph["detectors"][:, columns.index(name)]
                assert np.array_equal(mine, column)


def shaking(rng: np.random.Generator, n: int) -> Recording:
    """A hand that is shaken ever harder, with sensors lost for shorter and longer than 20 ms."""
    of = recording(n=n)
    of.samples[:] = np.cumsum(rng.normal(0.0, 0.05, of.samples.shape), axis=0)
    of.samples[150:] += rng.normal(0.0, 0.5, of.samples[150:].shape)
    of.samples[:, 2::3] += 2.0
    of.valid[100:101, 0], of.valid[120:140, 3] = False, False
    return of


# -- figures


def test_mcnemar_counts_only_what_one_of_two_found() -> None:
    ours = np.array([1, 1, 1, 1, 1, 1, 0], dtype=bool)
    theirs = np.array([0, 0, 0, 0, 0, 1, 0], dtype=bool)
    found = mcnemar(ours, theirs)
    assert (found.only_ours, found.only_theirs) == (5, 0)
    assert (found.both, found.neither) == (1, 1)
    assert found.p == pytest.approx(0.0625)
    assert mcnemar(ours, ours).p == 1.0


def figures_of(trials: list[LabelledTrial], *requests: np.ndarray) -> MethodFigures:
    return method_figures(outcomes_of(trials, requests), 0)


def test_a_hold_is_specific_without_any_alarm_and_counts_only_if_it_held() -> None:
    in_grip, in_motor = ({"drawn": {name: 1}} for name in ("grip_change", "motor_mm"))
    trials = [LabelledTrial(recording(), in_grip) for _ in range(2)]
    trials.append(LabelledTrial(recording(EVENT), in_grip))
    trials.append(LabelledTrial(recording(), in_motor))
    figures = figures_of(trials, at(), at((5, 6)), at((5, 6)), at()).specificity
    assert figures is not None
    of_grip = figures["dFn"]
    assert (of_grip.share, of_grip.n, of_grip.failed) == (0.5, 2, 1)
    assert (figures["dFt"].n, figures["dq"].share) == (0, 1.0)
    assert figures_of([LabelledTrial(recording(), {})], at()).specificity is None


def test_voluntary_actions_are_called_where_an_act_is_requested_at_any_sample_of_them() -> (
    None
):
    of = recording(phases=HANDED_OVER, action="pass")
    trials = [LabelledTrial(of, {"style": style}) for style in ("p1", "p1", "p2")]
    figures = figures_of(trials, at((90, 110)), at((90, 99)), at())
    assert figures.safe_acts_called.share == pytest.approx(1 / 3)
    assert figures.safe_acts_by_action["pass"].n == 3
    assert figures.by_style is not None
    assert figures.by_style.styles["p1"].safe_acts_called.share == 0.5
    assert figures.false_alarms == figures.collar_40_ms.false_alarms == 2


def answered(
    situation: np.ndarray, phases: tuple[Phase, ...] = (), risky: float = 0.0
) -> ModelOutputs:
    """Samples with this probability of a risky slip, the rest of nothing."""
    n = len(situation)
    p = np.zeros((n, 4), dtype=np.float32)
    p[:, RISKY_SLIP], p[:, NOTHING] = risky, 1.0 - risky
    of = recording(phases=phases, n=n)
    sure, none = np.full(n, 1000), np.full(n, NO_CLASS)
    return ModelOutputs(of, situation, sure, p, none)


@pytest.mark.parametrize(("risky", "error"), [(0.75, 0.0), (1.0, 0.25)])
def test_probabilities_that_come_true_have_no_calibration_error_and_boasts_have_all_of_it(
    risky: float, error: float
) -> None:
    phases = (Phase(0, 30, RISKY_SLIP), Phase(30, 40, NOTHING))
    samples = LabelledSamples.of([answered(np.full(40, GRASP), phases, risky)])
    found = calibration_of(samples)
    assert found is not None
    assert found.ece == pytest.approx(error, abs=1e-6)
    assert found.ece_risky == pytest.approx(error, abs=1e-6)


def test_unknown_samples_change_no_state_and_are_answers_withheld() -> None:
    states = [UNKNOWN, NOTHING, UNKNOWN, NOTHING, GRASP, NOTHING]
    situation = np.repeat(states, [50, 25, 5, 20, 25, 25])
    one = answered(situation, (Phase(0, 100, NOTHING), Phase(100, 130, GRASP)))
    assert changes_per_s([one], [situation]) == pytest.approx(2 / (95 / RATE_HZ))
    samples = LabelledSamples.of([one])
    assert samples.label[130:].tolist() == [UNKNOWN] * 20
    counts = confusion_of(samples, 0).counts
    assert counts[NOTHING] == [45, 0, 0, 0, 55]
    assert counts[GRASP] == [5, 25, 0, 0, 0]


# -- the whole


@pytest.fixture(scope="module")
def evaluated(
    eight_classes: Built,
    scenes: Path,
    made_up: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[dict[str, Any], str]:
    """Figures and report of a small model on a made-up set and on scenes, its confidence chosen on
    another set."""
    out = tmp_path_factory.mktemp("evaluated")
    write_fixture(out / "choose", trials_per_cell=1, seed=3)
    words = ["evaluate", eight_classes.model, "--data", scenes, made_up]
    words += ["--choose", out / "choose", "--train", out / "choose"]
    words += ["--false-per-min", 2]
    words += ["--json", out / "figures.json", "--report", out / "report.html"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandsLeftOut)
        assert main([str(word) for word in words]) == 0
    page = (out / "report.html").read_text()
    return json.loads((out / "figures.json").read_text()), page


def test_every_set_has_every_method_and_says_where_its_threshold_is_from(
    evaluated: tuple[dict[str, Any], str],
) -> None:
    figures, _ = evaluated
    assert len(figures["sets"]) == 2
    result = figures["thresholds"]
    assert result["chosen_on"] == result["matched_on"]
    assert result["false_per_min_there"] <= result["most_false_per_min"] == 2.0
    rivals = {"band-pass bank", "friction cone", "one line of code"}
    rivals |= {"raw-window forest", "perfect intent"}
    assert set(result["rivals"]) == rivals
    assert set(result["lines"]) == {"ours, confidence chosen", "ours, as deployed"}
    for one in (*figures["sets"].values(), figures["all"]):
        rows = one["rows"]
        assert set(rows) == rivals | set(result["lines"])
        assert set(one["mcnemar"]) == rivals
        oracle = rows["perfect intent"]
        assert oracle["missed"] == oracle["false_alarms"] == 0
        assert len({row["events"] for row in rows.values()}) == 1
    events = [one["data"]["events"] for one in figures["sets"].values()]
    assert figures["all"]["rows"]["perfect intent"]["found"] == sum(events)


def test_a_threshold_chosen_on_what_is_scored_is_refused(
    eight_classes: Built, scenes: Path
) -> None:
    model = ModelChoice(str(eight_classes.model))
    request = EvaluationRequest((str(scenes),), choose=(f"{scenes}/../set",))
    with pytest.raises(UsageError, match="given both to --choose and to --data"):
        evaluate_events(model, request)
