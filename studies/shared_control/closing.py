"""Hands that only close: by how much a target rises, and how well the wearer's grip is known.

`python -m studies loop --closing`. Scenes of the card `wide` in which nothing happens for
AFTER_S from the contact on, with its sensors, objects and hands: the object rests as before a lift
("table"), or a support holds it that does not give way ("fixed"). Neither the arm moves nor the
hand trembles. Each draw also runs in a hand without targets, whose reading is the wearer's grip as
these sensors read it, and with a slip that is certain for a while at a random time of the close.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from msgspec import structs

from holdfast.core.contract import BoolArray, FloatArray, Json
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.grip import AnswerRules, GripSense
from holdfast.simulation.effects.effect import stream
from holdfast.simulation.loop.closed_loop import (
    ClosedLoop,
    LoopTruth,
    ManagedGrip,
    managed,
)
from holdfast.simulation.scenes.protocol import PlannedTrial, Trials
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.simulation.scenes.script_times import Times

CARD, ACTION = "wide", "lift"
AFTER_S = 2.0
"""From the contact on."""
MOVING = ("arm", "tremor")
"""Effects of the card that do more than close the hand."""
FIXED = {"support_n_per_m": 1e5, "support_cap_n": 1e4}
"""In place of the arm that holds an object out."""
BOUNDS_N = (2.0, 4.0)
CERTAIN_S = 0.3
"""For so long a slip is made certain."""
MOST_OVER_N = 1.0
"""Of the bound on fragile work that is looked at with it."""


def closing_scene(seed: int) -> Scene:
    """The scene of the card without what moves the hand."""
    card = read_scene_file(CARD)
    hold = {"hold_s": AFTER_S + 1.0}
    rows = [replace(one, values={**one.values, **hold}) for one in card.rows]
    rows = [one for one in rows if one.action == ACTION]
    effects = {name: one for name, one in card.effects.items() if name not in MOVING}
    return Scene(replace(card, rows=tuple(rows), effects=effects), seed)


def fixed(trial: PlannedTrial) -> PlannedTrial:
    """The trial on a thing that does not move."""
    return replace(trial, drawn=trial.drawn | FIXED)


@dataclass(frozen=True)
class Closes:
    """What became of B hands, [T, B] each: times, and N a side.

    since_s  from the contact on
    own_n    the wearer's grip
    read_n   the grip that the sensors read
    known_n  the wearer's grip as the controller has it
    given_n  the target, 0 for none
    """

    since_s: FloatArray
    own_n: FloatArray
    read_n: FloatArray
    known_n: FloatArray
    given_n: FloatArray

    @property
    def within(self) -> BoolArray:
        """[T, B] the samples that count."""
        counts: BoolArray = (self.since_s >= 0.0) & (self.since_s <= AFTER_S)
        return counts

    def over(self, wearers_n: FloatArray) -> FloatArray:
        """[B] the largest target over the wearer's grip [T, B]; 0 without one."""
        given = self.within & (self.given_n > 0.0)
        most_n: FloatArray = np.where(given, self.given_n - wearers_n, 0.0).max(axis=0)
        return most_n.clip(0.0)


class _Watched:
    """A controller whose wearer's grip is written down; slips: when a slip is certain."""

    def __init__(
        self, inner: ManagedGrip, slips: Callable[[FloatArray], BoolArray]
    ) -> None:
        self._inner = inner
        self._slips = slips
        self.mu_hat = inner.mu_hat
        self.rows: list[list[FloatArray]] = []

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] target, N a side."""
        certain = self._slips(now.t_s)
        p_risky = np.where(certain, 1.0, sense.p_risky)
        p_safe = np.where(certain, 0.0, sense.p_safe)
        felt = structs.replace(sense, p_risky=p_risky, p_safe=p_safe)
        target_n = self._inner.step(felt, now)
        known_n = self._inner.grip.controller.wearers_n
        self.rows.append([now.t_s, sense.grip_n, known_n + 0.0 * now.t_s, target_n])
        return target_n


def closes(
    scene: Scene,
    trials: Trials,
    model: OpenedModel,
    *,
    certain: bool = False,
    **others: Any,
) -> Closes:
    """Run trials until AFTER_S after their contacts.

    certain: a slip is, for a while. others: rules that differ from those of the model.
    """
    rules = AnswerRules.of(model.card.decision, **others)
    ends_s = np.array([Times.of(one).close + one.drawn["closing_s"] for one in trials])
    close_s = np.array([Times.of(one).close for one in trials])
    rngs = [stream(scene.seed, one.number, "certain slip") for one in trials]
    from_s = close_s + np.array([rng.uniform() for rng in rngs]) * (ends_s - close_s)
    made: list[_Watched] = []

    def slips(t_s: FloatArray) -> BoolArray:
        now: BoolArray = (t_s >= from_s) & (t_s < from_s + CERTAIN_S)
        return now if certain else np.zeros_like(now)

    def make(some: Trials, rate_hz: float) -> _Watched:
        inner = managed(scene, rules=rules)(some, rate_hz)
        made.append(_Watched(inner, slips))
        return made[0]

    loop = ClosedLoop(scene, trials, model, make)
    begins_s = loop.spans.begins / loop.rate_hz
    # the hand may touch as late as it has closed
    periods = int(np.ceil((ends_s + AFTER_S - begins_s).max() * loop.rate_hz))
    own_n = []
    for period in range(periods):
        target_n = loop.decide(period)
        own_n.append(loop.actuator.wearers_n.copy())
        loop.world.advance(period, target_n)

    t_s, read_n, known_n, given_n = np.array(made[0].rows).transpose(1, 0, 2)
    touches = (np.array(own_n) > 0.0) & (t_s > close_s)
    contact_s = np.where(touches, t_s, np.inf).min(axis=0)
    return Closes(t_s - contact_s, np.array(own_n), read_n, known_n, given_n)


def closing_figures(seed: int, draws: int, model: OpenedModel) -> Json:
    """The figures of all draws of a seed."""
    scene = closing_scene(seed)
    resting = scene.trials(draws)
    rows = []
    for name, trials in (("table", resting), ("fixed", [fixed(k) for k in resting])):
        bare = closes(scene, trials, model, detects=False, follows=False)
        held = closes(scene, trials, model)
        forced = closes(scene, trials, model, certain=True, most_over_n=MOST_OVER_N)
        given = (held.within & (held.given_n > 0.0)).any(axis=0)
        rows.append(
            {
                "scene": name,
                "draws": draws,
                "with_target": int(given.sum()),
                "target_over_known_n": _in_figures(held.over(held.known_n)),
                "target_over_true_n": _in_figures(held.over(held.own_n)),
                "known_away_n": _in_figures(away_n(forced, bare)),
                "beyond_bound_n": _in_figures(
                    (forced.over(bare.known_n) - MOST_OVER_N).clip(0.0)
                ),
            }
        )
    return {"kind": "simulated", "seed": seed, "after_s": AFTER_S, "rows": rows}


def away_n(forced: Closes, bare: Closes) -> FloatArray:
    """[B] the known grip at the last sample without a target, less that of a hand without any.

    A reading may drift while a target stands, so what is known then is of that sample.
    """
    free = forced.within & (forced.given_n <= 0.0)
    last = len(free) - 1 - free[::-1].argmax(axis=0)
    column = np.arange(free.shape[1])
    away_n: FloatArray = np.abs(
        forced.known_n[last, column] - bare.known_n[last, column]
    )
    return away_n


def _in_figures(found_n: FloatArray) -> Json:
    """The largest, the 95th of a hundred, and how many are within each bound."""
    within = {
        f"within_{bound:g}_n": int((found_n <= bound).sum())
        for bound in (1.0, *BOUNDS_N)
    }
    return {
        "most": round(float(found_n.max()), 2),
        "p95": round(float(np.percentile(found_n, 95)), 2),
        **within,
    }
