"""What accuracy costs in the simulator: step against slip time, trials and elements against CPU.

And whether it is plausible: the medians from load onset to gross slip, style by style.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from holdfast.simulation.scene import Scene, SimulatedTrial
from holdfast.simulation.scene_file import SceneFile, read_scene_file

STEPS_S = (4e-3, 2e-3, 1.667e-3, 8.334e-4, 4.167e-4, 2.084e-4)
REFERENCE_S = 2.5e-5
TRIALS_AT_ONCE = (15, 60, 200, 500)
LOSSES = ("pull", "fall")
ELEMENTS = (1, 2, 5, 10, 20)
EXPECTED_MS = {
    ("thesis", "pull"): 26,
    ("thesis", "fall"): 19,
    ("p1", "pull"): 13,
    ("p2", "pull"): 56,
    ("p2", "fall"): 67,
}
"""Medians of a prototype (simulated too), which styles were fitted to."""


@dataclass(frozen=True)
class StepError:
    """Error of the time of gross slip at a step of the simulation: median and 90 %, ms."""

    step_ms: float
    p50_ms: float
    p90_ms: float
    cpu_s_per_trial: float


@dataclass(frozen=True)
class TrialsCost:
    """CPU time of one of so many trials at once."""

    trials: int
    cpu_s_per_trial: float


@dataclass(frozen=True)
class ElementsCost:
    """CPU time by brush elements, and the median from incipient to gross slip, ms."""

    elements: int
    cpu_s_per_trial: float
    incipient_ms: float


@dataclass(frozen=True)
class SizeCurve:
    """CPU time by trials at once (five elements), and by elements (200 trials at once)."""

    by_trials: list[TrialsCost]
    by_elements: list[ElementsCost]


@dataclass(frozen=True)
class Lead:
    """From load onset to gross slip of n trials, ms. expected_ms: a prototype's median, if any."""

    card: str
    action: str
    n: int
    p5_ms: float
    p50_ms: float
    p95_ms: float
    expected_ms: float | None


def step_curve(trials: int = 60, seed: int = 0) -> list[StepError]:
    """Error of the slip's time by step, against a reference of 25 us."""
    card = _losses(read_scene_file("thesis"))
    reference, _ = _slip_times_s(replace(card, step_s=REFERENCE_S), trials, seed)
    rows = []
    for step_s in STEPS_S:
        times, cpu_s = _slip_times_s(replace(card, step_s=step_s), trials, seed)
        error = 1e3 * np.abs(times - reference)
        error = error[np.isfinite(error)]
        p50, p90 = (float(value) for value in np.percentile(error, [50, 90]))
        rows.append(StepError(1e3 * step_s, p50, p90, cpu_s / trials))
    return rows


def size_curve() -> SizeCurve:
    """CPU time of a trial of the thesis card."""
    card = read_scene_file("thesis")
    by_trials = [TrialsCost(n, _timed(card, n)[1]) for n in TRIALS_AT_ONCE]
    by_elements = []
    for count in ELEMENTS:
        changed = replace(card, effects=card.effects | {"brush": {"count": count}})
        simulated, cpu_s = _timed(changed, 200)
        by_elements.append(ElementsCost(count, cpu_s, _incipient_ms(simulated)))
    return SizeCurve(by_trials, by_elements)


def plausibility(trials: int = 200, seed: int = 1) -> list[Lead]:
    """The lead by card and action, beside what was expected."""
    rows = []
    for name in ("thesis", "p1", "p2"):
        scene = Scene(read_scene_file(name), seed)
        by_action: dict[str, list[float]] = {}
        losses = [trial for trial in scene.trials(trials) if trial.action in LOSSES]
        for simulated in scene.run(losses):
            truth = simulated.truth
            if truth.gross_slip_s is not None and truth.load_onset_s is not None:
                by_action.setdefault(simulated.trial.action, []).append(
                    1e3 * (truth.gross_slip_s - truth.load_onset_s)
                )
        for action in LOSSES:
            leads = np.array(by_action.get(action, [np.nan]))
            p5, p50, p95 = (float(value) for value in np.percentile(leads, [5, 50, 95]))
            expected_ms = EXPECTED_MS.get((name, action))
            rows.append(Lead(name, action, len(leads), p5, p50, p95, expected_ms))
    return rows


def _losses(card: SceneFile) -> SceneFile:
    rows = tuple(row for row in card.rows if row.action in LOSSES)
    return replace(card, rows=rows)


def _slip_times_s(card: SceneFile, trials: int, seed: int) -> tuple[np.ndarray, float]:
    """The times of gross slip [N], nan where there is none, and the CPU time."""
    scene = Scene(card, seed)
    chosen = scene.trials(trials)
    started = time.process_time()
    simulated = scene.run_together(chosen)
    times = [one.truth.gross_slip_s for one in simulated]
    return np.array(times, float), time.process_time() - started


def _timed(card: SceneFile, trials: int) -> tuple[list[SimulatedTrial], float]:
    """Simulated trials, and the CPU time of one."""
    scene = Scene(card, 0)
    chosen = scene.trials(trials)
    started = time.process_time()
    simulated = list(scene.run(chosen))
    return simulated, (time.process_time() - started) / trials


def _incipient_ms(simulated: list[SimulatedTrial]) -> float:
    """Median from the first element that slides to gross slip, where a grip is lost."""
    spans = [
        1e3 * (one.truth.gross_slip_s - one.truth.incipient_slip_s)
        for one in simulated
        if one.trial.action in LOSSES
        and one.truth.gross_slip_s is not None
        and one.truth.incipient_slip_s is not None
    ]
    return float(np.median(spans))
