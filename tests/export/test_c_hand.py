"""Decision, friction margin, controller and supervisor in C equal those in Python, step by step."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from c_form import SANITISED, CForm, c_form, run
from grip_senses import QUICK, hostile_senses, random_senses
from hazard_marks import IMPOSSIBLE_SENSE
from made_once import made_once
from small_model import artifact, graph_of, spec

from holdfast.core.schema import ranges
from holdfast.edge_runtime.batch import ManyHands
from holdfast.edge_runtime.decision import LIMITS, DecisionRules, DecisionState, decide
from holdfast.edge_runtime.grip import AnswerRules, GripSense, Holdfast, clamped
from holdfast.edge_runtime.grip_control import GripLoop
from holdfast.edge_runtime.supervisor import Limits
from holdfast.export.c.constants import RULE_ORDER
from holdfast.export.c.graph import read_graph
from holdfast.export.c.grip_options import RANGES
from holdfast.export.exporting import model_card, seal

RATE_HZ = 50.0
"""Of the small model."""
ANSWER = DecisionRules(
    answer_permille=600,
    full_answer_permille=800,
    follow_floor_permille=130,
    follow_above_permille=1250,
    safe_follow_mn=2500,
)
"""Its answers begin earlier than usual: that comes with the model."""
DECISION = np.dtype(
    [
        (name, "i4")
        for name in ("risky_run", "nothing_run", "override_us", "evidence_us")
    ]
    + [(name, "u1") for name in ("arm", "act", "ended")],
    align=True,
)
ENDED = (None, "released", "timed_out", "opened", "overridden")
NUMBERS = ("target_n", "slew_n_s", "feedback", "mu_hat", "margin", "needed_n")
COMMAND = np.dtype([("mode", "i4"), *((name, "f8") for name in NUMBERS)], align=True)
STREAM = 500
FRAGILE_N = 4.0
"""Every other hand does fragile work: no target is further above its wearer's grip."""
GAIN = 0.8
"""Of sensors that were calibrated; None where it was not measured."""
"""Of shear, as the sensors of the scenes read it."""
Array = npt.NDArray[Any]


@pytest.fixture(scope="module")
def form(tmp_path_factory: pytest.TempPathFactory) -> CForm:
    def write(folder: Path) -> None:
        made = replace(artifact(spec()), decision=ANSWER.to_json())
        data = seal(graph_of(made), model_card(made), made.spec)
        (folder / "model.onnx").write_bytes(data)
        c_form(folder / "model.onnx", folder / "c")

    folder = made_once(tmp_path_factory, "c-hand", write)
    return CForm(folder / "model.onnx", folder / "c", read_graph(folder / "model.onnx"))


def random_decisions(n: int, seed: int) -> Array:
    """[n, 11] records of the harness: rules that change every STREAM samples, then labels."""
    rng = np.random.default_rng(seed)
    streams = -(-n // STREAM)
    limits = [LIMITS[name] for name in RULE_ORDER]
    small = [rng.integers(low, min(high, low + 4), streams) for low, high in limits]
    small[3] = rng.choice([0, 600, 1000], streams)
    small[4], small[5] = (rng.choice([1, 45, 2000, 600_000], streams) for _ in range(2))
    rules = np.repeat(np.stack(small, axis=1), STREAM, axis=0)[:n]
    fresh = np.arange(n) % STREAM == 0
    often = np.repeat(rng.integers(-1, 4, -(-n // 4)), 4)[:n]
    situation = np.where(rng.random(n) < 0.5, often, rng.integers(-1, 4, n))
    permille = rng.choice([0, 599, 600, 601, 999, 1000], n)
    period = np.repeat(rng.choice([6667, 20_000], streams), STREAM)[:n]
    wish = rng.choice(4, n, p=[0.94, 0.03, 0.02, 0.01])
    more = np.stack([fresh, situation, permille, period, wish], axis=1)
    return np.concatenate([rules, more], axis=1).astype("<i4")


@cache
def rules_of(*values: int) -> DecisionRules:
    return DecisionRules(**dict(zip(RULE_ORDER, values, strict=True)))


def decided(records: Array) -> Array:
    """What Python decides: the fields of DECISION as one row of whole numbers each."""
    remembered = cache(decide_at)
    state, rows = DecisionState(), []
    for *rules, fresh, situation, permille, period_us, wish in records.tolist():
        state = DecisionState() if fresh else state
        state = remembered(
            rules_of(*rules), state, situation, permille, period_us, wish
        )
        row = (state.risky_run, state.nothing_run, state.override_us, state.evidence_us)
        rows.append((*row, state.arm, state.act, ENDED.index(state.ended)))
    return np.array(rows, DECISION)


def decide_at(
    rules: DecisionRules,
    state: DecisionState,
    situation: int,
    permille: int,
    us: int,
    wish: int,
) -> DecisionState:
    opening, override = bool(wish & 1), bool(wish & 2)
    return decide(
        rules,
        state,
        situation,
        permille,
        period_us=us,
        opening=opening,
        override=override,
    )


@pytest.mark.parametrize("n", [25_000, pytest.param(10**6, marks=pytest.mark.soak)])
def test_a_decision_in_c_is_that_of_python_at_every_step(form, n):
    records = random_decisions(n, seed=n)
    got = run(form.program("gcc", "-O2"), "decide", records, DECISION)
    wanted = decided(records)
    assert all((got[name] == wanted[name]).all() for name in DECISION.names or ())
    assert set(wanted["ended"].tolist()) == set(range(len(ENDED)))
    few = run(form.program("gcc", *SANITISED), "decide", records[:20_000], DECISION)
    assert few.tobytes() == got[:20_000].tobytes()


def most_over(hands: int) -> Array:
    """[hands] how far above the wearer's grip a target may be, N."""
    return np.where(np.arange(hands) % 2, FRAGILE_N, np.inf)


def records_of(senses: list[GripSense], hands: int, gain: float | None = GAIN) -> Array:
    """Records of the harness, one hand after another."""
    kind = [
        ("options", [(name, "f8") for name in RANGES]),
        ("fresh", "u1"),
        ("numbers", "f8", 4),
        ("flags", "u1", 4),
    ]
    given = np.zeros((hands, len(senses)), np.dtype(kind))
    own = {"lead_n": Holdfast.SETTING, **vars(AnswerRules.of(ANSWER)), **vars(QUICK)}
    own |= {"shear_gain": gain or 0.0}
    for name in RANGES:
        given["options"][name] = own[name]
    given["options"]["most_over_n"] = most_over(hands)[:, None]
    given["fresh"][:, 0] = 1
    for at, one in enumerate(senses):
        numbers = (one.grip_n, one.load_n, one.p_risky, one.p_safe)
        given["numbers"][:, at] = np.stack(numbers, axis=1)
        flags = (one.known, one.empty, one.opening, one.overridden)
        given["flags"][:, at] = np.stack(flags, axis=1)
    return given


def commanded(
    senses: list[GripSense],
    hands: int,
    gain: float | None = GAIN,
    others: dict[str, float] | None = None,
) -> Array:
    """[hands, samples] what Python commands, on many hands at once."""
    batch = ManyHands(hands)
    rules = AnswerRules.of(ANSWER, most_over_n=most_over(hands), **others or {})
    controller = Holdfast(batch, RATE_HZ, rules=rules, shear_gain=gain)
    loop = GripLoop(batch, RATE_HZ, controller, QUICK)
    commands = np.zeros((hands, len(senses)), COMMAND)
    for at, one in enumerate(senses):
        commands["target_n"][:, at] = loop.step(one)
        commands["mode"][:, at] = loop.supervisor.mode
        for name in ("mu_hat", "margin", "needed_n"):
            commands[name][:, at] = getattr(loop.margin, name)
        felt = clamped(batch, one)
        is_felt = felt.known & (felt.p_risky >= rules.from_p)
        commands["feedback"][:, at] = np.where(is_felt, felt.p_risky, 0.0)
    commands["slew_n_s"] = QUICK.slew_n_s
    return commands


def slides(senses: list[GripSense], hands: int, seed: int) -> list[GripSense]:
    """The same, and slips in between: a steady ratio of forces while a slip is certain."""
    rng = np.random.default_rng(seed)
    for start in range(0, len(senses) - 20, 60):
        grip_n, ratio = 0.4 + 5.0 * rng.random(hands), 0.2 + rng.random(hands)
        for one in senses[start : start + 20]:
            one.grip_n = grip_n * (1.0 + 0.01 * rng.random(hands))
            one.load_n = 2.0 * ratio * one.grip_n
            one.p_risky = 0.9 + 0.1 * rng.random(hands)
            one.known, one.empty = np.ones(hands, bool), np.zeros(hands, bool)
    return senses


def same_commands(
    form: Any,
    senses: list[GripSense],
    hands: int,
    gain: float | None = GAIN,
    rules: dict[str, float] | None = None,
) -> Array:
    """[hands, samples] what Python commands; what C commands has its bits at every step."""
    given = records_of(senses, hands, gain)
    for name, value in (rules or {}).items():
        given["options"][name] = value
    with np.errstate(all="raise", under="ignore"):
        wanted = commanded(senses, hands, gain, rules)
    got = run(form.program("gcc", "-O2"), "grip", given, COMMAND).reshape(wanted.shape)
    assert (got["mode"] == wanted["mode"]).all()
    for name in NUMBERS:
        assert got[name].tobytes() == wanted[name].tobytes(), name
    few = run(form.program("gcc", *SANITISED), "grip", given[:20], COMMAND)
    assert few.tobytes() == got[:20].tobytes()
    return wanted


@pytest.mark.parametrize("hands", [250, pytest.param(2_500, marks=pytest.mark.soak)])
def test_a_grip_command_in_c_has_the_bits_of_python_at_every_step(form, hands):
    senses = slides(random_senses(hands, 400, hands), hands, seed=1)
    commands = same_commands(form, senses, hands)
    assert set(np.unique(commands["mode"])) == {0, 1, 2, 3, 4}

    assert (commands["mu_hat"] > 0.0).mean() > 0.05


def test_sensors_whose_shear_gain_is_unknown_have_the_bits_of_python_too(form):
    senses = slides(random_senses(50, 200, 50), 50, seed=2)
    unknown = same_commands(form, senses, 50, gain=None)
    assert (unknown["target_n"] != commanded(senses, 50)["target_n"]).any()


@IMPOSSIBLE_SENSE.mark
@pytest.mark.parametrize("hands", [100, pytest.param(2_500, marks=pytest.mark.soak)])
def test_whatever_is_sensed_a_target_in_c_and_python_is_finite_and_within_the_ceiling(
    form, hands
):
    commands = same_commands(form, hostile_senses(37, 600, hands), hands)
    target_n = commands["target_n"]
    assert ((target_n >= 0.0) & (target_n <= QUICK.ceiling_n)).all()
    assert all(np.isfinite(commands[name]).all() for name in NUMBERS)
    assert (target_n > 0.0).mean() > 0.1


def test_rules_that_are_given_have_the_bits_of_python_in_c(form):
    senses = slides(random_senses(60, 200, 40), 40, seed=3)
    usual = same_commands(form, senses, 40)
    rules = {"from_p": 0.3, "full_p": 0.95, "rise_n": 0.0, "follow_n": 3.0}
    rules |= {"floor": 1.0, "above": 1.4, "safe_p": 0.2, "safe_follow_n": 1.0}
    assert rules.keys() | {"most_over_n"} == ranges(AnswerRules).keys()
    for name, value in rules.items():
        one = {name: value}
        others = same_commands(form, senses, 40, rules=one)
        assert others.tobytes() != usual.tobytes(), name
    same_commands(form, senses, 40, rules=rules)


IMPOSSIBLE = (float("nan"), -1.0)


@pytest.mark.parametrize("wrong", IMPOSSIBLE)
@pytest.mark.parametrize("name", RANGES)
def test_an_option_that_is_no_number_from_zero_on_leaves_the_defaults_in_c(
    form, name, wrong
):
    """Python refuses such limits; C has no exception, and says -1."""
    senses = random_senses(5, 60, 5)
    given = records_of(senses, 5)
    for limit, value in vars(Limits()).items():
        given["options"][limit] = value
    given["options"]["most_over_n"] = AnswerRules.most_over_n
    given["options"]["shear_gain"] = 0.0
    program = form.program("gcc", "-O2")
    usual = run(program, "grip", given, COMMAND)
    given["options"][name] = wrong
    assert run(program, "grip", given, COMMAND).tobytes() == usual.tobytes()
