"""What a hand senses, made by hand or at random, for grip controllers, margin and supervisor."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from msgspec.structs import fields

from holdfast.edge_runtime.batch import Batch
from holdfast.edge_runtime.grip import Controller, GripSense, Holdfast
from holdfast.edge_runtime.grip_control import GripLoop
from holdfast.edge_runtime.supervisor import Limits

RATE_HZ = 150.0
QUICK = Limits(
    ceiling_n=20.0, rise_s=0.05, most_rise_s=0.4, give_back_s=0.2, give_back_n_s=30.0
)
"""Limits that a short stream reaches."""


def sense(**changes: Any) -> GripSense:
    """A quiet hold: 3 N a side, 0.5 N along the skin, nothing likely; changes: other fields."""
    quiet: dict[str, Any] = dict.fromkeys(("p_risky", "p_safe"), 0.0)
    quiet |= dict.fromkeys(("empty", "opening", "overridden"), False)
    return GripSense(
        **(quiet | {"grip_n": 3.0, "load_n": 0.5, "known": True} | changes)
    )


def random_senses(seed: int, samples: int, hands: int) -> list[GripSense]:
    """Streams of B hands, one a sample; forces from 0 to the largest that a model can answer.

    Half of the hands hold their object calmly, because a grip that jumps begins another hold.
    """
    rng = np.random.default_rng(seed)
    calm = calm_hands(hands)
    sizes = np.array([0.0, 1e-300, 0.3, 1.0, 5.0, 5.0, 5.0, 3e38])

    def forces() -> Any:
        steady = 5.0 * rng.random(hands)
        return np.where(rng.random(hands) < 0.7, steady, rng.choice(sizes, hands))

    def often(share: float) -> Any:
        return rng.random(hands) < share

    return [
        GripSense(
            grip_n=np.where(calm, 3.0 + 0.2 * rng.random(hands), forces()),
            load_n=forces(),
            p_risky=rng.random(hands),
            p_safe=rng.random(hands),
            known=often(0.9),
            empty=often(0.05) & ~calm,
            opening=often(0.02),
            overridden=often(0.02),
        )
        for _ in range(samples)
    ]


def calm_hands(hands: int) -> Any:
    """Which of B hands hold their object calmly."""
    return np.arange(hands) < hands // 2


def of_hand(senses: GripSense, hand: int) -> GripSense:
    """One hand's part, in Python's own floats and bools."""
    return GripSense(
        **{f.name: getattr(senses, f.name)[hand].item() for f in fields(GripSense)}
    )


def of_hands(senses: GripSense, hands: slice) -> GripSense:
    """Some hands' part."""
    return GripSense(
        **{f.name: getattr(senses, f.name)[hands] for f in fields(GripSense)}
    )


def target_of(
    controller: Controller,
    sensed: GripSense,
    given_n: float = 0.0,
    needed_n: float = 0.0,
) -> float:
    """The grip that a controller of one hand wants at a sample, N a side."""
    target_n: float = controller.want(sensed, given_n, needed_n, 0.0).target_n
    return target_n


def loop_of(
    batch: Batch, kind: type[Controller] = Holdfast, gain: float | None = None
) -> GripLoop:
    """A controller with margin and supervisor, under quick limits."""
    controller = kind(batch, RATE_HZ, shear_gain=gain)
    return GripLoop(batch, RATE_HZ, controller, QUICK)


def numbers_of(loop: GripLoop) -> list[Any]:
    """All that a loop says after a sample."""
    supervisor, margin = loop.supervisor, loop.margin
    numbers = [
        supervisor.given_n,
        supervisor.mode,
        supervisor.since_s,
        supervisor.risen_s,
    ]
    return [
        *numbers,
        margin.mu_hat,
        margin.margin,
        margin.needed_n,
        margin.holds_n,
        margin.held,
    ]


def bits(numbers: list[Any], hand: int | None = None) -> bytes:
    """The bytes of some numbers, or of one hand's."""
    return struct.pack(
        f"{len(numbers)}d", *(n if hand is None else n[hand] for n in numbers)
    )


NUMBERS = (
    "nan inf -inf -1e308 -1 -0 0 5e-324 1e-300 .3 .95 1 1.0000001 3 1e9 3e38 1.7e308"
)
HOSTILE = np.array([float(number) for number in NUMBERS.split()])
"""What no sensor and no model should say, between numbers that they do."""


def hostile_senses(seed: int, samples: int, hands: int) -> list[GripSense]:
    """Streams like the random ones; half of all numbers are any at all, but for calm grips."""
    rng = np.random.default_rng(seed)
    calm = calm_hands(hands)
    senses = random_senses(seed, samples, hands)
    for one in senses:
        for name in ("grip_n", "load_n", "p_risky", "p_safe"):
            usual = getattr(one, name)
            replaced = rng.random(hands) < 0.5
            if name == "grip_n":
                replaced = replaced & ~calm
            hostile = np.where(replaced, rng.choice(HOSTILE, hands), usual)
            setattr(one, name, hostile)
    return senses


def scripted_senses() -> list[GripSense]:
    """Six seconds: an empty hand, a hold, a slip, a hand-over, a tug, and what the wearer commands.

    Whole numbers and square roots alone make the curves, so that every machine has these bits.
    """
    senses = []
    for k in range(900):
        wave = ((37 * k) % 101) / 101 - 0.5
        grip_n = min(3.0, max(0.0, 0.04 * (k - 60))) + 0.2 * wave
        load_n = max(0.0, min(2.0, 0.05 * (k - 90)) + 0.3 * wave)
        p_risky = p_safe = 0.0
        if 200 <= k < 320:
            p_risky = min(1.0, (k - 200) / 40) * (1.0 if k % 50 < 45 else 0.6)
            load_n = 0.62 * 2.0 * grip_n * (1.0 + 0.04 * wave)
            grip_n += 0.02 * (k - 200)
        if 420 <= k < 480:
            load_n = max(0.0, load_n - 0.08 * (k - 420))
            p_safe = 0.7 if k % 7 else 0.4
        if 560 <= k < 640:
            p_risky, load_n = 0.72 + 0.3 * wave, load_n + 1.5
        if 700 <= k < 720:
            p_risky = 0.95
        senses.append(
            sense(
                grip_n=grip_n,
                load_n=load_n,
                p_risky=p_risky,
                p_safe=p_safe,
                known=not (260 <= k < 266 or 600 <= k < 602),
                empty=k < 70 or k >= 880,
                opening=740 <= k < 745,
                overridden=800 <= k < 805,
            )
        )
    return senses
