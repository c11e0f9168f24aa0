"""Whole streams evaluated: outputs, baselines, figures and the report."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from holdfast.evaluation.methods import (
    DisturbedHold,
    MethodFigures,
    method_figures,
    method_result,
    specificity,
)
from holdfast.evaluation.model_outputs import (
    NO_CLASS,
    OUTPUTS,
    ModelOutputs,
    everywhere,
    read_outputs,
    steps_with,
)
from holdfast.evaluation.outcomes import recognised
from holdfast.evaluation.states import (
    calibration,
    changes_per_s,
    confusion,
    labels_everywhere,
)
from holdfast.evaluation.statistics import mcnemar
from holdfast.evaluation.trials import (
    AnsweredTrial,
    Grasp,
    LabelledTrial,
    VoluntaryAction,
    voluntary_actions,
)
from holdfast.export.detectors import detector_names
from holdfast.export.features import feature_graph
from holdfast.export.spec import BandsLeftOut, StepSpec
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import load
from holdfast.training.fixture import write_fixture
from holdfast.training.recording import Recording
from holdfast.training.timeline import Phase, RiskyEvent

if TYPE_CHECKING:
    from conftest import Built

RATE_HZ = 100.0
EVENT = RiskyEvent(1.0, 1.05, 1.10)
RULES = DecisionRules()
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


def answered(
    situation: np.ndarray, of: Recording | None = None, p: np.ndarray | None = None
) -> ModelOutputs:
    n = len(situation)
    p = np.full((n, 4), 0.25, dtype=np.float32) if p is None else p
    none = np.full(n, NO_CLASS)
    return ModelOutputs(
        of or recording(n=n),
        situation,
        np.full(n, 1000),
        p,
        none,
        np.zeros((n, 3), dtype=bool),
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


# -- what the file says


def test_the_outputs_of_a_whole_set_are_those_of_the_monitor_at_each_sample(
    eight_classes: Built,
) -> None:
    model = Model(eight_classes.model)
    some = eight_classes.data.recordings[:3]
    outputs = read_outputs(model, some, everywhere(steps_with(model, OUTPUTS), some))
    for one, of in zip(outputs, some, strict=True):
        monitor = GripMonitor(model, None)
        for t, (values, valid) in enumerate(zip(of.samples, of.valid, strict=True)):
            answer = monitor.feed(Sample(round(t * 1e9 / of.rate_hz), values, valid, t))
            state = ("unknown", *SITUATIONS)[one.situation[t] + 1]
            assert answer.state == state
            assert answer.p_situation["grasp"] == pytest.approx(one.p_situation[t, 1])
        assert set(one.eight[one.situation != UNKNOWN]) <= set(range(8))
        assert (one.eight[one.situation == UNKNOWN] == NO_CLASS).all()


def test_a_model_of_four_situations_votes_for_no_weight(four_situations: Built) -> None:
    model, some = Model(four_situations.model), four_situations.data.recordings[:1]
    (outputs,) = read_outputs(model, some, everywhere(steps_with(model, OUTPUTS), some))
    assert (outputs.eight == NO_CLASS).all()


# -- what the truth says


def test_a_put_down_is_one_voluntary_action_and_a_grip_that_fails_has_none() -> None:
    put_down = (
        Phase(0, 50, GRASP),
        Phase(50, 60, SAFE_SLIP),
        Phase(60, 80, GRASP),
        Phase(80, 90, SAFE_SLIP),
    )
    assert voluntary_actions(recording(phases=put_down)) == [VoluntaryAction(50, 90)]
    sliding = (
        Phase(0, 100, GRASP),
        Phase(100, 104, SAFE_SLIP),
        Phase(104, 110, RISKY_SLIP),
    )
    assert voluntary_actions(recording(EVENT, phases=sliding)) == []
    assert voluntary_actions(recording(phases=put_down, action="hold")) == []


# -- what stands beside


def made_up(*acts: np.ndarray) -> Baseline:
    """One with a setting for each way to ask."""
    return Baseline(
        "made up",
        tuple(float(k) for k in range(len(acts))),
        lambda _: lambda k: [acts[int(k)]],
    )


def test_a_baseline_is_matched_at_its_most_sensitive_setting_with_no_more_false_alarms() -> (
    None
):
    on = [recording(EVENT)]
    per_min = 1 / (3 / 60)
    spans = ((10, 12), (20, 22), (30, 32))
    alarms = [at(*spans[:n]) for n in (3, 2, 1, 0)]
    found = matched(made_up(*alarms), on, 2.0 * per_min)
    assert (found.setting, found.fits) == (1.0, True)
    assert found.false_per_min == pytest.approx(2.0 * per_min)
    assert matched(made_up(*alarms), on, 0.0).setting == 3.0
    too_many = matched(made_up(*alarms[1:3]), on, 0.0)
    assert (too_many.setting, too_many.fits) == (1.0, False)


def test_the_oracle_finds_every_event_within_a_sample_and_nothing_else() -> None:
    for onset_s in (0.0, 0.999, 1.0, 1.0001):
        of = recording(RiskyEvent(onset_s, None, onset_s + 0.1))
        matched = match_alarms(of, oracle_requests(of))
        assert matched.false_s == ()
        assert matched.outcomes[0].delay_s is not None
        assert 0.0 < matched.outcomes[0].delay_s <= 1.0 / RATE_HZ + 1e-9


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
    signals = detector_signals(_spec(), streams)
    ratios = (1.5, 4.0)
    columns = detector_names(_spec())
    both = band_pass_fires(signals, _spec(), ratios)
    for ratio, fires in zip(ratios, both, strict=True):
        rules = replace(_spec().detectors, band_ratio=ratio, friction=ratio / 4.0)
        graph = feature_graph(replace(_spec(), detectors=rules)).SerializeToString()
        expected = everywhere(steps_of(open_session(graph), ["detectors"]), streams)
        for one, fired, of_graph in zip(signals, fires, expected, strict=True):
            cone = cone_fires(one, _spec(), ratio / 4.0)
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


def _spec() -> StepSpec:
    return StepSpec(n_sensors=6, rate_hz=RATE_HZ, unit="N", groups=("now",))


# -- figures


def test_mcnemar_counts_only_what_one_of_two_found() -> None:
    ours = np.array([1, 1, 1, 1, 1, 1, 0], dtype=bool)
    theirs = np.array([0, 0, 0, 0, 0, 1, 0], dtype=bool)
    found = mcnemar(ours, theirs)
    assert (found.only_ours, found.only_theirs) == (5, 0)
    assert (found.both, found.neither) == (1, 1)
    assert found.p == pytest.approx(0.0625)
    assert mcnemar(ours, ours).p == 1.0


def test_a_hold_is_specific_without_any_alarm_and_counts_only_if_it_held() -> None:
    outcomes = ((True, True), (True, False), (False, False))
    grip = [DisturbedHold("dFn", held, quiet) for held, quiet in outcomes]
    figures = specificity([*grip, DisturbedHold("dq", held=True, quiet=True)])
    assert figures is not None
    of_grip = figures["dFn"]
    assert (of_grip.share, of_grip.n, of_grip.failed) == (0.5, 2, 1)
    assert (figures["dFt"].n, figures["dq"].share) == (0, 1.0)
    assert specificity([]) is None


def test_voluntary_actions_are_called_where_an_act_is_requested_at_any_sample_of_them() -> (
    None
):
    phases = (
        Phase(0, 100, GRASP),
        Phase(100, 120, SAFE_SLIP),
        Phase(120, 300, NOTHING),
    )
    handed_over = recording(phases=phases, action="pass")
    p1, p2 = (LabelledTrial(handed_over, (Grasp({"style": s}),)) for s in ("p1", "p2"))
    trials = [p1, p1, p2]
    acts = [at((90, 110)), at((90, 99)), at()]
    figures = figures_of(trials, *acts)
    assert figures.safe_acts_called.share == pytest.approx(1 / 3)
    assert figures.safe_acts_by_action["pass"].n == 3
    assert figures.by_style is not None
    assert figures.by_style.styles["p1"].safe_acts_called.share == 0.5
    assert figures.false_alarms == 2
    assert figures.collar_40_ms.false_alarms == 2


def of_event() -> LabelledTrial:
    return LabelledTrial(recording(EVENT), (Grasp({}),))


def figures_of(trials: list[LabelledTrial], *requests: np.ndarray) -> MethodFigures:
    return method_figures(method_result(trials, requests), trials, 0)


def test_the_wider_collar_forgives_what_the_narrow_one_does_not() -> None:
    figures = figures_of([of_event()], at((97, 99)))
    assert (figures.recall, figures.collar_40_ms.recall) == (0.0, 1.0)


def test_probabilities_that_come_true_have_no_calibration_error_and_boasts_have_all_of_it() -> (
    None
):
    label = np.repeat([RISKY_SLIP, NOTHING], [30, 10])
    p = np.zeros((40, 4), dtype=np.float32)
    p[:, RISKY_SLIP], p[:, NOTHING] = 0.75, 0.25
    fair = calibration([answered(np.full(40, GRASP), p=p)], [label])
    p[:, RISKY_SLIP], p[:, NOTHING] = 1.0, 0.0
    boast = calibration([answered(np.full(40, GRASP), p=p)], [label])
    assert fair is not None
    assert boast is not None
    assert fair.ece == pytest.approx(0.0, abs=1e-6)
    assert (boast.ece, boast.ece_risky) == (pytest.approx(0.25), pytest.approx(0.25))


def test_unknown_samples_change_no_state_and_are_answers_withheld() -> None:
    states = [UNKNOWN, NOTHING, UNKNOWN, NOTHING, GRASP, NOTHING]
    situation = np.repeat(states, [50, 25, 5, 20, 25, 25])
    one = answered(situation)
    assert changes_per_s([situation], [one]) == pytest.approx(2 / (95 / RATE_HZ))
    phases = Phase(0, 100, NOTHING), Phase(100, 130, GRASP)
    label = labels_everywhere(phases, len(situation))
    assert label[130:].tolist() == [UNKNOWN] * 20
    counts = confusion([one], [label], 0).counts
    assert counts[NOTHING] == [45, 0, 0, 0, 55]
    assert counts[GRASP] == [5, 25, 0, 0, 0]


# -- what was recognised


def test_a_pull_is_recognised_by_one_alarm_in_it_and_a_pass_by_its_state_and_no_alarm() -> (
    None
):
    holding, slipping = np.full(300, GRASP), np.full(300, GRASP)
    slipping[105:109] = SAFE_SLIP

    def judged(of: Recording, situation: Any, requests: Any) -> bool | None:
        trial = LabelledTrial(of, (Grasp({"style": "p1"}),))
        return recognised(AnsweredTrial(trial, situation, requests))

    pull = recording(EVENT, action="pull")
    assert judged(pull, holding, at((102, 120)))
    assert not judged(pull, holding, at((50, 60), (102, 120)))
    assert not judged(pull, holding, at())
    assert judged(recording(action="pull"), holding, at()) is None
    phases = Phase(0, 100, GRASP), Phase(100, 120, SAFE_SLIP), Phase(120, 300, NOTHING)
    handed_over = recording(phases=phases, action="pass")
    assert judged(handed_over, slipping, at())
    assert not judged(handed_over, slipping, at((10, 12)))
    assert not judged(handed_over, holding, at())


# -- the whole


@pytest.fixture(scope="module")
def evaluated(
    eight_classes: Built, scenes: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict[str, Any], str]:
    """Figures and report of a small model on a made-up set and on scenes, its confidence chosen on
    another set."""
    out = tmp_path_factory.mktemp("evaluated")
    write_fixture(out / "choose", trials_per_cell=1, seed=3)
    words = [
        "evaluate",
        eight_classes.model,
        "--data",
        scenes,
        eight_classes.fixture,
        "--choose",
        out / "choose",
        "--train",
        out / "choose",
        "--false-per-min",
        2,
        "--real",
        out / "nowhere",
        "--json",
        out / "figures.json",
        "--report",
        out / "report.html",
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandsLeftOut)
        assert main([str(word) for word in words]) == 0
    return json.loads((out / "figures.json").read_text()), (
        out / "report.html"
    ).read_text()


def test_every_set_has_every_line_and_says_where_its_threshold_is_from(
    evaluated: tuple[dict[str, Any], str],
) -> None:
    figures, _ = evaluated
    assert len(figures["sets"]) == 2
    result = figures["thresholds"]
    assert result["chosen_on"] == result["matched_on"]
    assert result["false_per_min_there"] <= result["most_false_per_min"] == 2.0
    lines = set(result["lines"]) | set(result["rivals"])
    assert lines == {
        "ours, confidence chosen",
        "ours, as deployed",
        "band-pass bank",
        "friction cone",
        "one line of code",
        "raw-window forest",
        "perfect intent",
    }
    for one in (*figures["sets"].values(), figures["all"]):
        assert set(one["rows"]) == lines
        assert set(one["mcnemar"]) == set(result["rivals"])
        rows = one["rows"]
        oracle = rows["perfect intent"]
        assert oracle["missed"] == oracle["false_alarms"] == 0
        assert rows["ours, as deployed"]["events"] == rows["friction cone"]["events"]
    events = [one["data"]["events"] for one in figures["sets"].values()]
    assert figures["all"]["rows"]["perfect intent"]["found"] == sum(events)


def test_the_report_of_training_data_says_so_first_and_needs_no_other_file(
    evaluated: tuple[dict[str, Any], str],
) -> None:
    _, page = evaluated
    # The made-up set is the one the model learned from, so there is no answer in large.
    assert page.index("Not a judgement") < page.index("<table")
    assert "src=" not in page
    assert "href=" not in page.replace("xlink:href=", "")
    assert page.count("<svg") >= 4
    for title in (
        "make real",
        "trained on",  # the made-up set is the one the model learned from
        "Trials over time",
        "beside the baselines",
        "lead that was left",
        "limits",
    ):
        assert title in page


@pytest.fixture(scope="module")
def deployed(eight_classes: Built, scenes: Path) -> dict[str, Any]:
    """Figures of the scenes alone, nothing chosen."""
    request = EvaluationRequest((str(scenes),))
    return evaluate_events(ModelChoice(str(eight_classes.model)), request).to_json()


def test_a_threshold_chosen_on_what_is_scored_is_refused(
    eight_classes: Built, scenes: Path
) -> None:
    model = ModelChoice(str(eight_classes.model))
    request = EvaluationRequest((str(scenes),), choose=(f"{scenes}/../set",))
    with pytest.raises(UsageError, match="given both to --choose and to --data"):
        evaluate_events(model, request)


def test_the_figures_of_ours_are_those_of_its_own_answers(
    eight_classes: Built, scenes: Path, deployed: dict[str, Any]
) -> None:
    model, data = Model(eight_classes.model), load(scenes, windows="natural")
    assert model.card.decision == RULES
    result = []
    for of in data.recordings:
        monitor, acts = GripMonitor(model, None), []
        for t, (values, valid) in enumerate(zip(of.samples, of.valid, strict=True)):
            sample = Sample(round(t * 1e9 / of.rate_hz), values, valid, t)
            acts.append(monitor.feed(sample).act)
        result.append(match_alarms(of, np.array(acts)))
    expected = vars(event_scores(result))
    got = deployed["all"]["rows"]["ours, as deployed"]
    for name in ("found", "false_alarms", "already_on"):
        assert got[name] == expected[name]
