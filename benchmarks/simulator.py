"""What the simulator costs and how far it errs: step against slip time, CPU time by effect.

Effects of the loop are priced by running the same trials with and without them (median of pairs
interleaved), effects of the sensor by calling them on the same recordings: CPU ns per sample of six
fingertips. And whether the losses are plausible: the medians from load onset to gross slip, style
by style.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.effects.effect import (
    EFFECT_MODULES,
    Signal,
    all_effects,
    effect_named,
    stream,
)
from holdfast.simulation.scenes.scene import Scene, SimulatedTrial
from holdfast.simulation.scenes.scene_file import SceneFile, read_scene_file

STEPS_S = (4e-3, 2e-3, 1.667e-3, 8.334e-4, 4.167e-4, 2.084e-4)
REFERENCE_S = 2.5e-5
LOSSES = ("pull", "fall")
EXPECTED_MS = {
    ("thesis", "pull"): 26,
    ("thesis", "fall"): 19,
    ("p1", "pull"): 13,
    ("p2", "pull"): 56,
    ("p2", "fall"): 67,
}
"""Medians of a prototype (simulated too), which styles were fitted to."""
CARD = """
[record]
rate_hz = 150.0
[[trials]]
objects = ["soft-ball", "hard-ball"]
action = "pull"
count = {half}
{effects}
"""
"""The pull that effects are priced on."""


@dataclass(frozen=True)
class StepError:
    """Error of the time of gross slip at a step of the simulation: median and 90 %, ms."""

    step_ms: float
    p50_ms: float
    p90_ms: float
    cpu_s_per_trial: float


@dataclass(frozen=True)
class Lead:
    """From load onset to gross slip of n trials, ms. expected_ms: a prototype's median, if any."""

    card: str
    action: str
    n: int
    p50_ms: float
    expected_ms: float | None


@dataclass(frozen=True)
class EffectPrice:
    """CPU time that an effect adds to a sample."""

    effect: str
    stage: str
    ns_per_sample: float


@dataclass(frozen=True)
class Effort:
    """What is run for a price: trials at once, repetitions, and the card with room for effects."""

    lanes: int = 200
    pairs: int = 3
    card: str = CARD


USUAL = Effort()


def step_curve() -> list[StepError]:
    """Error of the slip's time by step, against a reference of 25 us."""
    trials, seed = 60, 0
    card = read_scene_file("thesis")
    card = replace(card, rows=tuple(row for row in card.rows if row.action in LOSSES))
    reference, _ = _slip_times_s(replace(card, step_s=REFERENCE_S), trials, seed)
    rows = []
    for step_s in STEPS_S:
        times, cpu_s = _slip_times_s(replace(card, step_s=step_s), trials, seed)
        error = 1e3 * np.abs(times - reference)
        p50, p90 = np.percentile(error[np.isfinite(error)], [50, 90]).tolist()
        rows.append(StepError(1e3 * step_s, p50, p90, cpu_s / trials))
    return rows


def plausibility(trials: int = 200, seed: int = 1) -> list[Lead]:
    """The lead by card and action, beside what was expected."""
    rows = []
    for name in ("thesis", "p1", "p2"):
        scene = Scene(read_scene_file(name), seed)
        losses = [trial for trial in scene.trials(trials) if trial.action in LOSSES]
        lost = list(scene.run(losses))
        for action in LOSSES:
            leads = [_lead_ms(one) for one in lost if one.trial.action == action]
            known = [lead for lead in leads if lead is not None]
            if known:
                expected_ms = EXPECTED_MS.get((name, action))
                rows.append(Lead(name, action, len(known), median(known), expected_ms))
    return rows


def _lead_ms(one: SimulatedTrial) -> float | None:
    truth = one.truth
    if truth.gross_slip_s is None or truth.load_onset_s is None:
        return None
    return 1e3 * (truth.gross_slip_s - truth.load_onset_s)


def _slip_times_s(card: SceneFile, trials: int, seed: int) -> tuple[FloatArray, float]:
    """The times of gross slip [N], nan where there is none, and the CPU time."""
    scene = Scene(card, seed)
    chosen = scene.trials(trials)
    started = time.process_time()
    simulated = scene.run_together(chosen)
    times = [one.truth.gross_slip_s for one in simulated]
    return np.array(times, float), time.process_time() - started


def prices(effort: Effort = USUAL) -> list[EffectPrice]:
    """The core alone, then every effect."""
    empty = scene_with([], effort)
    core = min(_run_ns(empty) for _ in range(effort.pairs))
    rows = [EffectPrice("(core alone)", "core", core)]
    for name, effect in all_effects().items():
        priced = _loop_price if effect.stage == "physics" else _sensor_price
        rows.append(EffectPrice(name, effect.stage, priced(name, effort)))
    return rows


def scene_with(names: Sequence[str], effort: Effort) -> Scene:
    """The pull on two balls, with these effects and what they need."""
    chosen = set(names)
    for name in names:
        chosen.update(effect_named(name).needs)
    tables = [f"[effects.{name}]" for name in EFFECT_MODULES if name in chosen]
    text = effort.card.format(half=effort.lanes // 2, effects="\n".join(tables))
    if any(effect_named(name).only_unit == "uT" for name in names):
        text = text.replace("[record]", '[record]\nunit = "uT"', 1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "price.toml"
        path.write_text(text, encoding="utf-8")
        return Scene(read_scene_file(str(path)), 0)


def _run_ns(scene: Scene) -> float:
    trials = scene.trials()
    started = time.process_time_ns()
    simulated = scene.run_together(trials)
    spent = time.process_time_ns() - started
    return spent / sum(len(one.signal.t_s) for one in simulated)


def _loop_price(name: str, effort: Effort) -> float:
    plain = scene_with([], effort)
    more = scene_with([name], effort)
    return median(_run_ns(more) - _run_ns(plain) for _ in range(effort.pairs))


def _sensor_price(name: str, effort: Effort) -> float:
    effect = effect_named(name)
    drawn = effect.draw({}, stream(0, 0, name))
    scene = scene_with(effect.needs, effort)
    signals: list[Signal] = []
    for one in scene.run_together(scene.trials()):
        signals.append(one.signal)

    spent = []
    for _ in range(effort.pairs):
        started = time.process_time_ns()
        for signal in signals:
            effect.sense(signal, drawn, stream(0, 1, name))
        spent.append(time.process_time_ns() - started)
    return median(spent) / sum(len(signal.t_s) for signal in signals)
