"""Everyday actions: weights follow their formula, friction decides, and nothing is gained."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from loop_bench import Firm, model, scene_of

from benchmarks.loop_baselines import needed_grip_n
from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, SAFE_SLIP, FloatArray
from holdfast.edge_runtime.grip import GripSense
from holdfast.simulation.actions import EVERYDAY
from holdfast.simulation.effects.effect import EffectBatch, effect_named
from holdfast.simulation.loop.closed_loop import LoopTruth, run_loops
from holdfast.simulation.physics.body import GRAVITY_M_S2
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import SimulatedTrial
from holdfast.simulation.scenes.script_times import Times

SHORT = """close_at_s = 0.4
closing_s = 0.3
hold_s = 0.9
after_s = 0.3
tail_s = 0.2
weak_share = 0
tilt_deg = 0
roll_deg = 0
"""
CAN = "[objects.can]\nmass_g = 200\nhalf_length_mm = 60\nfriction = 0.5\n"


def scene_text(*rows: str, effects: str = "") -> str:
    head = "[record]\nrate_hz = 150\n[physics]\nstep_s = 0.0035\n"
    return head + CAN + "".join(rows) + effects


def row(action: str, more: str = "", grip_n: float = 6.0) -> str:
    first = f'[[trials]]\nobjects = ["can"]\naction = "{action}"\n'
    same = f"friction_factor = 1\ngrip_n = {grip_n}\nspare = 1\n"
    return first + SHORT + same + more + "\n"


def run(folder: Path, *rows: str, effects: str = "") -> list[SimulatedTrial]:
    scene = scene_of(folder, scene_text(*rows, effects=effects))
    return scene.run_together(scene.trials())


def situations(simulated: SimulatedTrial) -> list[int]:
    return [situation for _, situation in simulated.truth.marks]


def sheared_n(simulated: SimulatedTrial, at_s: float) -> float:
    """Force along the skin of all fingertips: what they carry together."""
    k = int(np.searchsorted(simulated.motion.t_s, at_s))
    forces = simulated.motion.forces_n[k]
    # y of thumb and fingers differ in sign: the sensors face each other
    across = forces[:2, 1].sum() - forces[2:, 1].sum()
    return float(np.hypot(forces[:, 0].sum(), across))


HELD = [NOTHING, GRASP, SAFE_SLIP, NOTHING]


def test_actions_that_friction_holds_are_grasps_until_a_person_takes_the_object(
    tmp_path: Path,
) -> None:
    gentle = {"tug": "peak_n = 1", "relax": "left = 1.4", "stack": "added_g = 20"}
    gentle["touch-table"] = "press_n = 1"
    rows = [row(action, gentle.get(action, "")) for action in EVERYDAY]
    together = run(tmp_path, *rows)
    for simulated in together:
        assert situations(simulated) == HELD, simulated.trial.action
        assert simulated.truth.slip_mm < 1.0

    # What another trial of the batch does changes no bit of a trial.
    scene = scene_of(tmp_path, scene_text(*rows))
    tugged = next(one for one in together if one.trial.action == "tug")
    (alone,) = scene.run_together([tugged.trial])
    assert (alone.motion.forces_n == tugged.motion.forces_n).all()


@pytest.mark.parametrize("lasts_s", [0.03, 1.0])
def test_a_tug_slips_where_it_exceeds_coulomb_s_limit_and_not_below(
    lasts_s: float, tmp_path: Path
) -> None:
    """The can needs 2 N; friction holds 6 N, so a tug of 3.9 N in any direction is held."""
    weak = row("tug", f"peak_n = 3.9\nswings = 1\nlasts_s = {lasts_s}")
    strong = row("tug", f"peak_n = 25\nswings = 1\nlasts_s = {lasts_s}")
    held, torn = run(tmp_path, weak, strong)
    assert situations(held) == HELD
    assert held.truth.gross_slip_s is None

    assert RISKY_SLIP in situations(torn)
    risky_s = dict((s, t) for t, s in torn.truth.marks)[RISKY_SLIP]
    assert risky_s == torn.truth.load_onset_s
    assert torn.truth.gross_slip_s is not None
    assert torn.truth.gross_slip_s > risky_s


def test_added_weight_is_carried_until_friction_is_used_up(tmp_path: Path) -> None:
    by_hand = "added_g = 100\ndrop_mm = 0\nadd_s = 0.2"
    light, heavy, dropped = run(
        tmp_path,
        row("stack", by_hand),
        row("stack", by_hand.replace("100", "700")),
        row("stack", "added_g = 100\ndrop_mm = 50\nhit_s = 0.02"),
    )
    times = Times.of(light.trial)
    carried_n = sheared_n(light, times.act + 0.4)
    assert carried_n == pytest.approx(0.3 * GRAVITY_M_S2, rel=0.01)
    assert situations(light) == HELD
    assert RISKY_SLIP in situations(heavy)
    assert heavy.truth.contact_lost_s is not None
    assert heavy.truth.contact_lost_s < Times.of(heavy.trial).open
    # The hit slips for a moment; what friction holds afterwards stays.
    assert situations(dropped) == [*HELD[:2], RISKY_SLIP, *HELD[1:]]


def test_turning_and_lifting_change_what_the_fingers_carry(tmp_path: Path) -> None:
    turned, lifted = run(
        tmp_path,
        row("turn", "angle_deg = 90\nturn_s = 0.5\nstay_s = 0.8\naxis_deg = 90", 12),
        row("lift", "height_m = 0.2\nraise_s = 0.6\ngive_s = 0.2"),
    )
    forces = turned.motion.forces_n
    t_s = turned.motion.t_s
    over = int(np.searchsorted(t_s, Times.of(turned.trial).act + 1.0))
    before = int(np.searchsorted(t_s, Times.of(turned.trial).act))
    # Gravity has turned by a quarter about the thumb's axis, from shear y to shear x.
    assert abs(forces[before, :, 0].sum()) < 0.3
    assert abs(forces[over, :, 0].sum()) == pytest.approx(1.96, abs=0.25)

    act_s = Times.of(lifted.trial).act
    # u = 0.211: the acceleration of a minimum-jerk path is greatest.
    peak_s = act_s + 0.2 + 0.211 * 0.6
    peak_n = 0.2 * (GRAVITY_M_S2 + 5.77 * 0.2 / 0.36)
    assert sheared_n(lifted, act_s) < 0.3
    assert sheared_n(lifted, peak_s) == pytest.approx(peak_n, rel=0.03)


def test_an_unsteady_grip_swings_by_its_share() -> None:
    drawn = {"share": 0.03, "from_hz": 0.5, "to_hz": 3.0}
    rngs = [np.random.default_rng(seed) for seed in range(4)]
    unsteady = effect_named("fluctuation").make(EffectBatch([drawn] * 4, [], rngs))
    closed_m = np.full((6, 4), 2e-3)
    times_s = np.arange(0.0, 400.0, 0.05)
    closures = np.stack([unsteady.closure_m(closed_m, t * np.ones(4)) for t in times_s])
    swing = closures.std(axis=0) / closures.mean(axis=0)
    assert swing == pytest.approx(np.full((6, 4), 0.03), rel=0.1)
    # Fingers that touch nothing stay where they are.
    assert (unsteady.closure_m(-closed_m, np.ones(4)) == -closed_m).all()


def test_walking_and_gripping_anew_follow_their_formulas(tmp_path: Path) -> None:
    carried, gripped = run(
        tmp_path,
        row("carry", "walk_s = 2\nup_m_s2 = 3\nforward_m_s2 = 0\nstep_hz = 2", 12),
        row("regrip", "low = 0.7\nhigh = 1.4\nlasts_s = 0.8"),
    )
    act_s = Times.of(carried.trial).act
    walked = (carried.motion.t_s > act_s + 0.5) & (carried.motion.t_s < act_s + 1.5)
    sheared = carried.motion.forces_n[walked, :, 1]
    load_n = np.abs(sheared[:, :2].sum(axis=1) - sheared[:, 2:].sum(axis=1))
    phase = np.linspace(0, 2 * np.pi, 1000)
    bounce = 3 * (np.sin(phase) + 0.3 * np.sin(2 * phase))
    assert load_n.max() == pytest.approx(0.2 * (GRAVITY_M_S2 + bounce.max()), rel=0.03)
    assert load_n.min() == pytest.approx(0.2 * (GRAVITY_M_S2 - bounce.max()), rel=0.05)

    act_s = Times.of(gripped.trial).act
    normal_n = gripped.motion.forces_n[:, :, 2].sum(axis=1)
    at = np.searchsorted(gripped.motion.t_s, act_s + np.array([0.0, 0.2, 0.6]))
    over = normal_n[at] / normal_n[at[0]]
    assert over == pytest.approx([1.0, 0.7, 1.4], rel=0.02)


def test_touches_of_the_pads_are_never_a_slip_and_keep_within_friction(
    tmp_path: Path,
) -> None:
    empty = "lasts_s = 4\nfirst_s = 1\n"
    rows = [f'[[trials]]\naction = "{name}"\n{empty}' for name in ("stroke", "tap")]
    rows.append('[[trials]]\naction = "nothing"\nlasts_s = 4\n')
    stroked, tapped, nothing = run(tmp_path, *rows, effects="[effects.averaging]\n")
    for simulated in (stroked, tapped):
        assert set(situations(simulated)) <= {NOTHING, GRASP}
        forces = simulated.signal.values
        assert forces[..., 2].max() > 0.1
        shear_n = np.hypot(forces[..., 0], forces[..., 1])
        rub = simulated.trial.drawn["rub"]
        assert (shear_n <= rub * forces[..., 2] + 1e-9).all()
    assert not nothing.signal.values.any()


def test_in_a_closed_loop_a_hand_that_acts_keeps_what_a_relaxing_wearer_drops(
    tmp_path: Path,
) -> None:
    relaxing = row("relax", "left = 0\nrelax_s = 0.8")
    rows = (relaxing, relaxing, row("regrip", "lasts_s = 0.4"))
    scene = scene_of(tmp_path, scene_text(*rows))
    trials = scene.trials()
    # The first hand does nothing, the second holds what the load needs.
    wanted_n = np.array([0.0, 1.2 * needed_grip_n(trials[1]), 0.0])

    class SecondHolds(Firm):
        def __init__(self, trials: Sequence[PlannedTrial], rate_hz: float) -> None:
            super().__init__(trials, 0.0)

        def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
            wanted: FloatArray = np.where(now.t_s >= self.act_s, wanted_n, 0.0)
            return wanted

    bare, held, gripped_anew = run_loops(scene, trials, model(), SecondHolds)
    assert [one.dropped for one in (bare, held, gripped_anew)] == [True, False, False]
    # The relaxing hand slips without a load: its onset is the begin of the slip.
    assert bare.onset_s < bare.lost_s
    assert np.isinf(gripped_anew.onset_s)
    # A wearer who lets the grip drift lowers the bare hand's drive, not the one that acts.
    at_end = int((Times.of(trials[0]).open - bare.begin_s) * bare.rate_hz) - 5
    assert bare.grip_n[at_end] < 0.1
    assert held.grip_n[at_end] == pytest.approx(wanted_n[1], rel=0.05)
