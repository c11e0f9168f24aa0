"""Hands in a closed loop: the open loop where they do nothing, and what people and objects do where
they act."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loop_bench import (
    ACTIONS,
    WHOLE_BRUSH,
    Firm,
    forces_in,
    row,
    scene_of,
    slow_card,
    slower,
)

from benchmarks.loop_baselines import oracle
from holdfast.edge_runtime.grip import Controller
from holdfast.simulation.loop.closed_loop import (
    USUAL,
    ClosedLoop,
    LoopSettings,
    managed,
    run_loops,
)
from holdfast.simulation.loop.people import MISTAKEN_S, Habits, LoopOutcome, Wearer
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.script_times import Times

ONE_OF_EACH = [row(action) for action in ACTIONS]
PATIENT = "wait_s = 0.1\nmove_s = 0.3\ndistance_m = 0.25\narm_n_per_m = 600\n"
"""A receiver who pulls at once, and as hard as the cap allows."""


HEARD = LoopSettings(habits=Habits(missed_share=0.0, pull_gives_up_s=0.5))
"""No signal is missed, and a puller gives up after half a second."""
CANNOT_TELL = replace(HEARD, opening="larger")
"""And the hand holds on while its wearer opens it."""


def firm_loop(scene: Scene, settings: LoopSettings = USUAL) -> tuple[ClosedLoop, Firm]:
    """All trials of a scene in hands that hold on firmly."""
    made: list[Firm] = []

    def make(trials: Sequence[PlannedTrial], rate_hz: float) -> Firm:
        made.append(firm_of(trials, rate_hz))
        return made[0]

    return ClosedLoop(scene, scene.trials(), slower(), make, settings), made[0]


def firm_of(trials: Sequence[PlannedTrial], rate_hz: float) -> Firm:
    """The maker of a hand that holds on."""
    return Firm(trials, 45.0)


# a hand that does nothing


@pytest.fixture(
    scope="module", params=["", WHOLE_BRUSH], ids=["core", "brush and averaging"]
)
def idle(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Scene, ClosedLoop, np.ndarray]:
    """One trial of each action with controller none; forces at every sample."""
    text = slow_card(*ONE_OF_EACH, effects=request.param)
    scene = scene_of(tmp_path_factory.mktemp("idle"), text)
    make = managed(scene, Controller)
    loop = ClosedLoop(scene, scene.trials(), slower(), make)
    return scene, loop, forces_in(loop)


def test_a_loop_that_does_nothing_is_the_open_loop_bit_for_bit(
    idle: tuple[Scene, ClosedLoop, np.ndarray],
) -> None:
    scene, loop, forces_n = idle
    for place, whole in enumerate(scene.run_together(scene.trials())):
        looped = loop.world.motion(place)
        steps = min(
            len(looped.at_s), len(whole.motion.at_s)
        )  # a pull's loop goes on for longer
        assert steps > 100
        for name in ("at_s", "agents_n", "gripped", "slips", "slides", "slip_m"):
            open_loop = getattr(whole.motion, name)[:steps]
            assert getattr(looped, name)[:steps].tobytes() == open_loop.tobytes(), name
        begins = int(loop.spans.begins[place])
        ends = int(loop.spans.ends[place])
        sampled = whole.motion.forces_n[begins + 1 : ends + 1]
        assert forces_n[: len(sampled), place].tobytes() == sampled.tobytes()
        assert sampled.any()


# a batch


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, list[LoopOutcome]]:
    """A pull and a fall by the holdfast controller."""
    text = slow_card(row("pull"), row("fall"))
    scene = scene_of(tmp_path_factory.mktemp("two"), text)
    return scene, run_loops(scene, scene.trials(), slower(), managed(scene))


def same(one: LoopOutcome, other: LoopOutcome) -> bool:
    values = ("lost_s", "onset_s", "slip_mm", "peak_n", "overrode_s", "begin_s")
    equal = all(getattr(one, name) == getattr(other, name) for name in values)
    return equal and one.grip_n.tobytes() == other.grip_n.tobytes()


def test_a_trial_does_not_depend_on_its_batch_even_alone(
    two: tuple[Scene, list[LoopOutcome]],
) -> None:
    scene, outcomes = two
    trials = scene.trials()
    make = managed(scene)
    (alone,) = run_loops(scene, trials[:1], slower(), make)
    assert same(alone, outcomes[0])
    order = [trials[1], trials[0], trials[1]]
    swapped = run_loops(scene, order, slower(), make)
    for one, other in zip(
        swapped, (outcomes[1], outcomes[0], outcomes[1]), strict=True
    ):
        assert same(one, other)


# what becomes of objects


@pytest.fixture(scope="module")
def falls(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[LoopOutcome]]:
    """A fall and a pull beyond any hand: bare and by the oracle. The falling object is fragile."""
    egg = '[objects."egg"]\nmass_g = 60\nhalf_length_mm = 60\nfriction = 0.7\ncrush_n = 20\n'
    beyond = row("pull", "cap_n = 400\narm_n_per_m = 100000\ndistance_m = 1\n")
    text = slow_card(row("fall", "weak_grip = 0.5\n", "egg"), beyond, effects=egg)
    scene = scene_of(tmp_path_factory.mktemp("falls"), text)
    bare = run_loops(scene, scene.trials(), slower(), managed(scene, Controller))
    onsets = {one.trial.number: one.onset_s for one in bare}
    best = run_loops(scene, scene.trials(), slower(), oracle(onsets, 70.0))
    return {"bare": bare, "oracle": best}


def test_the_oracle_keeps_a_fall_that_the_bare_hand_drops(
    falls: dict[str, list[LoopOutcome]],
) -> None:
    bare = falls["bare"][0]
    best = falls["oracle"][0]
    assert bare.dropped
    assert bare.act_s < bare.onset_s < bare.lost_s < bare.act_s + 1.0
    assert not best.dropped
    assert best.lost_s == np.inf
    assert best.peak_grip_n > 2.0 * bare.peak_grip_n
    assert 0.0 < best.slip_mm < 50.0


def test_a_puller_stronger_than_the_hand_gets_the_object_and_nothing_is_a_nan(
    falls: dict[str, list[LoopOutcome]],
) -> None:
    one = falls["oracle"][1]
    assert one.dropped
    assert one.peak_n > 5.0
    assert np.isfinite([one.lost_s, one.onset_s, one.slip_mm, one.peak_n]).all()


def test_a_grip_above_what_an_object_bears_crushes_it(
    falls: dict[str, list[LoopOutcome]],
) -> None:
    bare = falls["bare"][0]
    assert not bare.crushed
    for peak_n, crushed in ((19.9, False), (20.1, True)):
        grip_n = np.array([1.0, peak_n, 1.0], dtype=np.float32)
        assert replace(bare, grip_n=grip_n).crushed == crushed
    sturdy = falls["bare"][1]
    assert not replace(sturdy, grip_n=np.array([1e3], dtype=np.float32)).crushed


# people


@pytest.fixture(scope="module")
def resisted(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[ClosedLoop, Firm, list[LoopOutcome]]:
    """Hands that hold on: against a strong receiver, a weak one, and a puller."""
    rows = [
        row("pass", f"{PATIENT}cap_n = 15\nopen_after_s = 1.2\n"),
        row("pass", f"{PATIENT}cap_n = 0.5\nopen_after_s = 1.2\n"),
        row("pull", "cap_n = 12\nmove_s = 0.5\ntail_s = 1.5\n"),
    ]
    scene = scene_of(tmp_path_factory.mktemp("resisted"), slow_card(*rows))
    loop, firm = firm_loop(scene, settings=CANNOT_TELL)
    return loop, firm, loop.run()


def test_a_wearer_overrides_a_hand_that_resists_for_a_third_of_a_second(
    resisted: tuple[ClosedLoop, Firm, list[LoopOutcome]],
) -> None:
    strong, weak, pull = resisted[2]
    assert strong.act_s + 0.3 <= strong.overrode_s < strong.opens_s
    assert weak.opens_s + 0.3 < weak.overrode_s < weak.opens_s + 0.7
    assert pull.overrode_s == np.inf


def test_a_hand_that_cannot_tell_holds_while_its_wearer_opens(
    resisted: tuple[ClosedLoop, Firm, list[LoopOutcome]],
) -> None:
    _, weak, _ = resisted[2]
    t_s = weak.begin_s + np.arange(len(weak.grip_n)) / weak.rate_hz
    opened = (t_s > weak.opens_s + 0.3) & (t_s < weak.overrode_s)
    assert opened.sum() > 1
    assert (weak.own_n[opened] < 0.5 * weak.trial.grip_n).all()
    assert weak.grip_n[opened] == pytest.approx(45.0, abs=2.0)
    assert weak.lost_s > weak.overrode_s


def test_a_hand_obeys_its_wearers_opening_whatever_the_target(tmp_path: Path) -> None:
    kind = f"{PATIENT}cap_n = 0.5\nopen_after_s = 1.2\n"
    scene = scene_of(tmp_path, slow_card(row("pass", kind)))
    make = managed(scene, Controller)
    (bare,) = run_loops(scene, scene.trials(), slower(), make, HEARD)

    (held,) = run_loops(scene, scene.trials(), slower(), firm_of, HEARD)
    t_s = held.begin_s + np.arange(len(held.grip_n)) / held.rate_hz
    before = int(np.searchsorted(t_s, held.opens_s)) - 1
    assert held.grip_n[before] == pytest.approx(45.0, abs=2.0)
    # the command stays, and the object is free as soon as the drive has opened
    assert (held.target_n[t_s > held.opens_s] == 45.0).any()
    assert held.overrode_s == np.inf
    assert bare.lost_s < held.lost_s < bare.lost_s + 0.3


@pytest.mark.parametrize(("mistake_s", "is_held"), [(0.05, True), (0.3, False)])
def test_a_hand_that_its_wearer_opens_by_mistake_opens_for_so_long(
    tmp_path: Path, mistake_s: float, is_held: bool
) -> None:
    kind = "hold_s = 1.8\nopening_s = 0.3\n"
    scene = scene_of(tmp_path, slow_card(row("hold", kind)))
    habits = replace(HEARD.habits, mistake_s=mistake_s)
    settings = replace(HEARD, habits=habits)
    (held, _) = run_loops(scene, [*scene.trials()] * 2, slower(), firm_of, settings)
    t_s = held.begin_s + np.arange(len(held.grip_n)) / held.rate_hz
    begins_s = held.act_s - MISTAKEN_S
    opened = (t_s > begins_s) & (t_s < begins_s + 2.0 * mistake_s)
    assert held.own_n[opened].min() < 0.99 * held.trial.grip_n
    assert (held.lost_s > held.opens_s) == is_held
    assert held.own_n[t_s > begins_s + 0.7][0] == pytest.approx(held.trial.grip_n)


def test_a_puller_gives_up_and_the_object_stays(
    resisted: tuple[ClosedLoop, Firm, list[LoopOutcome]],
) -> None:
    loop, _, (*_, pull) = resisted
    motion = loop.world.motion(2)
    force_n = np.linalg.norm(motion.agents_n, axis=1)
    gone = motion.at_s > pull.act_s + 0.5 + Habits().lets_go_s + 0.01
    assert gone.sum() > 20
    assert force_n[gone].max() < 0.01 * pull.peak_n
    assert motion.gripped[gone].all()
    assert not pull.dropped


def test_signals_to_open_are_early_by_what_is_given_and_missed_by_what_is_given(
    resisted: tuple[ClosedLoop, Firm, list[LoopOutcome]],
) -> None:
    trial = resisted[0].trials[0]
    trials = [replace(trial, number=number) for number in range(1000)]
    wearer = Wearer(trials, Habits(), seed=1)
    opens_s = Times.of(trial).open
    came = wearer.signal_s < opens_s
    early_s = opens_s - wearer.signal_s[came]
    assert 1.0 - came.mean() == pytest.approx(0.1, abs=0.03)
    assert (wearer.signal_s[~came] > 1e6).all()
    assert (early_s.min() >= 0.08) & (early_s.max() <= 0.15)
    assert early_s.std() > 0.01


def test_a_wearer_overrides_only_where_the_own_grip_would_have_let_go(
    resisted: tuple[ClosedLoop, Firm, list[LoopOutcome]],
) -> None:
    trial = resisted[0].trials[0]
    holds_n = 2.0 * trial.kinetic_friction * trial.grip_n
    act_s = Times.of(trial).act

    def overrides(
        extra_n: float, pulled_n: float, lasts_s: float, after_s: float = 0.1
    ) -> bool:
        wearer = Wearer([trial], Habits(), seed=0)
        for k in range(round(lasts_s * 100)):
            t_s = np.array([act_s + after_s + 0.01 * k])
            own_n, beyond_n, taken_n = (
                np.array([n]) for n in (trial.grip_n, extra_n, pulled_n)
            )
            wearer.resist(t_s, own_n, beyond_n, taken_n, 0.01)
        return bool(np.isfinite(wearer.overrode_s[0]))

    assert overrides(2.0, 1.1 * holds_n, 0.35)
    assert not overrides(2.0, 1.1 * holds_n, 0.25)
    assert not overrides(0.5, 1.1 * holds_n, 1.0)
    assert not overrides(2.0, 0.9 * holds_n, 1.0)
    assert not overrides(2.0, 1.1 * holds_n, 0.5, after_s=-1.0)


def test_a_target_that_comes_later_is_followed_later(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, slow_card(row("fall"), row("fall")))
    first = []
    for delay in (0, 6):
        loop, _ = firm_loop(scene, settings=LoopSettings(delay_samples=delay))
        one = loop.run()[0]
        first.append(np.flatnonzero(one.grip_n > one.own_n)[0])
    assert first[1] - first[0] == 6
