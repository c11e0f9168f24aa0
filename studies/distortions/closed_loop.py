"""The distortions in a closed loop: between the sensors and the model, a sample at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.paired import paired_change
from holdfast.core.contract import FloatArray, IntArray, Json
from holdfast.simulation.effects.effect import Rows
from holdfast.simulation.loop.sensing import LoopSensors, PlanBatch
from holdfast.simulation.scenes.protocol import PlannedTrial
from studies.distortions.law import Law, Memory, PlanRequest
from studies.distortions.table import Distortion, by_name
from studies.distortions.trials import law_stream
from studies.shared_control.closed_loop import LoopRequest, LoopRuns, LoopSet

CONTROLLER = "holdfast"
KEYS = (
    "drops",
    "preventable",
    "saved",
    "saved_share",
    "saved_share_ci",
    "saved_of_drops",
    "saved_untightened",
    "held_after_opening",
    "before_force_n_p95",
    "before_delay_ms_p95",
    "handovers",
    "blocked",
    "blocked_share",
    "blocked_share_ci",
)
"""Of the loop's figures, those that stay in a row."""


class DistortedSensors:
    """Sensors of B hands behind a law, read as LoopSensors."""

    def __init__(self, sensors: LoopSensors, law: Law, distortion: Distortion) -> None:
        self.sensors = sensors
        self.law = law
        self.on_forces = distortion.where == "forces"
        self._distortion = distortion
        self._plans: PlanBatch | None = None
        self._memory: Memory = None

    def prepare(self, trials: Sequence[PlannedTrial], counts: IntArray) -> None:
        """Draw the law's plan of every trial; counts [B]: their samples."""
        scene = self.sensors.scene
        plans = []
        for trial, count in zip(trials, counts.tolist(), strict=True):
            rng = law_stream(scene.seed, trial, self._distortion)
            t_s = np.arange(count) / scene.file.rate_hz
            request = PlanRequest(rng, t_s, trial.hand.sensor_sides)
            plans.append(self.law.plan(request))
        self._plans = PlanBatch(plans)

    def read(self, rows: IntArray, forces_n: FloatArray) -> Rows:
        """Readings at samples rows [B], from forces [B, S, 3]."""
        if self.on_forces:
            all_valid = np.ones(forces_n.shape[:2], dtype=np.bool_)
            felt = self._distort(Rows(forces_n, all_valid), rows)
            return self.sensors.read(rows, felt.values)
        return self._distort(self.sensors.read(rows, forces_n), rows)

    def _distort(self, now: Rows, rows: IntArray) -> Rows:
        assert self._plans is not None
        plan = self._plans.at(rows)
        made, self._memory = self.law.apply(now, plan, self._memory)
        return made


@dataclass(frozen=True)
class BetweenByName:
    """Puts a distortion between sensors and model; small to send to a process, and hashable."""

    name: str

    def __call__(
        self, sensors: LoopSensors, trials: Sequence[PlannedTrial], counts: IntArray
    ) -> DistortedSensors:
        """The sensors of these trials, distorted."""
        distortion = by_name()[self.name]
        assert distortion.law is not None
        distorted = DistortedSensors(sensors, distortion.law, distortion)
        distorted.prepare(trials, counts)
        return distorted


def loop_run(
    distortion: Distortion, card: str, trials: int | None, seed: int
) -> tuple[LoopSet, LoopRequest]:
    """What is run for a distortion: its set, and the controller with its readings changed."""
    request = LoopRequest(CONTROLLER)
    if distortion.law is not None:
        request = replace(request, between=BetweenByName(distortion.name))
    return LoopSet(card, trials, seed), request


def closed_outcomes(runs: LoopRuns, run: tuple[LoopSet, LoopRequest]) -> Json:
    """What a row keeps: its figures, and trial by trial what was saved and what was blocked.

    Bare hands and oracles need no sensors, so all rows of a set share them.
    """
    saved = {}
    blocked = {}
    for one in runs.runs(*run):
        key = str(one.bare.trial.number)
        if one.preventable:
            saved[key] = not one.held.dropped
        if one.completes and one.bare.trial.action == "pass":
            blocked[key] = one.blocked
    figures = runs.figures(*run).to_json()
    kept = {key: figures[key] for key in KEYS}
    return {"figures": kept, "saved": saved, "blocked": blocked}


def closed_figures(of: Json, unchanged: Json) -> Json:
    """The figures of a row, and by how much they differ from the unchanged set."""
    figures: Json = dict(of["figures"])
    for name in ("saved", "blocked"):
        change = paired_change(of[name], unchanged[name])
        figures[f"{name}_change"], figures[f"{name}_change_ci"] = change
    return figures
