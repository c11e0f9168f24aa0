"""Prices of effects: what each adds to a simulated sample, in one run with the core's own price.

Effects of the loop are priced by running the same trials with and without them (median of pairs
interleaved), effects of the sensor by calling them on the same recordings. CPU time; ns per sample
of six fingertips.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from holdfast.simulation.effect import (
    EFFECT_MODULES,
    Signal,
    all_effects,
    effect_named,
    stream,
)
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file

RATE_HZ = 150.0
CARD = """
[record]
rate_hz = {rate}
[[trials]]
objects = ["soft-ball", "hard-ball"]
action = "pull"
count = {half}
{effects}
"""


@dataclass(frozen=True)
class Effort:
    """What is run for a price: trials at once, repetitions, and the card with room for effects."""

    lanes: int = 200
    pairs: int = 3
    card: str = CARD


USUAL = Effort()


def scene_with(*names: str, effort: Effort = USUAL) -> Scene:
    """The pull on two balls, with these effects and what they need."""
    needed = {need for name in names for need in effect_named(name).needs}
    tables = "\n".join(
        f"[effects.{name}]" for name in EFFECT_MODULES if name in needed | set(names)
    )
    text = effort.card.format(rate=RATE_HZ, half=effort.lanes // 2, effects=tables)
    if any(effect_named(name).only_unit == "uT" for name in names):
        text = text.replace("[record]", '[record]\nunit = "uT"', 1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "price.toml"
        path.write_text(text, encoding="utf-8")
        return Scene(read_scene_file(str(path)), 0)


@dataclass(frozen=True)
class EffectPrice:
    """CPU time that an effect adds to a sample, and that over the core's own."""

    effect: str
    stage: str
    ns_per_sample: float
    over_core: float


def prices(effort: Effort = USUAL) -> list[EffectPrice]:
    """The core alone, then every effect."""
    empty = scene_with(effort=effort)
    core = min(_run_ns(empty) for _ in range(effort.pairs))
    rows = [EffectPrice("(core alone)", "core", core, 1.0)]
    for name, effect in all_effects().items():
        price = PRICED[effect.stage](name, effort)
        rows.append(EffectPrice(name, effect.stage, price, price / core))
    return rows


def empty_list_over_core(*, pairs: int = 5) -> float:
    """CPU time with an empty `[effects]` over that without the section, interleaved."""
    without = scene_with()
    with_empty = scene_with()
    ratios = [_run_ns(with_empty) / _run_ns(without) for _ in range(pairs)]
    return statistics.median(ratios)


def _run_ns(scene: Scene) -> float:
    trials = scene.trials()
    started = time.process_time_ns()
    simulated = scene.run_together(trials)
    spent = time.process_time_ns() - started
    return spent / sum(len(one.signal.t_s) for one in simulated)


def _loop_price(name: str, effort: Effort) -> float:
    plain = scene_with(effort=effort)
    more = scene_with(name, effort=effort)
    return statistics.median(
        _run_ns(more) - _run_ns(plain) for _ in range(effort.pairs)
    )


@lru_cache(maxsize=1)
def _signals(needs: tuple[str, ...], effort: Effort) -> list[Signal]:
    """What a sensor effect is called on; most need the same."""
    scene = scene_with(*needs, effort=effort)
    return [one.signal for one in scene.run_together(scene.trials())]


def _sensor_price(name: str, effort: Effort) -> float:
    drawn = effect_named(name).draw({}, stream(0, 0, name))
    signals = _signals(tuple(effect_named(name).needs), effort)
    spent = []
    for _ in range(effort.pairs):
        started = time.process_time_ns()
        for signal in signals:
            effect_named(name).sense(signal, drawn, stream(0, 1, name))
        spent.append(time.process_time_ns() - started)
    return statistics.median(spent) / sum(len(signal.t_s) for signal in signals)


PRICED: dict[str, Callable[[str, Effort], float]] = {
    "physics": _loop_price,
    "sensor": _sensor_price,
}
