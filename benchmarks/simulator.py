"""What accuracy costs in the simulator: step against slip time, trials and elements against CPU.

And whether it is plausible: the medians from load onset to gross slip, style by style.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from simulation.card import Card, read_card
from simulation.scene import Scene, SimulatedTrial

STEPS_S = (4e-3, 2e-3, 1.667e-3, 8.334e-4, 4.167e-4, 2.084e-4)
REFERENCE_S = 2.5e-5
EXPECTED_MS = {
    ("thesis", "pull"): 26,
    ("thesis", "fall"): 19,
    ("p1", "pull"): 13,
    ("p2", "pull"): 56,
    ("p2", "fall"): 67,
}
"""Medians of a prototype (simulated too), which styles were fitted to."""


def step_curve(*, trials: int = 60, seed: int = 0) -> list[dict[str, float]]:
    """Step, ms -> median and p90 error of the time of gross slip against a 25 us reference, ms, and
    CPU time."""
    card = _losses(read_card("thesis"))
    reference, _ = _slip_times_s(replace(card, step_s=REFERENCE_S), trials, seed)
    rows = []
    for step_s in STEPS_S:
        times, cpu_s = _slip_times_s(replace(card, step_s=step_s), trials, seed)
        error = 1e3 * np.abs(times - reference)
        error = error[np.isfinite(error)]
        p50, p90 = np.percentile(error, [50, 90])
        rows.append(
            {
                "step_ms": 1e3 * step_s,
                "p50_ms": p50,
                "p90_ms": p90,
                "cpu_s_per_trial": cpu_s / trials,
            }
        )
    return rows


def size_curve(
    *, lanes: tuple[int, ...] = (15, 60, 200, 500), elements: tuple[int, ...] = (1, 2, 5, 10, 20)
) -> Any:
    """CPU time a trial of the thesis card by trials at once (five elements) and by elements (200 at
    once)."""
    card = read_card("thesis")
    by_trials = [{"trials": n, "cpu_s_per_trial": _cpu_s(card, n)} for n in lanes]
    by_elements = []
    for count in elements:
        changed = replace(card, effects=card.effects | {"brush": {"count": count}})
        simulated, cpu_s = _timed(changed, 200)
        by_elements.append(
            {
                "elements": count,
                "cpu_s_per_trial": cpu_s / 200,
                "incipient_ms": _incipient_ms(simulated),
            }
        )
    return {"by_trials": by_trials, "by_elements": by_elements}


def plausibility(*, trials: int = 200, seed: int = 1) -> list[dict[str, Any]]:
    """Median from load onset to gross slip, ms, by card and action, beside what was expected."""
    rows = []
    for name in ("thesis", "p1", "p2"):
        scene = Scene(read_card(name), seed)
        by_action: dict[str, list[float]] = {}
        losses = [trial for trial in scene.trials(trials) if trial.action in ("pull", "fall")]
        for simulated in scene.run(losses):
            truth = simulated.truth
            if truth.gross_slip_s is not None and truth.load_onset_s is not None:
                by_action.setdefault(simulated.trial.action, []).append(
                    1e3 * (truth.gross_slip_s - truth.load_onset_s)
                )
        for action in ("pull", "fall"):
            leads = np.array(by_action.get(action, [np.nan]))
            p5, p50, p95 = (float(value) for value in np.percentile(leads, [5, 50, 95]))
            rows.append(
                {
                    "card": name,
                    "action": action,
                    "n": len(leads),
                    "p5_ms": p5,
                    "p50_ms": p50,
                    "p95_ms": p95,
                    "expected_ms": EXPECTED_MS.get((name, action)),
                }
            )
    return rows


def _losses(card: Card) -> Card:
    return replace(card, rows=tuple(row for row in card.rows if row.action in ("pull", "fall")))


def _slip_times_s(card: Card, trials: int, seed: int) -> tuple[np.ndarray, float]:
    scene = Scene(card, seed)
    chosen = scene.trials(trials)
    started = time.process_time()
    simulated = scene.run_together(chosen)
    times = [
        np.nan if one.truth.gross_slip_s is None else one.truth.gross_slip_s for one in simulated
    ]
    return np.array(times), time.process_time() - started


def _timed(card: Card, trials: int) -> tuple[list[SimulatedTrial], float]:
    scene = Scene(card, 0)
    chosen = scene.trials(trials)
    started = time.process_time()
    simulated = list(scene.run(chosen))
    return simulated, time.process_time() - started


def _cpu_s(card: Card, trials: int) -> float:
    return _timed(card, trials)[1] / trials


def _incipient_ms(simulated: list[SimulatedTrial]) -> float:
    """Median from the first element that slides to gross slip, where a grip is lost."""
    spans = [
        1e3 * (one.truth.gross_slip_s - one.truth.incipient_slip_s)
        for one in simulated
        if one.trial.action in ("pull", "fall")
        and one.truth.gross_slip_s is not None
        and one.truth.incipient_slip_s is not None
    ]
    return float(np.median(spans))
